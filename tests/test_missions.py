"""The missions have the numbers that their papers print, as `tests/truths/` has them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import choices, truths

from jentry.addresses import addresses_of, field_metadata, leaves_by_address
from jentry.campaign import Normal, OneOfSeveral, Uniform, add, multiply, replace
from jentry.campaign.dispersions import draw
from jentry.flight.scenario import checked
from jentry.missions import ALL, find_mission
from jentry.missions.mars import (
    drag_tracking as mars_drag_tracking,
    range_tracking as mars_range_tracking,
)
from jentry.missions.sx_2.scenario import entry
from jentry.motion import EntryDynamics, EquatorialDynamics
from jentry.motion.index import EnergyIndex, TimeIndex, VelocityIndex
from jentry.onboard import DragReference, PolynomialProfile, quintic_profile
from jentry.parameters.maps import map_of
from jentry.units import degree, foot, nautical_mile


YAN_HE, ZHOU = truths("yan_he.csv"), truths("zhou.csv")

MARS, RANGE, CAV_H, SX_2 = (
    find_mission(name)
    for name in ("mars-drag-tracking", "mars-range-tracking", "cav-h", "sx-2")
)

ROUNDING = 1e-14
"""Relative: a product of two or three numbers"""


def numbers(scenario):
    """Value of each single number by address."""
    leaves = leaves_by_address(scenario).items()
    return {address: float(leaf) for address, leaf in leaves if leaf.shape == ()}


def assert_has(scenario, expected):
    """The values at their addresses, and nothing else there."""
    known = numbers(scenario)
    found = {address: known[address] for address in expected}
    assert found == pytest.approx(expected, rel=ROUNDING, abs=0.0)


def below(beginning, **values):
    return {f"{beginning}.{name}": value for name, value in values.items()}


# Yan and He: both Mars missions.


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


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_every_number_of_a_mission_is_a_leaf(name):
    """Of whatever a variant is made, each of its numbers has its address from the start."""
    mission = ALL[name]
    for variant in choices(mission):
        scenario = mission.scenario_of(variant)
        assert [*leaves_by_address(scenario)] == [*leaves_by_address(checked(scenario))]


MONTE_CARLO = "monte_carlo_gains", "monte_carlo_observer"
NOMINAL = "nominal_gains", "nominal_observer"

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
    assert len(RANGE.laws) == 3


def test_downrange_of_the_paper_is_its_longitude():
    """12.2 deg, half of the last digit of which is 3 km."""
    found = YAN_HE["target"]["longitude_deg"] * degree * YAN_HE["implied"]["radius_m"]
    assert found == pytest.approx(YAN_HE["target"]["downrange_m"], abs=20.0)


def drawn(scenario, dispersion):
    """Addresses, kind, bounds or moments, and how they are applied."""
    distribution = dispersion.distribution
    values = [float(x) for x in leaves_by_address(distribution).values()]
    where = tuple(addresses_of(scenario, dispersion.where))
    return where, type(distribution), tuple(values), dispersion.apply


def assert_drawn(scenario, table, expected):
    assert set(table) == set(expected)
    for name, (where, kind, values, apply) in expected.items():
        found = drawn(scenario, table[name])
        assert found[:2] == (where, kind) and found[3] is apply, name
        assert found[2] == pytest.approx(values, rel=ROUNDING, abs=1e-16), name


DENSITY, LIFT, DRAG = "planet.density_scale", "vehicle.lift_scale", "vehicle.drag_scale"


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


def assert_published(mission, truth, units):
    """Each value of the printed table, in its unit, of as many runs as it is printed of."""
    printed = {value.name: value.value for value in mission.published}
    assert printed == truth["table_3"]
    assert {value.unit for value in mission.published} == units
    assert mission.published_runs == truth["study"]["runs"]


def test_table_3_of_the_mars_mission():
    assert_published(MARS, YAN_HE, {"km"})
    assert MARS.published_law == "table-3"
    errors = np.array([-3000.0, 1000.0, 5000.0])  # m, actual minus desired
    of = {"downrange_error": errors, "altitude_error": -errors}
    # By hand: downrange as desired minus actual, (3, -1, -5) km; altitude the same.
    expected = dict(zip(YAN_HE["table_3"], [1, 3, -1, 4, -5, 3, -1, 4], strict=True))
    found = {value.name: value.statistic(of) for value in MARS.published}
    assert found == pytest.approx(expected, rel=ROUNDING)


# Zhou, Rahman and Chen.


def test_cav_h():
    scenario = CAV_H.scenario("stored")
    assumed, fit, limits = ZHOU["assumed"], ZHOU["fit"], ZHOU["limits"]
    radius, start, target = assumed["radius_m"], ZHOU["start"], ZHOU["target"]
    fit = {name: value for name, value in fit.items() if name != "least_deg"}
    expected = {}
    for prefix, air in (
        ("", "atmosphere.undisturbed"),
        ("guidance.model.", "atmosphere"),
    ):
        planet, vehicle = f"{prefix}planet", f"{prefix}vehicle"
        expected |= {
            f"{planet}.radius": radius,
            f"{planet}.rotation_rate": 0.0,  # section 2.1
            f"{planet}.density_scale": 1.0,
            f"{planet}.gravity.gravitational_parameter": assumed["surface_gravity_m_s2"]
            * radius**2,
            f"{planet}.{air}.surface_density": assumed["surface_density_kg_m3"],
            f"{planet}.{air}.scale_height": assumed["scale_height_m"],
            f"{planet}.heating_coefficient": assumed["heating_coefficient"],
            f"{vehicle}.mass": ZHOU["vehicle"]["mass_kg"],
            f"{vehicle}.reference_area": ZHOU["vehicle"]["reference_area_m2"],
            f"{vehicle}.lift_scale": 1.0,
            f"{vehicle}.drag_scale": 1.0,
            f"{vehicle}.aerodynamics.least_angle_of_attack": ZHOU["fit"]["least_deg"]
            * degree,
        }
        expected |= below(f"{vehicle}.aerodynamics", **fit)
    expected |= below(
        "initial_state",
        altitude=start["altitude_m"],
        velocity=start["velocity_m_s"],
        flight_path_angle=start["flight_path_angle_deg"] * degree,
        heading=start["heading_deg"] * degree,
        longitude=0.0,
        latitude=0.0,
    )
    arrival = {
        "altitude": target["altitude_m"],
        "flight_path_angle": target["flight_path_angle_deg"] * degree,
        "heading": target["heading_deg"] * degree,
    }
    latitude = assumed["target_latitude_deg"] * degree
    expected |= below("guidance.arrival", **arrival)
    expected |= below("target", **arrival, velocity=target["velocity_m_s"])
    expected |= below("target", downrange=radius * latitude, crossrange=0.0)
    for track in ("guidance.track", "termination.conditions.target.track"):
        expected |= below(track, target_latitude=latitude, target_longitude=0.0)
        expected |= below(track, start_latitude=0.0, start_longitude=0.0)
    expected |= below("guidance.parameters", **ZHOU["parameters"])
    expected |= below(
        "guidance.limits",
        least_angle_of_attack=assumed["least_angle_of_attack_deg"] * degree,
        largest_angle_of_attack=assumed["largest_angle_of_attack_deg"] * degree,
        largest_bank=assumed["largest_bank_deg"] * degree,
    )
    for name, unit in (("load_factor", ""), ("dynamic_pressure", "_Pa")):
        expected |= below(f"constraints.{name}", limit=limits[name + unit])
    expected |= below("constraints.heat_rate", limit=limits["heat_rate_W_m2"])
    assert_has(scenario, expected)
    assert scenario.planet.heating_exponent == assumed["heating_exponent"]
    law = scenario.guidance
    inside = {120.0: "cycle_inside_120_s", 15.0: "cycle_inside_15_s"}
    assert law.cycle.period == assumed["cycle_s"]
    assert dict(law.cycle.shorter) == {to: assumed[c] for to, c in inside.items()}
    assert law.cycle.freeze == assumed["freeze_s"]
    # Half of the last digit of the latitude.
    assert radius * latitude == pytest.approx(
        assumed["target_downrange_m"], abs=5e-5 * degree * radius
    )


@pytest.mark.parametrize(
    "variant", ["model-inversion", "newton", "newton world us-1976"]
)
def test_other_variants_of_cav_h_fly_the_same_mission(variant):
    """All but the law's own choice of the curve, and what of the air is another."""
    paper, other = (numbers(CAV_H.scenario_of(v)) for v in ("stored", variant))
    own = ("guidance.parameters", "guidance.velocity_control")
    if variant == "newton world us-1976":
        air = "planet.atmosphere"
        own += f"{air}.undisturbed", f"guidance.model.{air}"
    shared = [a for a in paper if not a.startswith(own)]
    assert len(shared) > 60
    assert {a: other.get(a) for a in shared} == {a: paper[a] for a in shared}


def test_cav_h_by_a_predictor_corrector():
    """The mission of the paper; the law knows its target and believes its model."""
    paper = CAV_H.scenario("stored")
    scenario = CAV_H.scenario("predictor-corrector")
    own = ("guidance.parameters", "guidance.track", "guidance.arrival")
    own += ("guidance.limits", "guidance.estimator")
    theirs = {a: x for a, x in numbers(paper).items() if not a.startswith(own)}
    assert len(theirs) > 60
    start, target = ZHOU["start"], ZHOU["target"]
    assumed = ZHOU["assumed"]
    largest = assumed["largest_bank_deg"] * degree
    assert_has(
        scenario,
        theirs
        | below(
            "target",
            downrange=assumed["radius_m"] * assumed["target_latitude_deg"] * degree,
            crossrange=0.0,
            altitude=target["altitude_m"],
        )
        | below(
            "target.origin",
            longitude=0.0,
            latitude=0.0,
            heading=start["heading_deg"] * degree,
        )
        | {
            "guidance.end.velocity": target["velocity_m_s"],
            "guidance.shape.end": target["velocity_m_s"],
            "guidance.shape.largest": largest,
            "guidance.damping.lowest": np.cos(largest),
        },
    )
    angle = float(scenario.guidance.angle_of_attack(jnp.asarray(5e3)))
    assert assumed["least_angle_of_attack_deg"] * degree < angle
    assert angle < assumed["largest_angle_of_attack_deg"] * degree


@pytest.mark.parametrize("reading", ["normal", "uniform", "normal-sensed"])
def test_table_2_of_cav_h(reading):
    printed, radius = ZHOU["dispersions"], ZHOU["assumed"]["radius_m"]

    def three_sigma(name, leaf, size=1.0):
        value = printed[name] * size / 3.0
        return (f"initial_state.{leaf}",), Normal, (0.0, value), add

    def factor(name, address):
        if reading == "uniform":
            kind, values = Uniform, (1.0 - printed[name], 1.0 + printed[name])
        else:
            kind, values = Normal, (1.0, printed[name] / 3.0)
        return (address,), kind, values, replace

    expected = {
        # Due north: the range is along the latitude.
        "range": three_sigma("range_m", "latitude", 1.0 / radius),
        "cross range": three_sigma("cross range_m", "longitude", 1.0 / radius),
        "altitude": three_sigma("altitude_m", "altitude"),
        "velocity": three_sigma("velocity_m_s", "velocity"),
        "flight-path angle": three_sigma(
            "flight-path angle_deg", "flight_path_angle", degree
        ),
        "azimuth": three_sigma("azimuth_deg", "heading", degree),
        "density": factor("density", DENSITY),
        "lift": factor("lift", LIFT),
        "drag": factor("drag", DRAG),
    }
    scenario, table = CAV_H.scenario("stored"), CAV_H.dispersion_table(reading)
    sensors = {name: d for name, d in table.items() if name not in expected}
    assert len(sensors) == (6 if reading == "normal-sensed" else 0)
    for name, dispersion in sensors.items():
        (address,), *_ = expected[name] = drawn(scenario, dispersion)
        assert address.startswith("accelerometers."), name
    assert_drawn(scenario, table, expected)


def test_table_3_of_cav_h():
    assert_published(CAV_H, ZHOU, {"m", "deg", "m/s"})
    # The paper's law, and the dispersions that it names: what is ours beyond is not its.
    assert CAV_H.published_law == "adjusted-once"
    assert CAV_H.published_dispersions == "normal"
    errors = np.array([-3.0, 1.0, 2.0])
    of = {
        "miss_distance": np.abs(errors),
        "flight_path_angle_error": errors * degree,
        "heading_error": errors * degree,
        "velocity_error": errors,
    }
    # By hand: maximum 3 and mean 2 of the magnitudes; the standard deviation is that of
    # the signed errors, 7 about 0, but for the distance, 1 about 2.
    rest = [3.0, 2.0, np.sqrt(7.0)]
    expected = dict(
        zip(ZHOU["table_3"], [3.0, 2.0, 1.0, *rest, *rest, *rest], strict=True)
    )
    found = {value.name: value.statistic(of) for value in CAV_H.published}
    assert found == pytest.approx(expected, rel=1e-14)


# Bharadwaj, Rao and Mease: SX-2. Its numbers of the vehicle are those of sx_2_by_hand.

SX_2_ERRORS = {
    "altitude": 1000.0 * foot,
    "longitude": 0.1 * degree,
    "latitude": 0.1 * degree,
    "velocity": 100.0 * foot,
    "flight path angle": 0.1 * degree,
    "heading": 0.1 * degree,
}


def in_start(name):
    return (f"initial_state.{name.replace(' ', '_')}",)


def test_dispersions_of_sx_2():
    scenario, table = entry(), SX_2.dispersion_table
    at_once = {
        name: (in_start(name), Uniform, (-most, most), add)
        for name, most in SX_2_ERRORS.items()
    }
    assert_drawn(scenario, table("initial-errors"), at_once)
    factors = {
        "density": ((DENSITY,), Uniform, (0.8, 1.2), replace),
        "lift": ((LIFT,), Uniform, (0.95, 1.05), replace),
        "drag": ((DRAG,), Uniform, (0.95, 1.05), replace),
    }
    assert_drawn(scenario, table("air-and-vehicle"), factors)
    assert_drawn(scenario, table("everything"), at_once | factors)
    each = {
        name: (in_start(name), OneOfSeveral, (most,), add)
        for name, most in SX_2_ERRORS.items()
    }
    assert_drawn(scenario, table("one-at-a-time"), each)


def test_one_error_of_sx_2_at_a_time(key):
    """Whatever the run: one, and each of them in some."""
    table = SX_2.dispersion_table("one-at-a-time")
    drawn = jax.vmap(lambda run: draw(table, key, run))(jnp.arange(100))
    there = np.stack(list(drawn.values())) != 0.0
    assert np.all(np.sum(there, axis=0) == 1) and np.all(np.any(there, axis=1))


def test_the_bound_of_sx_2():
    """Below 1 n mile at the end, downrange and crossrange, of errors one at a time."""
    errors = np.array([-3.0, 2.0, 1.0]) * nautical_mile
    of = {"downrange_error": errors, "crossrange_error": -0.5 * errors[1:]}
    found = {value.name: value.statistic(of) for value in SX_2.published}
    names = "largest downrange error", "largest crossrange error"
    assert found == pytest.approx(dict(zip(names, (3.0, 1.0), strict=True)))
    assert {value.name: value.value for value in SX_2.published} == dict.fromkeys(
        names, 1.0
    )
    assert {value.unit for value in SX_2.published} == {"n mile"}
    assert SX_2.published_law == "full"
    assert SX_2.published_dispersions == "one-at-a-time"


def test_every_case_of_the_truths_is_compared():
    elsewhere = {"reference", "nominal_errors"}
    here = {"vehicle", "entry", "target", "dispersions", "study", "table_3", "implied"}
    here |= {"assumed", *MONTE_CARLO, *NOMINAL}
    assert set(YAN_HE) == elsewhere | here
    here = {"vehicle", "start", "target", "parameters", "limits", "study", "assumed"}
    assert set(ZHOU) == here | {"dispersions", "table_3", "fit", "polynomial"}


@pytest.mark.parametrize("name", ["apollo-10", "cav-h-glide"])
def test_what_is_tuned_by_default_has_a_size_to_move_by(name):
    mission = ALL[name]
    scenario = mission.scenario()
    leaves = leaves_by_address(scenario)
    assert len(mission.gains) == 2
    for address in mission.gains:
        assert float(leaves[address]) > 0.0
        map_of(address, leaves[address], field_metadata(scenario, address), None)
