"""Path constraints: values, corridor, peaks and where they were, integrals, one's own."""

import copy
import dataclasses
import pickle

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    ConstantBank,
    free_scenario,
    mars_planet,
    mars_scenario,
    mars_vehicle,
    with_leaf,
)
from scipy.interpolate import CubicSpline

from jentry.addresses import leaves_by_address, unit_of
from jentry.campaign import monte_carlo
from jentry.campaign.results import dataset
from jentry.cli.campaign_report import print_campaign
from jentry.cli.mission_report import print_flight
from jentry.fields import Scalar, optional_scalar, scalar
from jentry.flight import (
    Adaptive,
    AltitudeBelow,
    FixedStep,
    Scenario,
    Termination,
    fly,
)
from jentry.flight.closed_loop import Moving, command, first_measurement
from jentry.guidance import AbstractContinuousLaw
from jentry.motion import (
    AbstractConstraint,
    AbstractDynamics,
    ConstraintValues,
    Controls,
    Drag,
    DynamicPressure,
    EntryState,
    EquilibriumGlide,
    HeatLoad,
    HeatRate,
    LoadFactor,
    NormalLoadFactor,
    PathPoint,
    corridor_point,
    entry_corridor,
    entry_dynamics,
    excesses,
    limit_of,
    usual_constraints,
)
from jentry.plots import glide
from jentry.tuning.losses import penalty
from jentry.units import degree, km


G0 = 9.80665
DENSITY, SCALE_HEIGHT, RADIUS = 0.0158, 9354.5, 3397 * km
"""Of `mars_planet`"""
BETA, LIFT_TO_DRAG = 115.0, 0.18
"""Ballistic coefficient (kg/m2) and lift over drag of `mars_vehicle`"""
GRAVITATION = 4.28283e13


class NoseTemperature(AbstractConstraint):
    """A user's own: radiative equilibrium at the stagnation point."""

    emissivity: Scalar = scalar(0.85, positive=True)
    limit: Scalar | None = optional_scalar(unit="K")
    unit = "K"

    def value(self, point):
        heat_rate = HeatRate().value(point)
        return (heat_rate / (self.emissivity * 5.670374419e-8)) ** 0.25


# Values at a point.


def point(angle_of_attack=0.3, rotation_rate=0.0, **changes):
    state = EntryState(40 * km, 0.1, 0.2, 4000.0, -0.05, 1.1)
    state = dataclasses.replace(state, **changes)
    controls = Controls(angle_of_attack, np.cos(0.7), np.sin(0.7))
    return PathPoint.of(
        mars_planet(rotation_rate=rotation_rate), mars_vehicle(), state, controls
    )


def test_values_at_a_point():
    """Few lines of numpy for each: the coefficients do not depend on anything."""
    density = DENSITY * np.exp(-40 * km / SCALE_HEIGHT)
    pressure = 0.5 * density * 4000.0**2
    drag = pressure / BETA
    lift = LIFT_TO_DRAG * drag
    radius = RADIUS + 40 * km
    heat_rate = 1.7415e-4 * np.sqrt(density) * 4000.0**3
    weight = (GRAVITATION / radius**2 - 4000.0**2 / radius) * np.cos(-0.05)
    expected = [
        (Drag(), drag),
        (DynamicPressure(), pressure),
        (HeatRate(), heat_rate),
        (LoadFactor(), np.hypot(lift, drag) / G0),
        (NormalLoadFactor(), (lift * np.cos(0.3) + drag * np.sin(0.3)) / G0),
        (EquilibriumGlide(), (weight - lift) / G0),
        (EquilibriumGlide(60 * degree), (weight - 0.5 * lift) / G0),
        (NoseTemperature(), (heat_rate / (0.85 * 5.670374419e-8)) ** 0.25),
    ]
    for constraint, value in expected:
        found = constraint.value(point())
        np.testing.assert_allclose(found, value, rtol=1e-12, err_msg=str(constraint))
    np.testing.assert_allclose(HeatLoad().rate(point()), heat_rate, rtol=1e-12)


def test_equilibrium_glide_keeps_the_path_angle():
    """Also over a planet that turns: at a value of zero the path angle has no rate."""
    turning = point(rotation_rate=7e-5)
    rates = entry_dynamics(
        turning.planet,
        turning.vehicle,
        turning.state,
        Controls.from_bank(jnp.asarray(0.4), jnp.asarray(0.3)),
    )
    found = EquilibriumGlide(0.4).value(turning)
    np.testing.assert_allclose(
        found, -4000.0 * rates.flight_path_angle / G0, rtol=1e-14
    )
    assert abs(found - EquilibriumGlide(0.4).value(point())) > 0.01


# Limits and what exceeds them.


def test_what_exceeds_a_limit():
    constraints = {
        "drag": Drag(),
        "heat_rate": HeatRate(2e6),
        "glide": EquilibriumGlide(limit=0.0),
        "load_factor": LoadFactor(4.0),
    }
    values = {"drag": 9.0, "heat_rate": 3e6, "glide": 0.25, "load_factor": 3.9}
    values = ConstraintValues({n: jnp.asarray(x) for n, x in values.items()})
    found = excesses(constraints, values)
    # As shares of the limits; of that of the glide, which is zero, in its own unit.
    assert dict(found) == {"glide": 0.25, "heat_rate": 0.5, "load_factor": 0.0}
    assert constraints["drag"].excess(jnp.asarray(9.0)) == 0.0
    of_flights = ConstraintValues(
        {"a": jnp.array([0.0, 0.5]), "b": jnp.array([1.0, 0.0])}
    )
    assert penalty(of_flights) == 0.5 * (0.25 + 1.0)
    with pytest.raises(ValueError, match="no path constraint .* has a limit"):
        penalty(excesses({"drag": Drag()}, values))


def test_a_limit_is_a_leaf_with_a_unit():
    scenario = constrained_scenario()
    assert unit_of(scenario, "constraints.nose_temperature.limit") == "K"
    leaves = leaves_by_address(scenario)
    assert leaves["constraints.heat_load.limit"] == 5e6
    assert "constraints.drag.limit" not in leaves


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"constraints": {"heat rate": HeatRate()}}, "the name 'heat rate'"),
        ({"constraints": {"drag": eqx.nn.Identity()}}, "constraints.drag is Identity"),
        (
            {"constraints": {"drag_error": Drag()}},
            "'drag_error': columns .* _error are misses; .* drag_deviation",
        ),
        ({"located_peaks": ("heat",)}, "located_peaks has 'heat', .* dynamic_pressure"),
        ({"constraints": {"drag": Drag(np.nan)}}, "constraints.drag.limit is nan"),
    ],
)
def test_bad_constraints_are_refused(change, message):
    given = change.get("constraints", {})
    if all(isinstance(c, AbstractConstraint) for c in given.values()):
        with pytest.raises(ValueError, match=message):
            fly(dataclasses.replace(cheap.scenario(), **change))
        return
    scenario = cheap.scenario()
    object.__setattr__(copied := copy.copy(scenario), "constraints", given)
    with pytest.raises(ValueError, match=message):
        fly(copied)


def test_a_class_without_a_unit_is_refused():
    class Nameless(AbstractConstraint):
        limit: Scalar | None = None

        def value(self, point):
            return point.air.drag

    bad = dataclasses.replace(cheap.scenario(), constraints={"x": Nameless()})
    with pytest.raises(ValueError, match="constraints.x: Nameless has no unit"):
        fly(bad)


# Values by name.


def test_values_by_name():
    values = ConstraintValues({"b": jnp.asarray(2.0), "a": jnp.asarray(1.0)})
    assert list(values) == ["a", "b"] and len(values) == 2
    assert values["b"] == values.b == 2.0
    assert list(leaves_by_address(values)) == ["a", "b"]
    doubled = jax.tree.map(lambda x: 2.0 * x, values)
    assert dict(doubled) == {"a": 2.0, "b": 4.0}
    for again in (copy.deepcopy(values), pickle.loads(pickle.dumps(values))):
        assert dict(again) == dict(values)
    with pytest.raises(AttributeError, match="no path constraint 'c' .* has a, b: add"):
        _ = values.c
    assert not hasattr(values, "_c")


# The corridor.


VELOCITY = np.array([2500.0, 2800.0, 3100.0])


def limits(**limits):
    constraints = {
        "heat_rate": HeatRate(limits.get("heat_rate", 3e5)),
        "dynamic_pressure": DynamicPressure(limits.get("pressure", 9e3)),
        "normal_load": NormalLoadFactor(limits.get("load", 2.0)),
        "glide": EquilibriumGlide(0.0, 0.0),
        "heat_load": HeatLoad(1e7),
        "drag": Drag(),
    }
    velocity, angle = jnp.asarray(VELOCITY), jnp.full(3, 0.4)
    start = EntryState(0.0, 0.0, 0.2, 1.0, -0.3, 1.1)
    points = entry_corridor(
        constraints, mars_planet(), mars_vehicle(), start, velocity, angle
    )
    # In an exponential atmosphere the drag tells the altitude.
    for each in points.values():
        density = 2.0 * BETA * each.drag / VELOCITY**2
        expected = SCALE_HEIGHT * jnp.log(DENSITY / density)
        assert isinstance(each.drag, jax.core.Tracer) or jnp.allclose(
            each.altitude, expected, rtol=1e-10, atol=0.0
        )
    return {name: each.drag for name, each in points.items()}


@pytest.mark.slow
def test_corridor_is_that_of_lee_cho_and_yan():
    """Equations (6) to (9), their heating constant from ours."""
    found = limits()
    assert set(found) == {"heat_rate", "dynamic_pressure", "normal_load", "glide"}
    # (6): the density at which 1.7415e-4 sqrt(density) V^3 is the limit.
    density = (3e5 / (1.7415e-4 * VELOCITY**3)) ** 2
    np.testing.assert_allclose(
        found["heat_rate"], density * VELOCITY**2 / (2.0 * BETA), rtol=1e-10
    )
    normal = LIFT_TO_DRAG * np.cos(0.4) + np.sin(0.4)  # (7)
    np.testing.assert_allclose(found["normal_load"], 2.0 * G0 / normal, rtol=1e-10)
    np.testing.assert_allclose(found["dynamic_pressure"], 9e3 / BETA, rtol=1e-10)  # (9)
    # (8), at the radius where that drag is found.
    altitude = SCALE_HEIGHT * np.log(
        DENSITY * VELOCITY**2 / (2.0 * BETA * np.asarray(found["glide"]))
    )
    radius = RADIUS + altitude
    needed = GRAVITATION / radius**2 - VELOCITY**2 / radius
    np.testing.assert_allclose(found["glide"], needed / LIFT_TO_DRAG, rtol=1e-10)


@pytest.mark.slow
def test_corridor_has_derivatives():
    """The drag goes with the limits of pressure and load, and with the square of (6)'s."""
    for name, power in (("heat_rate", 2.0), ("pressure", 1.0), ("load", 1.0)):
        at = {"heat_rate": 3e5, "pressure": 9e3, "load": 2.0}[name]
        key = {"pressure": "dynamic_pressure", "load": "normal_load"}.get(name, name)

        def drag(limit, name=name, key=key):
            return limits(**{name: limit})[key]

        value, slope = jax.jvp(drag, (jnp.asarray(at),), (jnp.ones(()),))
        np.testing.assert_allclose(slope, power * value / at, rtol=1e-9, err_msg=name)


def test_a_limit_that_is_met_nowhere_and_one_that_is_none():
    where = mars_planet(), mars_vehicle(), point().state, jnp.asarray(0.3)
    nowhere = corridor_point(DynamicPressure(1e9), *where)
    assert np.isnan(nowhere.drag) and np.isnan(nowhere.altitude)
    with pytest.raises(ValueError, match="Drag has no limit"):
        corridor_point(Drag(), *where)
    with pytest.raises(ValueError, match="HeatLoad is no quantity of a point"):
        corridor_point(HeatLoad(1.0), *where)


# In flight.


STEP = FixedStep(0.5)


def constrained_scenario():
    """The usual constraints, an integral and one of a user's own; all peaks located."""
    scenario = free_scenario(50 * degree)
    constraints = {
        **scenario.constraints,
        "heat_load": HeatLoad(5e6),
        "nose_temperature": NoseTemperature(limit=1500.0),
    }
    return dataclasses.replace(
        scenario, constraints=constraints, located_peaks=tuple(constraints)
    )


@pytest.fixture(scope="module")
def campaign():
    """Two runs with their histories at every step."""
    given = {"vehicle.mass": [float(mars_vehicle().mass), 700.0]}
    return monte_carlo(constrained_scenario(), inputs=given, solver=STEP, history=0.5)


@pytest.fixture(scope="module")
def plain():
    return eqx.filter_jit(fly)(free_scenario(50 * degree), STEP, 0.5)


def run_of(tree, run):
    return jax.tree.map(lambda x: jnp.asarray(x)[run], tree)


def first(tree):
    return run_of(tree, 0)


@pytest.mark.slow
def test_what_is_looked_at_does_not_move_the_flight(campaign, plain):
    flight = first(campaign.flights)
    assert set(plain.peaks) == {"drag", "dynamic_pressure", "heat_rate", "load_factor"}
    assert plain.at_peaks == {}
    # Another program: the compiler may order a sum in another way.
    np.testing.assert_allclose(flight.time, plain.time, rtol=1e-12)
    for name, value in leaves_by_address(plain.state).items():
        np.testing.assert_allclose(getattr(flight.state, name), value, rtol=1e-10)
    for name, peak in plain.peaks.items():
        np.testing.assert_allclose(flight.peaks[name], peak, rtol=1e-10)


def test_peaks_are_located(campaign):
    """Where the history, which has every step, has its largest value."""
    for run in range(2):
        flight = jax.tree.map(np.asarray, run_of(campaign.flights, run))
        history = flight.history
        for name, there in flight.at_peaks.items():
            values = history.constraints[name]
            place = np.nanargmax(values)
            if name == "heat_load":  # grows up to the end
                assert there.time == flight.time > history.time[place]
                assert there.state.altitude == flight.state.altitude
                continue
            assert flight.peaks[name] == pytest.approx(values[place], rel=1e-12)
            assert there.time == pytest.approx(history.time[place], abs=1e-9), name
            for component, value in vars(there.state).items():
                expected = getattr(history.states, component)[place]
                assert float(value) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.slow
def test_one_peak_may_be_located(campaign):
    scenario = dataclasses.replace(constrained_scenario(), located_peaks=("heat_rate",))
    flight = fly(scenario, Adaptive())
    assert list(flight.at_peaks) == ["heat_rate"]
    expected = first(campaign.flights.at_peaks["heat_rate"].time)
    # Over the ends of cycles of 1 s.
    assert abs(float(flight.at_peaks["heat_rate"].time) - expected) <= 1.0


def test_heat_load_is_the_integral_of_the_heat_rate(campaign):
    """By a cubic spline through the history, and its last part to the end."""
    for run in range(2):
        flight = jax.tree.map(np.asarray, run_of(campaign.flights, run))
        history = flight.history
        flying = np.isfinite(history.time)
        time, rate = history.time[flying], history.constraints.heat_rate[flying]
        # The end is no entry of the history.
        density = DENSITY * np.exp(-flight.state.altitude / SCALE_HEIGHT)
        last = 1.7415e-4 * np.sqrt(density) * flight.state.velocity**3
        spline = CubicSpline(np.append(time, flight.time), np.append(rate, last))
        # A spline of 0.5 s through what changes within some 10 s.
        expected = spline.integrate(0.0, flight.time)
        np.testing.assert_allclose(flight.peaks.heat_load, expected, rtol=1e-6)
        on_the_way = [spline.integrate(0.0, t) for t in time[[0, 100, 200]]]
        found = history.constraints.heat_load[[0, 100, 200]]
        np.testing.assert_allclose(found, on_the_way, rtol=1e-6)


class StraightDown(AbstractDynamics):
    """At constant velocity along a straight line, whatever the air does."""

    def rates(self, planet, vehicle, state, controls):
        nothing = jnp.zeros_like(state.velocity)
        down = state.velocity * jnp.sin(state.flight_path_angle)
        return EntryState(down, nothing, nothing, nothing, nothing, nothing)


def test_heat_load_of_a_straight_path():
    """In closed form, with its derivative by the scale of the density.

    The root of the density doubles its scale height: with q the heat rate at the end,
    the load is 2 H q (1 - exp(-(top - end) / 2 H)) / (V sin(angle)).
    """
    path = -0.3
    start = EntryState(100 * km, 0.0, 0.0, 5000.0, path, 1.0)
    scenario = Scenario(
        mars_planet(),
        mars_vehicle(),
        start,
        ConstantBank(0.0),
        Termination({"floor": AltitudeBelow(altitude=20 * km)}, 100.0),
        mars_scenario().target,
        dynamics=StraightDown(),
        constraints={"heat_load": HeatLoad()},
    )

    @jax.jit
    def load(scale):
        flight = fly(with_leaf(scenario, lambda s: s.planet.density_scale, scale))
        return flight.peaks.heat_load

    scale = jnp.asarray(1.1)
    found, slope = jax.value_and_grad(load)(scale)
    rate = (
        1.7415e-4 * np.sqrt(1.1 * DENSITY * np.exp(-20 * km / SCALE_HEIGHT)) * 5000.0**3
    )
    depth = 1.0 - np.exp(-80 * km / (2.0 * SCALE_HEIGHT))
    expected = 2.0 * SCALE_HEIGHT * rate * depth / (5000.0 * np.sin(0.3))
    # Steps of 0.1 s, in which the logarithm of the rate changes by less than 0.01.
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    np.testing.assert_allclose(slope, 0.5 * expected / 1.1, rtol=1e-9)


@pytest.mark.slow
def test_derivative_of_a_peak_is_that_without_its_place():
    located = constrained_scenario()
    plain = dataclasses.replace(located, located_peaks=())

    def slope(scenario):
        def peaks(mass):
            flown = with_leaf(scenario, lambda s: s.vehicle.mass, mass)
            flight = fly(flown, FixedStep(1.0))
            return flight.peaks, flight.at_peaks

        return jax.jit(lambda m: jax.jvp(peaks, (m,), (jnp.ones_like(m),)))(
            scenario.vehicle.mass
        )

    _, (ours, of_place) = slope(located)
    _, (expected, _) = slope(plain)
    for name, value in expected.items():
        assert value != 0.0
        np.testing.assert_allclose(ours[name], value, rtol=1e-9, err_msg=name)
    assert not any(np.any(x) for x in jax.tree.leaves(of_place))


# One's own, everywhere.


def test_ones_own_is_in_results_tables_figures_and_penalties(campaign, capsys):
    scenario = constrained_scenario()
    results = dataset(scenario, campaign, 0.5)
    for name, unit, limit in (
        ("nose_temperature", "K", 1500.0),
        ("heat_load", "J/m2", 5e6),
    ):
        peak = results[f"peak_{name}"]
        np.testing.assert_array_equal(peak, campaign.flights.peaks[name])
        assert peak.attrs["units"] == results[name].attrs["units"] == unit
        assert peak.attrs["limit"] == limit
        assert results[f"peak_{name}_time"].attrs["units"] == "s"
        np.testing.assert_array_equal(
            results[f"peak_{name}_velocity"],
            campaign.flights.at_peaks[name].state.velocity,
        )
    assert "limit" not in results["peak_drag"].attrs
    assert results["peak_drag_altitude"].attrs["units"] == "m"

    flight = first(campaign.flights)
    print_flight(cheap.MISSION, scenario, flight)
    printed = capsys.readouterr().out
    rows = [line.split("│") for line in printed.splitlines() if "│" in line]
    shown = {row[1].strip(): (row[2].strip(), row[3].strip()) for row in rows}
    peak = float(flight.peaks["nose_temperature"])
    assert shown["peak nose temperature"] == (f"{peak:.6f}", "K")
    assert shown["limit of the peak nose temperature"] == ("1500.000000", "K")
    time, unit = shown["time at peak nose temperature"]
    assert (float(time), unit) == (flight.at_peaks["nose_temperature"].time, "s")
    print_campaign(cheap.MISSION, results, False)
    printed = " ".join(capsys.readouterr().out.split())
    assert "peak nose temperature" in printed
    hot = int(np.sum(results["peak_nose_temperature"].values > 1500.0))
    count = results.sizes["run"]
    assert f"{hot} of {count} flights exceed the limit of the peak nose" in printed
    assert "limit of the peak drag" not in printed

    names = glide.constraints_of(results)
    usual = ("heat_rate", "dynamic_pressure", "load_factor")
    assert names == (*usual, "heat_load", "nose_temperature")
    panel = glide.over_time(results, names).axes[-1]
    assert panel.get_ylabel() == "Nose temperature (K)"
    np.testing.assert_array_equal(panel.lines[-1].get_ydata(), [1500.0, 1500.0])

    peaks = jax.tree.map(jnp.asarray, campaign.flights.peaks)
    over = jax.vmap(lambda peaks: excesses(scenario.constraints, peaks))(peaks)
    assert set(over) == {"heat_load", "nose_temperature"}
    expected = np.maximum(results["peak_nose_temperature"] / 1500.0 - 1.0, 0.0)
    np.testing.assert_allclose(over["nose_temperature"], expected, rtol=1e-12)


class BanksByTheLimit(AbstractContinuousLaw[None]):
    """A law that reads a limit of the scenario: its bank is the load factor, in rad."""

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        limit = limit_of(measurement.constraints, LoadFactor)
        return Controls.from_bank(limit, 0.0 * limit), None


def test_a_continuous_law_is_told_the_constraints():
    """At the start and wherever it commands, also as it was changed in the scenario."""
    scenario = dataclasses.replace(
        constrained_scenario(),
        guidance=BanksByTheLimit(),
        constraints=usual_constraints() | {"load_factor": LoadFactor(0.25)},
    )
    scenario = eqx.tree_at(
        lambda s: s.constraints["load_factor"].limit, scenario, jnp.asarray(0.5)
    )
    assert limit_of(first_measurement(scenario).constraints, LoadFactor) == 0.5
    moving = Moving(scenario.initial_state, None, None)
    controls, _ = command(scenario, jnp.asarray(0.0), moving, None)
    np.testing.assert_allclose(controls.bank_angle, 0.5, rtol=1e-12)
