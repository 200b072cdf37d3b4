"""Path constraints in flight: peaks, where they are, integrals, and reports."""

import dataclasses

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from constraint_cases import DENSITY, SCALE_HEIGHT, constrained_scenario
from helpers import (
    ConstantBank,
    free_scenario,
    mars_planet,
    mars_scenario,
    mars_vehicle,
    with_leaf,
)
from scipy.interpolate import CubicSpline

from jentry.addresses import leaves_by_address
from jentry.campaign import monte_carlo
from jentry.campaign.results import dataset
from jentry.cli.campaign_report import print_campaign
from jentry.cli.mission_report import print_flight
from jentry.flight import Adaptive, AltitudeBelow, FixedStep, Scenario, Termination, fly
from jentry.flight.lane import Moving
from jentry.flight.sensing import command, first_measurement
from jentry.guidance import AbstractContinuousLaw
from jentry.motion import (
    AbstractDynamics,
    Controls,
    EntryState,
    HeatLoad,
    LoadFactor,
    excesses,
    limit_of,
    usual_constraints,
)
from jentry.plots import glide
from jentry.units import degree, km


STEP = FixedStep(0.5)


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
    exceeded = "limit of the peak nose temperature, exceeded"
    assert peak > 1500.0 and shown[exceeded] == ("1500.000000", "K")
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
