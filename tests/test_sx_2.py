"""The SX-2 mission: the cases of the paper, and populations of errors."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry import find_mission, fly, fly_over, ground_track, misses, monte_carlo
from jentry.flight import Outcome
from jentry.missions.sx_2.dispersions import off_by
from jentry.missions.sx_2.mission import cases, figure_case
from jentry.motion.index import EnergyIndex
from jentry.units import nautical_mile


MISSION = find_mission("sx-2")

pytestmark = [pytest.mark.slow, pytest.mark.optimized]


@eqx.filter_jit
@eqx.filter_vmap(in_axes=(None, 0))
def from_here(scenario, start):
    flight = fly(dataclasses.replace(scenario, initial_state=start))
    return flight.outcome, misses(scenario, flight)


def fly_cases(scenario):
    """Errors at the end in n mile, downrange and crossrange: the twelve cases, that of the
    figures, and the nominal one."""
    figures = {"altitude": 1.0, "longitude": 1.0, "latitude": 1.0}
    every = [*cases().values(), figures, {}]
    starts = [off_by(scenario.initial_state, **errors) for errors in every]
    starts = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(y) for y in x]), *starts)
    outcome, missed = from_here(scenario, starts)
    assert np.all(np.asarray(outcome) == Outcome.REACHED)
    return np.stack([missed.downrange, missed.crossrange]) / nautical_mile


def test_every_case_of_the_paper_ends_within_a_mile():
    found = np.abs(fly_cases(MISSION.scenario("full")))
    assert np.all(found[:, :13] < 1.0)
    # The notes have 0.91 for the worst of the twelve. As the README prints them:
    assert np.max(found[:, :12], axis=1) == pytest.approx([0.91, 0.74], abs=0.005)
    assert found[:, 12] == pytest.approx([0.16, 0.22], abs=0.005)
    assert np.all(found[:, 13] < 1e-3)


def test_the_printed_law_flies_its_reference_too():
    found = np.abs(fly_cases(MISSION.scenario("small-angle")))
    assert np.all(found[:, 13] < 1e-3)
    # What the small angles cost: a heading of 43 degrees at the end is none.
    assert np.max(found[:, :12], axis=1) == pytest.approx([2.29, 0.78], abs=0.005)
    assert found[:, 12] == pytest.approx([0.45, 0.25], abs=0.005)


def test_over_the_energy_the_closed_loop_flies_the_same():
    scenario = figure_case()
    last = scenario.termination.conditions["energy"].energy
    over = eqx.filter_jit(fly_over)(scenario, EnergyIndex(), last, 4000)
    flight = eqx.filter_jit(fly)(scenario)
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


def test_combined_initial_errors():
    """Of three sets of 2000 runs, each: the percentiles of the radial miss."""
    scenario = MISSION.scenario("full")
    for seed in range(3):
        found = monte_carlo(
            scenario,
            MISSION.dispersion_table("initial-errors"),
            jax.random.key(seed),
            2000,
        )
        assert np.all(np.asarray(found.flights.outcome) == Outcome.REACHED)
        miss = np.hypot(found.misses.downrange, found.misses.crossrange) / nautical_mile
        median, ninety, ninety_nine = np.percentile(miss, [50, 90, 99])
        assert 0.3 < median < 0.5
        assert 1.0 < ninety < 1.4
        assert 2.0 < ninety_nine < 3.5
