"""A run is the same in every batch, and what cannot be flown is refused."""

import dataclasses

import cheap
import equinox as eqx
import jax
import numpy as np
import pytest
from helpers import fly_compiled

from jentry.addresses import replace_leaves
from jentry.campaign import batch, monte_carlo, open_campaign
from jentry.campaign.batch import LANES
from jentry.campaign.campaign import drawn_inputs, fly_in_blocks
from jentry.missions import find_mission
from jentry.motion import EquatorialDynamics


# Lanes, also those of other batches, are compared bit by bit.
pytestmark = [pytest.mark.optimized, pytest.mark.batches]


def fly(key, runs, **options):
    return monte_carlo(
        cheap.scenario(), cheap.dispersions(), key, runs, solver=cheap.SOLVER, **options
    )


def assert_same(one, other):
    """Bit by bit."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    jax.tree.map(np.testing.assert_array_equal, one, other)


def assert_close(one, other):
    """Compiled apart, sums are arranged otherwise: rounding, grown over 300 steps."""
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-9), one, other
    )


def runs_of(campaign, runs):
    return jax.tree.map(lambda x: x[np.asarray(runs)], campaign)


MANY = 3 * LANES + 8


@pytest.fixture(scope="module")
def many():
    return fly(jax.random.key(3), MANY)


def test_every_array_has_the_runs_in_front(many):
    assert np.array_equal(many.runs, np.arange(MANY))
    leaves = jax.tree.leaves(many)
    assert all(isinstance(leaf, np.ndarray) for leaf in leaves)
    assert {leaf.shape for leaf in leaves} == {(MANY,)}
    assert len(np.unique(many.misses.downrange)) == MANY


@pytest.mark.parametrize("run", [0, 3, LANES + 1, MANY - 1])
def test_a_run_alone_is_the_run_in_a_batch(many, run):
    assert_same(fly(jax.random.key(3), [run]), runs_of(many, [run]))


def test_a_run_in_a_batch_of_seven_is_the_run_in_a_larger_batch(many):
    assert_same(fly(jax.random.key(3), 7), runs_of(many, range(7)))


def in_every_lane(scenario, table, run, batches=1, **options):
    """One run as often as flights are flown side by side, on every device, and so many
    times more."""
    drawn = drawn_inputs(scenario, table, jax.random.key(0), np.array([run]))
    count = batches * LANES * len(jax.devices())
    inputs = {a: np.full(count, float(values[0])) for a, values in drawn.items()}
    return monte_carlo(scenario, inputs=inputs, **options)


def assert_all_lanes_alike(campaign):
    """Bit by bit."""
    flown = campaign.flights, campaign.misses
    for path, values in jax.tree_util.tree_flatten_with_path(flown)[0]:
        first = np.broadcast_to(values[0], values.shape)
        where = jax.tree_util.keystr(path)
        np.testing.assert_array_equal(values, first, err_msg=where)


def test_a_run_is_the_same_in_every_lane():
    campaign = in_every_lane(
        cheap.scenario(), cheap.dispersions(), 3, solver=cheap.SOLVER
    )
    assert_all_lanes_alike(campaign)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "variant"),
    [
        ("mars-range-tracking", "range-tracking"),
        ("cav-h", "newton"),
    ],
)
def test_a_run_of_a_mission_is_the_same_in_every_lane(mission, variant):
    """With the noise of accelerometers on cav-h, which is drawn in each lane."""
    mission = find_mission(mission)
    scenario, table = mission.scenario_of(variant), mission.dispersion_table()
    for run in (0, 1):
        one = in_every_lane(scenario, table, run)
        assert_all_lanes_alike(one)
    # Several batches are flown by another program.
    many = in_every_lane(scenario, table, run, batches=2)
    assert_all_lanes_alike(many)
    assert_same(runs_of(many, range(len(one.runs))), one)


def test_runs_are_flown_in_the_order_that_is_asked_for(many):
    wanted = [5, 190, 5, 0]
    assert_same(fly(jax.random.key(3), np.array(wanted)), runs_of(many, wanted))


@pytest.mark.slow
@pytest.mark.parametrize("chunks", [1, 2])
def test_runs_are_the_same_in_any_chunking(many, chunks, monkeypatch):
    monkeypatch.setattr(batch, "_CHUNKS", chunks)
    flown = fly_in_blocks(
        cheap.scenario(),
        cheap.dispersions(),
        jax.random.key(3),
        MANY,
        solver=cheap.SOLVER,
    )
    places, blocks = zip(*flown, strict=True)
    assert list(places) == list(range(len(blocks)))
    sizes = [len(block.runs) for block in blocks]
    assert max(sizes) == chunks * LANES and sum(sizes) == MANY
    assert_same(jax.tree.map(lambda *x: np.concatenate(x), *blocks), many)


def test_given_inputs_fly_as_drawn_ones(many):
    again = monte_carlo(cheap.scenario(), inputs=many.inputs, solver=cheap.SOLVER)
    assert_same(again, many)
    some = monte_carlo(
        cheap.scenario(), inputs=many.inputs, runs=[70, 2], solver=cheap.SOLVER
    )
    assert_same(some, runs_of(many, [70, 2]))


def test_a_run_is_a_flight_of_the_dispersed_scenario(many):
    inputs = {address: values[11] for address, values in many.inputs.items()}
    flight = fly_compiled(replace_leaves(cheap.scenario(), inputs), cheap.SOLVER)
    flown = runs_of(many, 11).flights
    assert_close(flown, flight)


def test_another_key_draws_other_runs(many):
    other = fly(jax.random.key(4), 7)
    assert not np.any(other.misses.downrange == many.misses.downrange[:7])


def test_history_does_not_change_the_runs(many):
    kept = fly(jax.random.key(3), 7, history=20.0)
    ends = eqx.tree_at(lambda c: c.flights.history, kept, None)
    assert_close(ends, runs_of(many, range(7)))
    history = kept.flights.history
    assert history.states.altitude.shape == (7, 15)
    flying = np.isfinite(history.time)
    assert np.array_equal(flying, 20.0 * np.arange(15) < ends.flights.time[:, None])
    assert np.array_equal(history.time[0, :5], 20.0 * np.arange(5))


GOOD = {"vehicle.mass": [900.0, 950.0]}

REFUSED = {
    "nothing dispersed": ({}, "nothing is dispersed"),
    "empty table": ({"dispersions": {}, "key": 0}, "nothing is dispersed"),
    "no key": ({"dispersions": cheap.dispersions}, "dispersions need a key"),
    "both": (
        {"dispersions": cheap.dispersions, "key": 0, "inputs": GOOD},
        "dispersions or inputs, not both",
    ),
    "no runs": ({"dispersions": cheap.dispersions, "key": 0, "runs": 0}, "no runs"),
    "empty list": ({"dispersions": cheap.dispersions, "key": 0, "runs": []}, "no runs"),
    "fewer than no runs": ({"inputs": GOOD, "runs": -3}, "no runs to fly: runs is -3"),
    "negative run": ({"inputs": GOOD, "runs": [-1]}, "run -1 was asked for"),
    "half a run": ({"inputs": GOOD, "runs": np.array([0.5])}, r"runs is \[0.5\]"),
    "run not given": ({"inputs": GOOD, "runs": [2]}, "run 2 was asked for, of 2 given"),
    "more than given": ({"inputs": GOOD, "runs": 3}, "run 2 was asked for, of 2 given"),
    "no inputs": ({"inputs": {}}, "the inputs are empty"),
    "no rows": ({"inputs": {"vehicle.mass": []}}, "no runs to fly"),
    "unknown address": (
        {"inputs": {"vehicle.mas": [1.0]}},
        "no leaf 'vehicle.mas'.*nearest: vehicle.mass",
    ),
    "one number": ({"inputs": {"vehicle.mass": 900.0}}, "one number a run"),
    "unequal lengths": (
        {"inputs": GOOD | {"planet.density_scale": [1.0]}},
        "inputs of unequal length: .*vehicle.mass.*2.*density_scale.*1",
    ),
    "no mass": (
        {"inputs": {"vehicle.mass": [900.0, 0.0]}},
        "vehicle.mass is 0 kg: it must be greater than zero",
    ),
    "not finite": (
        {"inputs": {"vehicle.mass": [900.0, np.nan]}},
        "vehicle.mass is nan: it must be a finite number",
    ),
}


@pytest.mark.parametrize(("options", "message"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_flown_is_refused(options, message):
    options = dict(options)
    if callable(options.get("dispersions")):
        options["dispersions"] = options["dispersions"]()
    if "key" in options:
        options["key"] = jax.random.key(options["key"])
    with pytest.raises(ValueError, match=message):
        monte_carlo(cheap.scenario(), **options)


def test_a_scenario_that_cannot_be_flown_is_refused(key):
    broken = replace_leaves(cheap.scenario(), {"planet.radius": -1.0})
    with pytest.raises(ValueError, match="planet.radius is -1 m"):
        monte_carlo(broken, cheap.dispersions(), key, 2)


def test_a_numpy_number_of_runs_is_a_number(many):
    assert_same(fly(jax.random.key(3), np.arange(8)[7]), runs_of(many, range(7)))


def test_target_stays_where_it_is_when_the_entry_point_is_dispersed():
    east = np.array([0.0, 1e-3])
    campaign = monte_carlo(
        cheap.scenario(), inputs={"initial_state.longitude": east}, solver=cheap.SOLVER
    )
    # Over a sphere that does not turn, a start further east is an end further east.
    moved = campaign.misses.downrange[1] - campaign.misses.downrange[0]
    radius = float(cheap.scenario().planet.radius)
    np.testing.assert_allclose(moved, 1e-3 * radius, rtol=1e-9)  # rounding


def test_what_an_in_plane_flight_does_not_use_is_refused():
    scenario = dataclasses.replace(cheap.scenario(), dynamics=EquatorialDynamics())
    with pytest.raises(ValueError, match="initial_state.heading has no effect"):
        monte_carlo(scenario, inputs={"initial_state.heading": [1.6]})


def test_a_campaign_as_a_dataset_and_in_words(tmp_path):
    """The dataset is that of a stored campaign; the words its numbers in units."""
    scenario, key = cheap.scenario(), jax.random.key(cheap.SEED)
    campaign = monte_carlo(
        scenario, cheap.dispersions(), key, 3, solver=cheap.SOLVER, history=20.0
    )
    results = campaign.to_xarray(scenario, 20.0)
    cheap.campaign(tmp_path, 3, history=20.0)
    stored = open_campaign(tmp_path)
    assert set(results.data_vars) == set(stored.data_vars)
    for name in results.data_vars:
        np.testing.assert_array_equal(results[name], stored[name])
        assert results[name].attrs["units"] == stored[name].attrs["units"]
    with pytest.raises(ValueError, match="give their interval"):
        campaign.to_xarray(scenario)
    lines = campaign.summary(scenario).splitlines()
    assert lines[0] == "3 of 3 reached the end of guided flight"
    (line,) = [x for x in lines if x.startswith("downrange error")]
    *numbers, unit = line.removeprefix("downrange error").split()
    missed = campaign.misses.downrange / 1e3
    expected = np.mean(missed), np.std(missed, ddof=1), np.min(missed), np.max(missed)
    assert [float(x) for x in numbers] == pytest.approx(expected, rel=1e-5)
    assert unit == "km"
    (line,) = [x for x in lines if x.startswith("peak load factor")]
    assert line.endswith(" g")
