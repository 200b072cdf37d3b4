"""The Mars missions have the numbers that Yan and He print."""

import jax.numpy as jnp
import numpy as np
import pytest
from mission_numbers import (
    DENSITY,
    DRAG,
    LIFT,
    MARS,
    MONTE_CARLO,
    NOMINAL,
    RANGE,
    ROUNDING,
    YAN_HE,
    assert_drawn,
    assert_has,
    assert_published,
    below,
    numbers,
)

from jentry.campaign import Uniform, multiply, replace
from jentry.missions.mars import (
    drag_tracking as mars_drag_tracking,
    range_tracking as mars_range_tracking,
)
from jentry.motion import EntryDynamics, EquatorialDynamics
from jentry.motion.index import EnergyIndex, TimeIndex, VelocityIndex
from jentry.onboard import DragReference, PolynomialProfile, quintic_profile
from jentry.units import degree


def mars_world(prefix=""):
    """Planet and vehicle, of the scenario or of the model on board."""
    vehicle, assumed = YAN_HE["vehicle"], YAN_HE["assumed"]
    mass, area = vehicle["mass_kg"], vehicle["reference_area_m2"]
    drag = mass / (vehicle["ballistic_coefficient_kg_m2"] * area)
    return {
        f"{prefix}planet.radius": YAN_HE["implied"]["radius_m"],
        f"{prefix}planet.rotation_rate": 0.0,  # equations (1)
        f"{prefix}planet.density_scale": 1.0,
        f"{prefix}planet.gravity.gravitational_parameter": assumed[
            "gravitational_parameter_m3_s2"
        ],
        f"{prefix}planet.atmosphere.surface_density": assumed["surface_density_kg_m3"],
        f"{prefix}planet.atmosphere.scale_height": assumed["scale_height_m"],
        f"{prefix}vehicle.mass": mass,
        f"{prefix}vehicle.reference_area": area,
        f"{prefix}vehicle.aerodynamics.drag_coefficient": drag,
        f"{prefix}vehicle.aerodynamics.lift_coefficient": vehicle["lift_to_drag"]
        * drag,
        f"{prefix}vehicle.lift_scale": 1.0,
        f"{prefix}vehicle.drag_scale": 1.0,
    }


def mars_entry(prefix="initial_state"):
    entry = YAN_HE["entry"]
    return below(
        prefix,
        altitude=entry["altitude_m"],
        velocity=entry["velocity_m_s"],
        flight_path_angle=entry["flight_path_angle_deg"] * degree,
        longitude=entry["longitude_deg"] * degree,
        latitude=entry["latitude_deg"] * degree,
        heading=YAN_HE["implied"]["heading_deg"] * degree,
    )


def mars_target(prefix="target"):
    target = YAN_HE["target"]
    return below(
        prefix,
        altitude=target["altitude_m"],
        velocity=target["velocity_m_s"],
        downrange=target["downrange_m"],
        crossrange=target["latitude_deg"] * YAN_HE["implied"]["radius_m"] * degree,
    )


MARS_LAWS = {
    "table-3": (*MONTE_CARLO, VelocityIndex),
    "energy-index": (*MONTE_CARLO, EnergyIndex),
    "time-index": (*MONTE_CARLO, TimeIndex),
    "state-feedback": ("nominal_gains", None, EnergyIndex),
    "observer-feedback": (*NOMINAL, EnergyIndex),
}


@pytest.fixture
def unplanned(monkeypatch):
    """The references take seconds to plan, and none of their numbers are the paper's."""
    level = PolynomialProfile([1.0])
    zero = jnp.zeros(2)
    range_flown = quintic_profile(zero[0], zero[0] + 1.0, zero, zero, zero)

    def reference(index, gate=0.0, curvature=0.0):
        assert curvature == 0.0  # cos(bank) linear in the velocity
        return DragReference(index, level, level, gate)

    monkeypatch.setattr(mars_drag_tracking, "reference", reference)
    in_three_dimensions = reference(EnergyIndex()), range_flown
    monkeypatch.setattr(mars_range_tracking, "_reference", lambda: in_three_dimensions)


def assert_mars(scenario, gains, observer, **more):
    target = YAN_HE["target"]
    expected = mars_world() | mars_world("guidance.model.")
    expected |= mars_entry() | mars_target()
    expected |= below(
        "termination.conditions.velocity", velocity=target["velocity_m_s"]
    )
    expected |= below("termination.conditions.altitude", altitude=target["altitude_m"])
    expected |= below("guidance.gains", **YAN_HE[gains])
    if observer is None:
        assert not any(a.startswith("guidance.observer") for a in numbers(scenario))
    else:
        expected |= below("guidance.observer", **YAN_HE[observer])
    assert_has(scenario, expected | more)


def test_laws_of_the_paper_come_first():
    assert list(MARS.laws)[: len(MARS_LAWS)] == list(MARS_LAWS)


@pytest.mark.parametrize("variant", MARS_LAWS)
def test_mars(variant, unplanned):
    gains, observer, index = MARS_LAWS[variant]
    scenario = MARS.scenario_of(variant)
    assert_mars(scenario, gains, observer)
    assert isinstance(scenario.dynamics, EquatorialDynamics)
    reference = scenario.guidance.reference
    assert type(reference.index) is index
    # The notes: a velocity index needs a gate of 3 to 5 m/s2, the energy none.
    gate = float(reference.gate)
    assert 3.0 <= gate <= 5.0 if index is VelocityIndex else gate == 0.0


def test_mars_in_three_dimensions(unplanned):
    """The gains are those of the nominal study: the mission says why."""
    aim = mars_entry("target.origin")
    for variant, dynamics in (
        ("range-tracking", EntryDynamics),
        ("range-tracking world in-plane", EquatorialDynamics),
    ):
        scenario = RANGE.scenario_of(variant)
        assert_mars(scenario, *NOMINAL, **aim)
        assert type(scenario.dynamics) is dynamics


def test_mars_by_a_predictor_corrector():
    """To the target of the paper, which the law reads from the scenario."""
    aim = mars_entry("target.origin")
    target = YAN_HE["target"]
    ends = {"velocity": target["velocity_m_s"], "altitude": target["altitude_m"]}
    expected = mars_world() | mars_world("guidance.model.") | mars_entry()
    expected |= mars_target() | aim | below("guidance.end", **ends)
    for variant, dynamics in (
        ("predictor-corrector", EntryDynamics),
        ("predictor-corrector world in-plane", EquatorialDynamics),
        ("predictor-corrector-network world in-plane", EquatorialDynamics),
        ("predictor-corrector-network", EntryDynamics),
    ):
        scenario = RANGE.scenario_of(variant)
        assert_has(scenario, expected)
        assert type(scenario.dynamics) is dynamics
        assert scenario.guidance.in_space == (dynamics is EntryDynamics)
    others = {"range-tracking", "terminal-point", "neural"}
    assert set(RANGE.laws) == others | {
        "predictor-corrector",
        "predictor-corrector-network",
    }


def test_mars_by_a_neural_law():
    """To the same target from the same entry, as the scenario has them."""
    expected = mars_world() | mars_world("guidance.model.") | mars_entry()
    expected |= mars_target()
    scenario = RANGE.scenario("neural")
    assert_has(scenario, expected)
    assert type(scenario.dynamics) is EntryDynamics
    assert scenario.guidance.cycle.period == 2.0


def test_downrange_of_the_paper_is_its_longitude():
    """12.2 deg, half of the last digit of which is 3 km."""
    found = YAN_HE["target"]["longitude_deg"] * degree * YAN_HE["implied"]["radius_m"]
    assert found == pytest.approx(YAN_HE["target"]["downrange_m"], abs=20.0)


@pytest.mark.parametrize("mission", [MARS, RANGE], ids=lambda m: m.name)
@pytest.mark.parametrize("reading", ["lift-to-drag-held", "independent"])
def test_table_2_of_the_mars_missions(mission, reading, unplanned):
    half = YAN_HE["dispersions"]

    def within(name, *where, apply=replace):
        return where, Uniform, (1.0 - half[name], 1.0 + half[name]), apply

    expected = {
        # A deviation of the mass; the others are factors, of which the nominal one is 1.
        "mass": within("mass", "vehicle.mass", apply=multiply),
        "density": within("density", DENSITY),
    }
    if reading == "independent":
        expected |= {"lift": within("lift", LIFT), "drag": within("drag", DRAG)}
    else:
        assert half["lift"] == half["drag"]
        expected["coefficients"] = within("drag", LIFT, DRAG)
    assert_drawn(mission.scenario(), mission.dispersion_table(reading), expected)


def test_table_3_of_the_mars_mission():
    assert_published(MARS, YAN_HE, {"km"})
    assert MARS.published_law == "table-3"
    errors = np.array([-3000.0, 1000.0, 5000.0])  # m, actual minus desired
    of = {"downrange_error": errors, "altitude_error": -errors}
    # By hand: downrange as desired minus actual, (3, -1, -5) km; altitude the same.
    expected = dict(zip(YAN_HE["table_3"], [1, 3, -1, 4, -5, 3, -1, 4], strict=True))
    found = {value.name: value.statistic(of) for value in MARS.published}
    assert found == pytest.approx(expected, rel=ROUNDING)
