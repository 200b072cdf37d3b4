"""The SX-2 mission: the cases of the paper, and populations of errors."""

import equinox as eqx
import jax
import numpy as np
import pytest
from first_sets import populations

from jentry import (
    Scenario,
    find_mission,
    fly,
    fly_over,
    ground_track,
    monte_carlo,
)
from jentry.campaign.campaign import drawn_inputs
from jentry.cli.overrides import apply_values, in_si, read_overrides
from jentry.flight import FixedStep, Outcome
from jentry.missions.sx_2.dispersions import INITIAL_ERRORS, off_by
from jentry.missions.sx_2.mission import cases
from jentry.motion.index import EnergyIndex
from jentry.units import nautical_mile


MISSION = find_mission("sx-2")

pytestmark = [pytest.mark.slow, pytest.mark.optimized]


RUNS = 2000
"""Of a set; where the README speaks of three of them, the first is flown"""

BLOCK = 512
"""Runs that one program flies. All that is flown here is whole blocks, of inputs that name
all that any table moves: so a law is compiled once for the cases and for all sets."""


def populated(scenario, table=None, seed=0, runs=RUNS):
    """Inputs of one set of runs, with all that any table moves; nominal without a table."""
    start, air = scenario.initial_state, scenario.planet.atmosphere
    nominal = {f"initial_state.{name}": getattr(start, name) for name in INITIAL_ERRORS}
    nominal |= {
        "planet.density_scale": 1.0,
        "vehicle.lift_scale": 1.0,
        "vehicle.drag_scale": 1.0,
        "planet.atmosphere.scale_height": air.scale_height,
        "planet.atmosphere.surface_density": air.surface_density,
    }
    given = {name: np.full(runs, float(x)) for name, x in nominal.items()}
    if table is not None:
        drawn = MISSION.dispersion_table(table)
        key = jax.random.key(seed)
        given |= drawn_inputs(scenario, drawn, key, np.arange(runs))
    return {address: np.array(values) for address, values in given.items()}


def fly_cases(scenario):
    """Errors at the end in n mile, downrange and crossrange: the twelve cases, that of the
    figures, and the nominal one."""
    figures = {"altitude": 1.0, "longitude": 1.0, "latitude": 1.0}
    every = [*cases().values(), figures, {}]
    inputs = populated(scenario, runs=BLOCK)
    for run, errors in enumerate(every):
        state = off_by(scenario.initial_state, **errors)
        for name in INITIAL_ERRORS:
            inputs[f"initial_state.{name}"][run] = getattr(state, name)
    return end_errors(scenario, inputs)[:, : len(every)]


def full() -> Scenario:
    """The law `full`, as a schedule of eigenvalues that are the same at each energy: by the
    program that flies the tuned ones. `test_a_schedule_begins_at_the_constant_gains`."""
    return MISSION.scenario("scheduled")


def test_a_schedule_begins_at_the_constant_gains():
    """And is in nothing else another law than `full`."""
    constant, begun = MISSION.scenario("full"), full()
    gains = lambda s: s.guidance.gains
    assert eqx.tree_equal(eqx.tree_at(gains, begun, gains(constant)), constant)
    for energy in gains(begun).energy:
        for found, expected in zip(
            gains(begun).at(0.9 * energy), gains(constant).at(energy), strict=True
        ):
            np.testing.assert_allclose(found, expected, rtol=1e-14)


def end_errors(scenario, inputs):
    """Downrange and crossrange of runs that all reach the end, n mile."""
    found = monte_carlo(scenario, inputs=inputs)
    assert np.all(np.asarray(found.flights.outcome) == Outcome.REACHED)
    missed = found.misses
    return np.stack([missed.downrange, missed.crossrange]) / nautical_mile


def test_every_case_of_the_paper_ends_within_a_mile():
    found = np.abs(fly_cases(full()))
    assert np.all(found[:, :13] < 1.0)
    # The notes have 0.91 for the worst of the twelve. As the README prints them:
    assert np.max(found[:, :12], axis=1) == pytest.approx([0.91, 0.74], abs=0.005)
    assert found[:, 12] == pytest.approx([0.16, 0.22], abs=0.005)
    assert np.all(found[:, 13] < 1e-3)


@pytest.mark.optimized(False)
def test_over_the_energy_the_closed_loop_flies_the_same():
    scenario = MISSION.scenario(case="figures")
    last = scenario.termination.conditions["energy"].energy
    over = eqx.filter_jit(fly_over)(scenario, EnergyIndex(), last, 4000)
    flight = eqx.filter_jit(fly)(scenario, FixedStep(0.25))
    origin = scenario.target.origin
    planet = scenario.planet
    ends = [ground_track(planet, origin, end.state) for end in (over, flight)]
    # 1e-3 n mile is what is asked for; the steps of both leave 6e-4 m.
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-2)
    assert float(over.time) == pytest.approx(float(flight.time), abs=1e-5)


def test_away_from_the_end_of_an_index_there_is_no_flight():
    scenario = MISSION.scenario("full")
    law = scenario.termination.conditions["energy"]
    first = scenario.guidance.model.energy(scenario.initial_state)
    behind = eqx.filter_jit(fly_over)(scenario, EnergyIndex(), first + 1e4, 4000)
    assert np.isnan(float(behind.state.altitude))
    assert float(first) > float(law.energy)
    with pytest.raises(ValueError, match="steps is 0"):
        fly_over(scenario, EnergyIndex(), law.energy, 0)
    with pytest.raises(ValueError, match="Sampled decides at guidance cycles"):
        fly_over(MISSION.scenario("measured"), EnergyIndex(), law.energy, 10)


def test_errors_one_at_a_time_end_within_the_bound_of_the_paper():
    """Every one, in both directions."""
    scenario = full()
    inputs = populated(scenario, "one-at-a-time")
    assert np.max(np.abs(end_errors(scenario, inputs))) < 1.0


def tuned() -> Scenario:
    path = populations.SAVED.with_name("tuned-sx-2.toml")
    given = read_overrides(path)
    start = MISSION.scenario_of(given.choice)
    return apply_values(start, in_si(given, start).values)


def test_tuned_gains_on_draws_that_they_have_not_seen():
    """One of the five sets of the README, none of which is that of the tuning, and the
    cases."""
    scenario = tuned()
    miss = np.hypot(
        *end_errors(scenario, populated(scenario, "initial-errors", seed=1))
    )
    # Below one nautical mile is what is asked for.
    assert 0.465 < np.percentile(miss, 99) < 0.515
    found = np.max(np.abs(fly_cases(scenario))[:, :12], axis=1)
    assert found == pytest.approx([0.24, 0.23], abs=0.005)


def test_combined_initial_errors():
    """The percentiles of the radial miss."""
    scenario = full()
    miss = np.hypot(*end_errors(scenario, populated(scenario, "initial-errors")))
    median, ninety, ninety_nine = np.percentile(miss, [50, 90, 99])
    assert 0.3 < median < 0.5
    assert 1.0 < ninety < 1.4
    assert 2.0 < ninety_nine < 3.5


def miss_of(scenario, inputs):
    """Radial, in n mile; infinite where the flight does not reach the final energy."""
    found = monte_carlo(scenario, inputs=inputs)
    miss = np.hypot(found.misses.downrange, found.misses.crossrange) / nautical_mile
    return np.where(found.flights.outcome == Outcome.REACHED, miss, np.inf), found


@pytest.mark.parametrize("table", ["air-and-vehicle", "initial-errors", "everything"])
def test_replanned_flights_all_arrive(table):
    """Without an exception."""
    scenario = MISSION.scenario("replanned")
    miss, found = miss_of(scenario, populated(scenario, table, runs=BLOCK))
    assert np.max(miss) < 0.1
    assert np.percentile(miss, 99) < 1e-6
    unpredicted = found.flights.caveats["decisions_without_prediction"]
    assert np.max(unpredicted) == 0.0


def test_replanned_where_the_air_is_not_a_factor_off():
    """A scale height off by 5 % turns the density by 4 to 9 % between 60 and 25 km."""
    scenario = MISSION.scenario("replanned")
    height = float(scenario.planet.atmosphere.scale_height)
    surface = float(scenario.planet.atmosphere.surface_density)
    inputs = populated(scenario, "air-and-vehicle", runs=2 * BLOCK)
    other = height * np.random.default_rng(0).uniform(0.95, 1.05, 2 * BLOCK)
    inputs["planet.atmosphere.scale_height"] = other
    same_at = 50e3
    rise = np.exp(same_at / other - same_at / height)
    inputs["planet.atmosphere.surface_density"] = surface * rise
    miss, _ = miss_of(scenario, inputs)
    assert np.percentile(miss, 99) < 0.01 and np.max(miss) < 0.2


def test_replanned_cases_of_the_paper():
    """Nominal below 1e-3 n mile is what is asked for."""
    assert np.all(np.hypot(*fly_cases(MISSION.scenario("replanned"))) < 1e-6)
