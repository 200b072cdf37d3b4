"""A judgement is of the same new draws, and of the change run by run."""

import functools

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import with_leaf

from jentry.campaign import Discrete, Dispersion
from jentry.campaign.campaign import drawn_inputs
from jentry.flight.miss import misses
from jentry.tuning.batch_gradients import Simulation, batch_outputs
from jentry.tuning.draws import held_out
from jentry.tuning.judgement import Comparison, Estimate, judge
from jentry.tuning.losses import MeanSquare
from jentry.units import km
from jentry.world import EnsembleAtmosphere


RUNS = 100

KEY = held_out(jax.random.key(cheap.SEED))

LOSS = MeanSquare(lambda outputs: outputs["downrange"] / (100.0 * km))


def outputs(scenario, flight):
    """Of which one fails for heavy vehicles in a thick atmosphere, as a flight may."""
    heavy = scenario.vehicle.mass * scenario.planet.density_scale > 1010.0
    missed = misses(scenario, flight)
    return {
        "downrange": jnp.where(heavy, jnp.nan, missed.downrange),
        "end": {"altitude": missed.altitude},
        "outcome": flight.outcome,
        "position": jnp.stack([flight.state.longitude, flight.state.latitude]),
    }


SIMULATION = Simulation(outputs, cheap.SOLVER)


def scenario(density):
    return with_leaf(cheap.scenario(), lambda s: s.planet.density_scale, density)


@functools.cache
def flown(density):
    """Outputs of each run, and which of them are finite; as numpy arrays."""
    inputs = drawn_inputs(scenario(density), cheap.mass_only(), KEY, np.arange(RUNS))
    found = batch_outputs(SIMULATION, scenario(density), inputs)
    return jax.tree.map(np.asarray, found)


@functools.cache
def judged(before, after):
    given = scenario(before), scenario(after), cheap.mass_only(), KEY, RUNS
    return judge(*given, LOSS, SIMULATION)


THICK, THIN = 1.0, 0.9
"""Density scales; the first fails for a third of the masses"""

STATISTICS = {
    "std": lambda x: np.std(x, ddof=1),
    "95 % of |.|": lambda x: np.percentile(np.abs(x), 95.0),
    "mean": np.mean,
}


@pytest.mark.slow
def test_flights_that_are_not_finite_are_counted_and_left_out_of_both():
    _, finite = flown(THICK)
    assert flown(THIN)[1].all()
    assert 0.2 < finite.mean() < 0.9
    judgement = judged(THICK, THIN)
    assert judgement.runs == finite.sum()
    assert judgement.not_finite_before == RUNS - finite.sum()
    assert judgement.not_finite_after == 0
    turned_around = judged(THIN, THICK)
    assert turned_around.runs == judgement.runs
    assert turned_around.not_finite_after == judgement.not_finite_before


def test_all_numbers_of_a_flight_are_compared_and_no_codes_or_tables():
    names = [(c.quantity, c.statistic) for c in judged(THICK, THIN).comparisons]
    quantities = ("downrange", "end.altitude")
    assert names == [("loss", ""), *((q, s) for q in quantities for s in STATISTICS)]


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize("quantity", ["downrange", "end.altitude"])
def test_estimates_are_of_the_runs_that_are_finite_in_both(quantity, statistic):
    both = flown(THICK)[1]
    comparison = judged(THICK, THIN)[quantity, statistic]
    values = []
    for density, estimate in (
        (THICK, comparison.before),
        (THIN, comparison.after),
    ):
        found, _ = flown(density)
        column = {
            "downrange": found["downrange"],
            "end.altitude": found["end"]["altitude"],
        }[quantity]
        values.append(STATISTICS[statistic](column[both]))
        # Sums of a hundred numbers.
        assert estimate.value == pytest.approx(values[-1], rel=1e-12)
        assert estimate.low < estimate.value < estimate.high
    change = comparison.change
    assert change.value == pytest.approx(values[1] - values[0], rel=1e-9)
    assert change.low < change.value < change.high


def test_the_change_is_known_better_than_before_and_after():
    """Run by run the same masses fly: most of the spread is common to both."""
    comparison = judged(THICK, THIN)["downrange", "mean"]
    widths = [
        estimate.high - estimate.low
        for estimate in (comparison.before, comparison.after, comparison.change)
    ]
    assert widths[2] < 0.1 * min(widths[:2])


def test_the_loss_is_compared_as_well():
    both = flown(THICK)[1]
    comparison = judged(THICK, THIN)["loss", ""]
    for density, estimate in ((THICK, comparison.before), (THIN, comparison.after)):
        downrange = flown(density)[0]["downrange"][both] / (100.0 * km)
        assert estimate.value == pytest.approx(np.mean(downrange**2), rel=1e-12)
    assert not comparison.lower and judged(THIN, THICK)["loss", ""].lower


def test_intervals_of_means_are_those_of_the_central_limit():
    both = flown(THICK)[1]
    found = flown(THIN)[0]["downrange"][both]
    estimate = judged(THICK, THIN)["downrange", "mean"].after
    half = 1.96 * found.std() / np.sqrt(both.sum())
    # Two percentiles of a thousand resamples are good to some 5 % of the width each.
    assert estimate.high - estimate.value == pytest.approx(half, rel=0.2)
    assert estimate.value - estimate.low == pytest.approx(half, rel=0.2)


def test_a_scenario_against_itself_has_not_changed():
    """The interval of nothing is what rounding does: 1e-16 of a hundred kilometres and
    of what leads there, ten times."""
    for comparison in judged(THIN, THIN).comparisons:
        assert comparison.before == comparison.after
        change = comparison.change
        assert change.value == 0.0 and not comparison.lower
        unit = 1.0 if comparison.quantity == "loss" else 100.0 * km
        assert -1e-11 * unit < change.low < 0.0 < change.high < 1e-11 * unit


def test_rounding_is_no_other_choice():
    """The profile of an ensemble stays: beside it is none, and the flight would fail."""
    known = cheap.scenario()
    altitude = np.linspace(0.0, 130e3, 30)
    density = np.array([float(known.planet.density(jnp.asarray(h))) for h in altitude])
    air = EnsembleAtmosphere(altitude, np.stack([0.9 * density, density]))
    before = with_leaf(known, lambda s: s.planet.atmosphere, air)
    profile = lambda s: s.planet.atmosphere.profile
    table = {"air": Dispersion(profile, Discrete([1.0]))}
    after = with_leaf(before, lambda s: s.vehicle.mass, 992.0 * (1.0 + 1e-14))
    simulation = Simulation(
        lambda s, f: {"downrange": misses(s, f).downrange}, cheap.SOLVER
    )
    judgement = judge(before, after, table, KEY, RUNS, LOSS, simulation)
    change = judgement["downrange", "mean"].change
    assert change.value != 0.0 and change.low < 0.0 < change.high


def test_nothing_is_compared_where_all_flights_fail():
    judgement = judged(THIN, 1.2)
    assert judgement.runs == 0 and judgement.comparisons == ()
    assert judgement.not_finite_after == RUNS


def test_an_unknown_comparison_is_refused_with_those_there_are():
    with pytest.raises(
        KeyError, match="no comparison .*'std'.*there are .*downrange, std"
    ):
        judged(THIN, THIN)["dowrange", "std"]


@pytest.mark.parametrize(
    ("low", "high", "lower"),
    [(-2.0, -1.0, True), (-2.0, 1.0, False), (1.0, 2.0, False)],
)
def test_lower_is_beyond_the_confidence_interval(low, high, lower):
    change = Estimate(0.5 * (low + high), low, high)
    before = Estimate(10.0, 1.0, 20.0)
    assert Comparison("downrange", "std", before, before, change).lower is lower


def test_held_out_draws_are_others_than_those_tuned_with():
    keys = [jax.random.key(seed) for seed in range(3)]
    keys += [held_out(key) for key in keys]
    draws = [
        drawn_inputs(scenario(THIN), cheap.mass_only(), key, np.arange(64))
        for key in keys
    ]
    masses = np.concatenate([inputs["vehicle.mass"] for inputs in draws])
    assert len(np.unique(masses)) == len(masses)
