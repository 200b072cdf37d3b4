"""What a scenario states in two places cannot come apart without a word."""

import dataclasses

import cheap
import jax.numpy as jnp
import numpy as np
import pytest
from commands import assert_refused
from helpers import mars_entry, mars_planet, mars_scenario, moved_alone
from laws import regulator

from jentry import find_mission
from jentry.addresses import leaves_by_address, replace_leaves
from jentry.campaign import Dispersion, Uniform, monte_carlo, multiply
from jentry.campaign.dispersions import check_dispersions
from jentry.flight import EnergyBelow, TargetPassed
from jentry.flight.duplicate_numbers import require_both, stated_twice
from jentry.flight.scenario_checks import check
from jentry.guidance import (
    BankProfile,
    DeviationWeights,
    HeadingCorridor,
    Sampled,
    StoredGainTracking,
)
from jentry.guidance.aim import TargetOfScenario
from jentry.guidance.pseudospectral_tracking import plan_gains
from jentry.onboard.profiles import PolynomialProfile
from jentry.onboard.track import Track
from jentry.parameters.parameters import Parameters
from jentry.units import km
from jentry.world import GroundWave, PerturbedAtmosphere


@pytest.fixture(scope="module")
def lander():
    return find_mission("mars-range-tracking").scenario("predictor-corrector")


def multiplied(*addresses):
    """A dispersion that moves numbers by one factor."""

    def where(scenario):
        found = []
        for address in addresses:
            node = scenario
            for step in address.split("."):
                node = node[step] if isinstance(node, dict) else getattr(node, step)
            found.append(node)
        return tuple(found)

    return Dispersion(where, Uniform(0.99, 1.01), apply=multiply)


@pytest.mark.parametrize("name", ["velocity", "altitude"])
def test_where_a_law_believes_the_end_and_where_the_flight_ends(lander, name):
    address, believed = f"termination.conditions.{name}.{name}", f"guidance.end.{name}"
    with pytest.raises(ValueError, match=rf"{believed} is .* and {address} is"):
        check(moved_alone(lander, address))
    with pytest.raises(ValueError, match=f"{address} is varied"):
        check_dispersions(lander, {"end": multiplied(address)})


def test_a_ceiling_is_that_of_the_flight(lander):
    ceiling = "termination.conditions.skip_out.altitude"
    with pytest.raises(
        ValueError, match=r"end\.ceiling is 135 km and .* is 135\.135 km"
    ):
        check(moved_alone(lander, ceiling))


def test_where_a_replanned_reference_ends_is_where_the_flight_does():
    given = find_mission("sx-2").scenario("replanned")
    energy = "termination.conditions.energy.energy"
    with pytest.raises(ValueError, match=f"guidance.end is .* and {energy} is"):
        check(moved_alone(given, energy))


@pytest.mark.parametrize(
    "mission",
    [
        "mars-drag-tracking",
        pytest.param("rlv", marks=pytest.mark.slow),
        pytest.param("x-33", marks=pytest.mark.slow),
    ],
)
def test_ranges_of_regulators_are_counted_from_a_place(mission):
    law = "with-range" if mission == "x-33" else "pseudospectral-with-range"
    given = find_mission(mission).scenario(law)
    assert "place" in given.target.counted_from
    check(given)


def test_both_together_are_moved(lander):
    three = (
        "termination.conditions.velocity.velocity",
        "guidance.end.velocity",
        "target.velocity",
    )
    check_dispersions(lander, {"end": multiplied(*three)})
    leaves = leaves_by_address(lander)
    check(replace_leaves(lander, {a: leaves[a] * 1.1 for a in three}))
    with pytest.raises(
        ValueError, match=r"target\.velocity, which has the same meaning"
    ):
        check_dispersions(lander, {"end": multiplied(*three[:2])})


def test_a_number_that_differs_already_may_be_moved():
    """An end condition as a bound of the flight, and a target elsewhere."""
    given = mars_scenario()
    pairs = [pair for pair in stated_twice(given) if pair.second == "target.velocity"]
    assert pairs and all(pair.may_differ for pair in pairs)
    apart = replace_leaves(given, {"target.velocity": 450.0})
    check(apart)
    require_both(apart, ["target.velocity"])
    with pytest.raises(ValueError, match="vary both"):
        require_both(given, ["target.velocity"])


@pytest.mark.parametrize(
    "setting, other",
    [
        ("target.velocity=600m/s", "termination.conditions.velocity.velocity"),
        ("termination.conditions.altitude.altitude=9km", "target.altitude"),
    ],
)
def test_commands_refuse_one_of_two(command, setting, other):
    result = command("fly", "mars-drag-tracking", "--set", setting)
    assert_refused(result, f"{other}, which has the same meaning")


def test_inputs_and_tuned_numbers_are_refused_too(lander):
    address = "guidance.end.velocity"
    with pytest.raises(ValueError, match=f"{address} is varied"):
        monte_carlo(lander, inputs={address: [503.0, 504.0]})
    with pytest.raises(ValueError, match=f"{address} is varied"):
        Parameters.of(lander, lambda s: s.guidance.end.velocity)
    all_of_them = lambda s: (
        s.guidance.end.velocity,
        s.target.velocity,
        s.termination.conditions["velocity"].velocity,
    )
    assert len(Parameters.of(lander, all_of_them).addresses) == 3


def test_a_corridor_about_the_bearing_of_another_place_is_refused():
    corridor = HeadingCorridor(0.1, 0.0, 3397 * km, [500.0], [0.1])
    cosine = PolynomialProfile(jnp.array([0.5]))
    given = mars_scenario(Sampled(BankProfile(cosine, lateral=corridor), 1.0))
    with pytest.raises(ValueError, match=r"lateral\.longitude.*5\.729578 deg.*km from"):
        check(given)
    there = replace_leaves(given, {"guidance.law.lateral.longitude": 723.32 / 3397})
    check(there)
    wrong = replace_leaves(there, {"guidance.law.lateral.radius": 3400 * km})
    with pytest.raises(
        ValueError, match=r"radius is 3400 km and planet\.radius is 3397"
    ):
        check(wrong)


def test_a_wave_over_the_ground_has_the_radius_of_the_planet():
    given = cheap.scenario()
    air = PerturbedAtmosphere(
        given.planet.atmosphere, ground_waves=(GroundWave(0.1, 800 * km, 6371 * km),)
    )
    planet = dataclasses.replace(given.planet, atmosphere=air)
    with pytest.raises(ValueError, match=r"ground_waves\.0\.radius is 6371 km"):
        check(dataclasses.replace(given, planet=planet))


@pytest.mark.parametrize("radius", [3397 * km, 3500 * km])
def test_end_conditions_are_of_the_planet_that_is_flown_over(radius):
    """The energy with its radius and gravity, the way along a track on its radius."""
    state = mars_entry()
    planet = dataclasses.replace(mars_planet(), radius=jnp.array(radius))
    state = dataclasses.replace(state, longitude=jnp.array(0.01))
    parameter = float(planet.gravity.gravitational_parameter)
    by_hand = 0.5 * 6750.0**2 - parameter / (radius + 126.1 * km)
    found = EnergyBelow(1e6).margin(state, planet)
    assert float(found) == pytest.approx(by_hand - 1e6, rel=1e-12)
    passed = TargetPassed(Track(0.0, 0.0, 0.2, 0.0))
    way = radius * np.sin(0.2 - 0.01)  # along the track, up to its plane
    assert float(passed.margin(state, planet)) == pytest.approx(way, rel=1e-9)


@pytest.mark.parametrize("away", [0.0, 0.02])
def test_a_regulator_counts_its_range_from_the_origin_of_the_target(away):
    """Where the start is moved, and where the target is."""
    start = dataclasses.replace(mars_entry(), longitude=jnp.array(away))
    law = StoredGainTracking(regulator(), plan_gains(regulator()))
    given = dataclasses.replace(mars_scenario(law), initial_state=start)
    reads = given.law.regulator
    first = reads.reference.at(jnp.array(0.0)).state
    by_hand = away - float(first.downrange) / (3397 * km)
    found = reads.deviation(jnp.array(0.0), start)[3]
    assert float(found) == pytest.approx(by_hand, abs=1e-9)
    moved = replace_leaves(given, {"target.origin.longitude": 0.01}).law.regulator
    found = moved.deviation(jnp.array(0.0), start)[3]
    assert float(found) == pytest.approx(by_hand - 0.01, abs=1e-9)


@pytest.mark.parametrize(
    "weights, aim",
    [(DeviationWeights(downrange=1.0), None), (DeviationWeights(), TargetOfScenario())],
)
def test_a_regulator_says_where_its_range_is_counted_from(weights, aim):
    with pytest.raises(ValueError, match=r"aim=TargetOfScenario\(\) says from where"):
        dataclasses.replace(regulator(), underway=weights, at_end=weights, aim=aim)
