"""The neural laws of Apollo 10 and CAV-H: what the pages say of them, flown."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from first_sets import assert_first_runs, fly_few, populations

from jentry.campaign import monte_carlo
from jentry.flight import FixedStep, Flight, Outcome, misses
from jentry.guidance import NeuralLaw
from jentry.missions import find_mission
from jentry.motion import ConstraintValues
from jentry.onboard import load_recurrent_network
from jentry.units import degree, km


LAWS = {
    "apollo-10": ("everything", "jentry.missions.apollo_10.neural_law"),
    "cav-h": ("waves-sensed", "jentry.missions.cav_h.neural_law"),
}

RUNS = 256


def distance(missed):
    """Distance from the target, m."""
    parts = missed.downrange, missed.crossrange, missed.altitude
    return np.sqrt(sum(np.asarray(x) ** 2 for x in parts))


def module_of(mission):
    return __import__(LAWS[mission][1], fromlist=["FOLDER"])


@functools.cache
def campaign(mission, step=None):
    chosen = find_mission(mission)
    scenario = chosen.scenario("neural")
    table = chosen.dispersion_table(LAWS[mission][0])
    solver = FixedStep(step or float(scenario.step))
    return scenario, monte_carlo(
        scenario, table, jax.random.key(0), RUNS, solver=solver
    )


@pytest.mark.parametrize("mission", LAWS)
def test_the_law_flies_the_mission_of_the_other_laws(mission):
    """To the same target, from the same entry, within the same limits."""
    chosen = find_mission(mission)
    neural, other = chosen.scenario("neural"), chosen.scenario("predictor-corrector")
    assert isinstance(neural.guidance, NeuralLaw)
    for part in ("target", "initial_state", "planet", "vehicle", "constraints"):
        mine, theirs = (jax.tree.leaves(getattr(s, part)) for s in (neural, other))
        np.testing.assert_array_equal(np.array(mine), np.array(theirs))
    paper = other if mission == "apollo-10" else chosen.scenario("learning")
    assert eqx.tree_equal(neural.termination, paper.termination)


@pytest.mark.parametrize("mission", LAWS)
def test_the_card_says_how_to_make_it_again(mission):
    module = module_of(mission)
    network, card = load_recurrent_network(module.FOLDER / "law.npz")
    made = f"jentry train {mission} --law neural --seed"
    assert card["command"].startswith(made)
    training = find_mission(mission).law_training("neural")
    assert card["dispersed"] == list(training.dispersions)
    assert network.memory_size == training.memory
    assert network.outputs == 1 + training.with_angle
    assert card["held out distance"]["95 %"] < 0.02


@pytest.mark.slow
@pytest.mark.optimized
@pytest.mark.parametrize("mission", LAWS)
def test_first_runs_of_a_population_are_the_saved_ones(mission):
    reading = LAWS[mission][0]
    scenario, flown = fly_few(mission, "neural", reading)
    assert_first_runs(mission, "neural", reading, scenario, flown, rel=1e-4)


@pytest.mark.slow
@pytest.mark.optimized
@pytest.mark.parametrize("mission", LAWS)
def test_its_flights_end_at_the_target(mission):
    scenario, flown = campaign(mission)
    assert np.all(np.asarray(flown.flights.outcome) == Outcome.REACHED)
    saved = populations.saved()
    reading = LAWS[mission][0]
    row = mission, "neural", reading, "beyond a limit, %"
    over = [
        np.asarray(flown.flights.peaks[name]) > float(each.limit)
        for name, each in scenario.constraints.items()
        if each.limit is not None
    ]
    # A quarter more than the largest of 16 sets.
    heading = {
        "apollo-10": ("miss_distance", "miss, 99th percentile, km", km, 99),
        "cav-h": ("velocity", "maximum", 1.0, 100),
    }
    name, saved_as, size, percent = heading[mission]
    ends = flown.misses
    off = ends.velocity if name == "velocity" else distance(ends)
    found = np.percentile(np.abs(np.asarray(off)), percent) / size
    assert found <= 1.25 * np.max(saved[mission, "neural", reading, saved_as])
    # At most three standard errors above the share of all sets.
    share = np.mean(saved[row]) / 100.0
    most = share + 3.0 * np.sqrt(max(share, 1e-3) / RUNS)
    assert np.mean(np.any(over, axis=0)) <= most


@pytest.mark.slow
@pytest.mark.optimized
@pytest.mark.parametrize("mission", LAWS)
def test_a_shorter_step_flies_the_same(mission):
    """The error of the integration is far below that of the law."""
    scenario, flown = campaign(mission)
    _, fine = campaign(mission, 0.5 * float(scenario.step))
    for name, most in (
        ("downrange", 1e-3),
        ("crossrange", 1e-3),
        ("altitude", 1e-2),
        ("velocity", 1e-3),
    ):
        a, b = (np.asarray(getattr(x.misses, name)) for x in (flown, fine))
        assert np.median(np.abs(a - b)) < most, name


def test_residuals_are_the_errors_at_the_end_and_the_excess_of_limits():
    """Of a flight that misses, by numpy; limits count from 2 % below on."""
    for mission, sizes in (
        ("apollo-10", {"downrange": 1e3, "crossrange": 1e3}),
        (
            "cav-h",
            {
                "velocity": 20.0,
                "altitude": 200.0,
                "crossrange": 200.0,
                "flight_path_angle": 0.2 * degree,
                "heading": 0.2 * degree,
            },
        ),
    ):
        training = find_mission(mission).law_training("neural")
        scenario = find_mission(mission).scenario("neural")
        end = dataclasses.replace(
            scenario.initial_state,
            altitude=jnp.asarray(20e3),
            latitude=jnp.asarray(0.9),
            velocity=jnp.asarray(2400.0),
            heading=jnp.asarray(0.03),
        )
        limits = {
            n: float(c.limit)
            for n, c in scenario.constraints.items()
            if c.limit is not None
        }
        factors = dict(zip(limits, (0.97, 0.99, 1.2), strict=True))
        peaks = dict.fromkeys(scenario.constraints, jnp.asarray(0.0))
        peaks |= {n: jnp.asarray(factors[n] * limits[n]) for n in limits}
        flight = Flight(
            time=jnp.asarray(1.0),
            state=end,
            outcome=jnp.asarray(0),
            ended_by=jnp.asarray(0),
            peaks=ConstraintValues(peaks),
            at_peaks={},
            caveats={},
            history=None,
        )
        missed = misses(scenario, flight)
        expected = [float(getattr(missed, n)) / size for n, size in sizes.items()]
        expected.append(sum(max(0.0, f / 0.98 - 1.0) for f in factors.values()) / 0.01)
        found = training.residuals(scenario, flight)
        np.testing.assert_allclose(list(map(float, found)), expected, rtol=1e-9)


def test_the_angle_of_attack_keeps_the_range_of_the_mission():
    law = find_mission("cav-h").scenario("neural").guidance
    assert float(law.angles.lowest) >= 0.0
    assert float(law.angles.highest) <= 20.0 * degree
