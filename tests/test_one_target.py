"""A scenario has one target: laws fly there, and misses are counted from there."""

import dataclasses

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from great_circles import by_trigonometry, place_of
from helpers import (
    fly_compiled,
    mars_entry,
    mars_scenario,
    with_leaf,
)
from laws import predictor_corrector

from jentry.campaign import Dispersion, monte_carlo
from jentry.campaign.dispersions import add
from jentry.campaign.distributions import Uniform
from jentry.campaign.results import dataset
from jentry.cli.campaign_report import print_campaign
from jentry.cli.options import chosen_scenario
from jentry.flight import FixedStep, check, misses
from jentry.flight.effect import require_felt
from jentry.guidance import Aim
from jentry.missions import find_mission
from jentry.missions.mars import range_tracking as mars_range_tracking
from jentry.units import degree, km


STEP = FixedStep(0.25)


@pytest.fixture(scope="module")
def in_space():
    return mars_range_tracking.three_dimensional()


def test_moving_the_start_moves_nothing_of_the_target(in_space):
    """A start that is a degree nearer: the vehicle ends where it did, and the miss says
    so. Counted from the start it was -59.36 km."""
    nominal = fly_compiled(in_space, STEP)
    moved = with_leaf(in_space, lambda s: s.initial_state.longitude, 1.0 * degree)
    flight = fly_compiled(moved, STEP)
    apart = float(flight.state.longitude - nominal.state.longitude)
    assert abs(apart) * float(in_space.planet.radius) < 0.1 * km
    assert abs(float(misses(moved, flight).downrange)) < 0.1 * km


def test_moving_the_target_moves_the_flight(in_space):
    further = 6.68 * km
    downrange = in_space.target.downrange + further
    moved = with_leaf(in_space, lambda s: s.target.downrange, downrange)
    nominal, flight = fly_compiled(in_space, STEP), fly_compiled(moved, STEP)
    apart = float(flight.state.longitude - nominal.state.longitude)
    assert apart * float(in_space.planet.radius) == pytest.approx(further, abs=100.0)
    assert abs(float(misses(moved, flight).downrange)) < 0.1 * km


@pytest.mark.parametrize("start", [(179.9, 0.0, 90.0), (20.0, 60.0, 40.0)])
def test_delivery_errors_are_flown_out_wherever_the_entry_is(in_space, start):
    """The planet is at rest and round: places and headings are all alike to it."""
    radians = [x * degree for x in start]
    there = [jnp.asarray(x) for x in 2 * radians]
    scenario = eqx.tree_at(
        lambda s: [
            getattr(state, name)
            for state in (s.initial_state, s.target.origin)
            for name in ("longitude", "latitude", "heading")
        ],
        in_space,
        there,
    )
    dispersions = {
        name: Dispersion(
            eqx.Partial(_component, name),
            Uniform(-0.2 * degree, 0.2 * degree),
            apply=add,
        )
        for name in ("longitude", "latitude", "heading")
    }
    found = monte_carlo(scenario, dispersions, jax.random.key(1), runs=8, solver=STEP)
    along, across = by_trigonometry(
        float(scenario.planet.radius),
        tuple(radians),
        place_of(found.flights.state),
    )
    np.testing.assert_allclose(
        found.misses.downrange, along - float(scenario.target.downrange), atol=1e-4
    )
    np.testing.assert_allclose(found.misses.crossrange, across, atol=1e-4)
    assert np.ptp(np.asarray(found.inputs["initial_state.longitude"])) > 0.1 * degree
    # 0.2 degrees of the start are 12 km, which the law takes out.
    assert np.all(np.abs(found.misses.downrange) < 0.2 * km)
    results = found.to_xarray(scenario)
    assert "place" in results["downrange_error"].attrs["counted_from"]


def _component(name, scenario):
    return getattr(scenario.initial_state, name)


def test_a_range_is_counted_from_the_start_of_each_flight():
    """The paper's law knows no place: the whole flight moves with its start, and its
    errors stay."""
    mission = find_mission("mars-drag-tracking")
    scenario = mission.scenario()
    assert scenario.target.origin is None
    given = {"initial_state.longitude": np.array([0.0, 0.5 * degree, 3.0])}
    found = monte_carlo(scenario, None, None, inputs=given, solver=STEP)
    np.testing.assert_allclose(
        found.misses.downrange, found.misses.downrange[0], atol=1e-3
    )
    results = found.to_xarray(scenario)
    assert "start of each flight" in results["downrange_error"].attrs["counted_from"]


def test_a_law_that_flies_to_a_place_refuses_a_target_that_is_none():
    scenario = mars_scenario(predictor_corrector())
    target = dataclasses.replace(scenario.target, origin=None)
    with pytest.raises(ValueError, match=r"target\.origin is None.*give the place"):
        check(dataclasses.replace(scenario, target=target))


def test_a_law_with_an_aim_of_its_own_is_refused_in_a_scenario():
    aim = Aim(mars_entry(), 700 * km, 0.0, 10 * km, 503.0)
    law = dataclasses.replace(predictor_corrector(), aim=aim)
    with pytest.raises(ValueError, match=r"guidance\.aim is an Aim.*leave it out"):
        check(mars_scenario(law))


def test_a_law_outside_of_a_scenario_says_that_it_has_no_target():
    scenario = mars_scenario(predictor_corrector())
    with pytest.raises(ValueError, match=r"scenario\.law"):
        scenario.guidance.range_to_go(scenario.initial_state)


@pytest.mark.parametrize(
    ("mission", "assignment", "message"),
    [
        ("cav-h", "target.downrange=1000km", "say longitude 0 deg.*one target"),
        (
            "cav-h",
            "termination.conditions.target.track.target_longitude=1deg",
            "track.target_latitude say longitude 1 deg",
        ),
        ("mars-drag-tracking", "target.downrange=730km", "move the target and not the"),
        ("rlv", "target.crossrange=10km", "does not read where the target is"),
        ("x-33", "target.origin.longitude=1deg", "does not read where the target is"),
        ("mars-range-tracking", "guidance.aim.downrange=1km", "no leaf"),
    ],
)
def test_half_of_a_target_is_refused(mission, assignment, message):
    """What would move the misses and not the flight, or one of two tracks."""
    with pytest.raises(ValueError, match=message):
        chosen_scenario(mission, (), None, [assignment])


def test_a_target_that_no_law_reads_is_not_dispersed():
    with pytest.raises(ValueError, match="would move the target and not the flight"):
        require_felt(mars_scenario(), ["target.crossrange"])
    require_felt(mars_scenario(predictor_corrector()), ["target.downrange"])


def test_tracks_are_looked_at_within_a_program_too():
    """By gradients within `jit`, where what is not traced is known all the same."""
    scenario = find_mission("cav-h").scenario()

    def looked_at(density, of):
        check(eqx.tree_at(lambda s: s.planet.density_scale, of, density))
        return density

    def slope(of):
        second = jax.grad(jax.jit(lambda density: looked_at(density, of)))
        return jax.jit(lambda density: jax.jvp(second, (density,), (density,)))(1.0)

    assert float(slope(scenario)[0]) == 1.0
    further = scenario.target.downrange + 2 * km
    with pytest.raises(ValueError, match="2 km from there: a scenario has one target"):
        slope(with_leaf(scenario, lambda s: s.target.downrange, further))


@pytest.mark.parametrize(
    "origin, words",
    [(None, "range flown from the start of each flight"), ("start", "place of the")],
)
def test_the_table_of_a_campaign_says_what_errors_are_counted_from(
    capsys, origin, words
):
    given = cheap.scenario()
    origin = given.initial_state if origin else None
    target = dataclasses.replace(given.target, origin=origin)
    given = dataclasses.replace(given, target=target)
    campaign = monte_carlo(
        given, cheap.dispersions(), jax.random.key(0), 8, solver=cheap.SOLVER
    )
    print_campaign(cheap.MISSION, dataset(given, campaign), as_published=False)
    assert f"downrange and crossrange: {words}" in capsys.readouterr().out
