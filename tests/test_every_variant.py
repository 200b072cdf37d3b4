"""What holds for every law, case and former variant of every mission.

To make them all is most of the time: it is done once for all that looks at them.
"""

import dataclasses
import itertools
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from great_circles import by_trigonometry, place_of
from helpers import choices, fly_compiled, free_scenario, moved_alone, with_leaf

from jentry.addresses import leaves_by_address, unit_of
from jentry.flight import FixedStep, check, misses
from jentry.flight.duplicate_numbers import require_both, stated_twice
from jentry.flight.scenario_checks import checked
from jentry.guidance import PredictorCorrector, RangeTracking
from jentry.missions import ALL, find_mission
from jentry.motion import OrbitTarget
from jentry.units import degree


SLOW = pytest.mark.slow


MODEL = r"guidance\.(.*\.)?(model|onboard|domain|planet|prediction)\."
PLACE = r"(initial_state|target\.origin)\."
CIRCLE = r"target\.(apo|peri)apsis_altitude"
TABLE = r"guidance\.(.*\.)?(start|spacing)$"
JUDGED = r"constraints\.\w+_deviation\.reference\."

MEANT = [
    # Two addresses, and why they may be moved apart.
    (MODEL, "", "what a law believes of planet and vehicle, and the truth"),
    (CIRCLE, CIRCLE, "a circular orbit, of which either apsis may be moved"),
    (PLACE, PLACE, "a target is a place: it stays where it is when the start moves"),
    (JUDGED, JUDGED, "two deviations, each from the plan that it is judged by"),
    (JUDGED, r"guidance\.", "a deviation is judged by the plan, whatever a law tracks"),
    (TABLE, TABLE, "the grids of two tables, each of which is one with its numbers"),
    (r"guidance\.", r"attitude\.", "what a law believes of the attitude, or commands"),
    (r"guidance\..*gate\.", r"guidance\..*gate\.", "two laws, each with a gate"),
    (r"guidance\..*gate\.velocity", r".*deviation\.below", "where an error is judged"),
    (r"guidance\..*largest", r"guidance\..*(largest|increment)", "limits in a row"),
    (r"guidance\..*band\.", r"guidance\..*band\.", "two sides of a band"),
    (r"vehicle\.trim", r"(attitude|guidance)\.", "trim, and an angle that is flown"),
    (r"vehicle\.trim", r"vehicle\.aerodynamics", "trim, and an edge of the model"),
    (r"attitude\.", r"attitude\.", "two channels of an attitude"),
    (
        r"guidance\..*\.last$",
        r"(guidance|termination)\..*velocity$",
        "where a schedule ends, and where the flight does",
    ),
]

CHANCE = {
    # Equal numbers that say different things.
    ("guidance.limits.last_range", "termination.conditions.altitude.altitude"),
    ("guidance.limits.last_range", "target.altitude"),
    ("guidance.lateral.floor", "guidance.least_effect"),
    ("planet.atmosphere.waves.0.wavelength", "guidance.arrival.altitude"),
    ("planet.atmosphere.waves.0.wavelength", "target.altitude"),
    ("guidance.initial_roll.constant_drag", "guidance.up_control.fading_drag"),
    ("guidance.constant_drag.lowering", "guidance.last_velocity"),
}


def reasons_for(one, other):
    """Why two addresses may be moved apart."""
    for a, b, reason in MEANT:
        for first, second in ((one, other), (other, one)):
            if re.match(a, first) and re.match(b, second):
                yield reason


def equal_leaves(scenario):
    """Pairs of addresses of numbers with a unit that are equal and not zero.

    Numbers without a unit are equal by chance: factors, gains, weights.
    """
    groups = {}
    for address, leaf in leaves_by_address(scenario).items():
        unit = unit_of(scenario, address)
        if np.ndim(leaf) == 0 and unit != "1" and float(leaf) != 0.0:
            groups.setdefault((float(leaf), unit), []).append(address)
    for addresses in groups.values():
        yield from itertools.combinations(addresses, 2)


def is_refused(scenario, address):
    """Whether one that is moved alone is refused, with its name and another one's."""
    try:
        require_both(scenario, [address])
        check(moved_alone(scenario, address))
    except ValueError as error:
        others = set(re.findall(r"\w+(?:\.\w+)+", str(error)))
        return address in others and len(others) > 1
    return False


@pytest.fixture(scope="module", params=ALL)
def variants(request):
    """The scenarios of a mission, by the text of their choices."""
    mission = find_mission(request.param)
    return {variant: mission.scenario_of(variant) for variant in choices(mission)}


@SLOW
def test_every_number_is_a_leaf(variants):
    """Of whatever a variant is made, each of its numbers has its address from the start."""
    for scenario in variants.values():
        assert [*leaves_by_address(scenario)] == [*leaves_by_address(checked(scenario))]


@SLOW
def test_each_number_stands_once_or_is_guarded(variants):
    """Each leaf of each variant is moved alone: where another has the same value, that is
    refused with both names, or the pair is explained above."""
    for variant, scenario in variants.items():
        check(scenario)
        leaves = set(leaves_by_address(scenario))
        for pair in stated_twice(scenario):
            assert {pair.first, pair.second} <= leaves
        for one, other in equal_leaves(scenario):
            if (one, other) not in CHANCE and not any(reasons_for(one, other)):
                assert is_refused(scenario, one), f"{variant}: {one}, {other}"
                assert is_refused(scenario, other), f"{variant}: {other}, {one}"


@pytest.fixture(scope="module")
def a_flight():
    return fly_compiled(free_scenario(50 * degree), FixedStep(1.0))


def assert_misses_are_those_of_trigonometry(every, flight):
    """From starts that are moved, across the date line and far north: a target that is a
    place stays, and one that is a range is counted from the start of the flight."""
    generator = np.random.default_rng(3)
    scenarios = [s for s in every if not isinstance(s.target, OrbitTarget)]
    # Laws that fly from one start to one target have the same misses.
    different = {
        tuple(map(float, jax.tree.leaves(read))): s
        for s in scenarios
        for read in [(s.initial_state, s.target, s.planet.radius)]
    }
    for nominal in different.values():
        for start in ((179.9, 5.0, 80.0), (-30.0, 60.0, -150.0), (1.0, 0.0, 90.0)):
            moved = eqx.tree_at(
                lambda s: (
                    s.initial_state.longitude,
                    s.initial_state.latitude,
                    s.initial_state.heading,
                ),
                nominal,
                tuple(jnp.asarray(x * degree) for x in start),
            )
            origin = moved.target.origin
            at = place_of(
                moved.initial_state if origin is None else origin, heading=True
            )
            off = generator.uniform(-0.3, 0.3, 2)
            end = dataclasses.replace(
                flight.state,
                longitude=jnp.asarray(at[0] + off[0]),
                latitude=jnp.asarray(np.clip(at[1] + off[1], -1.4, 1.4)),
            )
            ended = dataclasses.replace(flight, state=end)
            missed = misses(moved, ended)
            radius = float(moved.planet.radius)
            along, across = by_trigonometry(radius, at, place_of(end))
            turn = 2 * np.pi * radius
            expected = along - float(moved.target.downrange)
            expected -= turn * np.round(expected / turn)
            # Rounding of a bearing, over the radius of a planet.
            assert float(missed.downrange) == pytest.approx(expected, abs=1e-4)
            expected = across - float(moved.target.crossrange)
            assert float(missed.crossrange) == pytest.approx(expected, abs=1e-4)


@SLOW
def test_misses_of_all_variants_are_those_of_trigonometry(variants, a_flight):
    assert_misses_are_those_of_trigonometry([*variants.values()], a_flight)


@pytest.mark.parametrize("name", ["mars-range-tracking", "sx-2", "rlv"])
def test_misses_of_missions_are_those_of_trigonometry(name, a_flight):
    assert_misses_are_those_of_trigonometry([find_mission(name).scenario()], a_flight)


@SLOW
def test_a_law_that_flies_to_a_place_has_no_place_of_its_own(variants):
    """Where the misses are counted from is where it flies to, and it moves with it."""
    for scenario in variants.values():
        law = scenario.law
        if not isinstance(law, PredictorCorrector | RangeTracking):
            continue
        assert scenario.target.origin is not None
        assert "place" in scenario.target.counted_from
        moved = with_leaf(scenario, lambda s: s.target.downrange, 12.3)
        assert float(moved.law.aim.downrange) == 12.3
        assert not jax.tree.leaves(scenario.guidance.aim)
        moved = with_leaf(scenario, lambda s: s.initial_state.longitude, 0.1)
        assert eqx.tree_equal(moved.law.aim, law.aim)
