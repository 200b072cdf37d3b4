"""The worlds `inertial` and `aided` of the missions, and their knowledge errors."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from first_sets import populations
from helpers import fly_compiled
from pages import assert_says

from jentry.addresses import leaves_by_address
from jentry.campaign.dispersions import addresses_of_dispersion, check_dispersions
from jentry.flight import FixedStep, Outcome, fly, misses
from jentry.flight.cycle import Plan
from jentry.missions import find_mission
from jentry.onboard import Accelerometers


MISSIONS = {
    "mars-range-tracking": "lift-to-drag-held-and-knowledge",
    "apollo-10": "everything-and-knowledge",
    "cav-h-glide": "everything-and-knowledge",
    "sx-2": "everything-and-knowledge",
    "rlv": "table-1-and-knowledge",
    "msl": "everything-and-knowledge",
}
"""With the name of the set of all their errors"""

SLOW = [
    pytest.param(name, marks=pytest.mark.slow)
    if name != "mars-range-tracking"
    else name
    for name in MISSIONS
]

DECIDED = {
    "mars-range-tracking": {"velocity", "altitude"},
    "apollo-10": set(),
    "cav-h-glide": {"energy"},
    "sx-2": {"energy"},
    "rlv": {"velocity"},
    "msl": {"velocity"},
}
"""Ends that the vehicle decides by what it believes"""


# Where a predicted flight grazes its end, single decisions have none.
pytestmark = pytest.mark.filterwarnings("ignore:.*decisions without prediction")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "worlds"),
    [
        ("mars-range-tracking", ()),
        ("mars-range-tracking", ("in-plane",)),
        ("apollo-10", ()),
    ],
)
def test_the_world_flies_to_an_end_and_without_errors_as_without_it(name, worlds):
    mission = find_mission(name)
    scenario = mission.scenario(world=(*worlds, "inertial"))
    mean = eqx.tree_at(lambda s: s.navigation.seed, scenario, jnp.asarray(0.5))
    walks = (
        lambda s: s.navigation.noise.velocity_random_walk,
        lambda s: s.navigation.noise.angle_random_walk,
    )
    assert all(float(walk(mean)) > 0.0 for walk in walks)
    silent = eqx.tree_at(
        lambda s: [walk(s) for walk in walks], mean, [jnp.zeros(()), jnp.zeros(())]
    )
    noisy, alone, flight = map(
        fly_compiled, (mean, mission.scenario(world=worlds), silent)
    )
    for found in (noisy, alone, flight):
        assert int(found.outcome) == Outcome.REACHED
    assert int(alone.ended_by) == int(flight.ended_by)
    # Believed and actual state differ by rounding, 1e-11 of their sizes, as
    # `test_without_errors_it_is_the_truth` says; the closed loop does not amplify it more.
    there = misses(mission.scenario(world=worlds), alone), misses(scenario, flight)
    for quantity in ("downrange", "crossrange", "altitude", "velocity"):
        a, b = (float(getattr(found, quantity)) for found in there)
        assert b == pytest.approx(a, abs=1e-3), quantity
    off = float(noisy.navigated.altitude - noisy.state.altitude)
    assert 1e-3 < abs(off) < 1e4


@pytest.mark.parametrize("name", SLOW)
def test_the_set_reaches_every_error_and_no_other_leaf(name):
    mission = find_mission(name)
    scenario = mission.scenario(world="inertial")
    errors = "navigation.knowledge.", "navigation.gyroscopes.", "accelerometers."
    expected = {a for a in leaves_by_address(scenario) if a.startswith(errors)}
    table = mission.dispersion_table("knowledge")
    reached = [addresses_of_dispersion(scenario, n, d) for n, d in table.items()]
    found = [address for addresses in reached for address in addresses]
    assert len(found) == len(set(found)) == len(table)
    assert set(found) == expected | {"navigation.seed"}
    usual = mission.dispersion_table()
    both = mission.dispersion_table(MISSIONS[name])
    if name != "sx-2":  # whose first set is the one of the paper
        assert list(both) == [*usual, *table]
    assert both.items() >= table.items()


@pytest.mark.parametrize("name", SLOW)
def test_every_law_takes_the_world(name):
    """Whatever its guidance cycle is, the random walks are added in a cycle that fits."""
    mission = find_mission(name)
    both = mission.dispersion_table(MISSIONS[name])
    for world in ("inertial", "aided"):
        for law in mission.laws:
            scenario = mission.scenario(law, world=world)
            Plan.of(scenario, FixedStep(), None)
            ends = scenario.termination.conditions
            assert {n for n, c in ends.items() if c.by != "truth"} == DECIDED[name]
        check_dispersions(mission.scenario(world=world), both)


@pytest.mark.parametrize("name", SLOW)
def test_the_filter_assumes_the_deviations_of_the_set(name):
    mission = find_mission(name)
    scenario = mission.scenario(world="aided")
    aiding = scenario.navigation.filter
    assumed = {
        "navigation.knowledge.": aiding.knowledge,
        "accelerometers.": aiding.accelerometers,
        "navigation.gyroscopes.": aiding.gyroscopes,
    }
    for start, deviations in assumed.items():
        for end, size in leaves_by_address(deviations).items():
            (found,) = (
                dispersion.distribution.moments()[1]
                for each, dispersion in mission.dispersion_table("knowledge").items()
                if addresses_of_dispersion(scenario, each, dispersion) == [start + end]
            )
            assert float(size) == float(found) > 0.0, start + end
    for walk in ("velocity_random_walk", "angle_random_walk"):
        assert float(getattr(aiding, walk)) == float(
            getattr(scenario.navigation.noise, walk)
        )


@pytest.mark.slow
def test_the_filter_of_the_mars_lander_finds_its_errors():
    """One standard deviation of each error of position and velocity at the start."""
    mission, left = find_mission("mars-range-tracking"), {}
    radius = float(mission.scenario().planet.radius)
    for world in ("inertial", "aided"):
        scenario = mission.scenario(world=world)
        names = [
            f"{words} {end}"
            for words in ("position", "velocity")
            for end in ("east", "north", "up")
        ]
        off = eqx.tree_at(
            lambda s: [
                *(
                    getattr(s.navigation.knowledge, end)
                    for end in "east north up".split()
                ),
                *(
                    getattr(s.navigation.knowledge, f"velocity_{end}")
                    for end in "east north up".split()
                ),
                s.navigation.seed,
            ],
            scenario,
            [jnp.asarray(deviation(mission, n)) for n in names] + [jnp.asarray(0.5)],
        )
        flight = fly_compiled(off)
        assert int(flight.outcome) == Outcome.REACHED
        believed, actual = flight.navigated, flight.state
        east = (believed.longitude - actual.longitude) * np.cos(actual.latitude)
        north, up = (
            believed.latitude - actual.latitude,
            believed.altitude - actual.altitude,
        )
        left[world] = np.linalg.norm([radius * east, radius * north, up])
    # The altimeter errs by 67 m in each of a few dozen measurements.
    assert left["inertial"] > 1500.0
    assert left["aided"] < 67.0


@pytest.mark.slow
def test_the_altitude_from_drag_is_not_believed_too_much():
    """All its measurements together know the density no better than one."""
    mission = find_mission("cav-h-glide")
    scenario = mission.scenario(world="aided")
    drag = scenario.navigation.filter.sensors["drag"]
    assert drag.cycle == 10.0
    flown = 2000.0
    share = np.sqrt(0.30**2 + 0.10**2 + 0.05**2) / 3.0
    together = float(drag.assumed) / np.sqrt(flown / drag.cycle)
    assert together == pytest.approx(share)


def deviation(mission, name):
    return float(mission.dispersion_table("knowledge")[name].distribution.moments()[1])


def test_sizes_are_those_of_the_sources():
    """In their units: km and m/s at three sigma, minutes of arc, ft/s2, micro-g, deg/h."""
    mars, apollo, rlv = map(find_mission, ("mars-range-tracking", "apollo-10", "rlv"))
    arcminute, micro_g = np.radians(1.0 / 60.0), 9.80665e-6
    for axis in ("east", "north", "up"):
        assert 3.0 * deviation(mars, f"position {axis}") == pytest.approx(2800.0)
        assert 3.0 * deviation(mars, f"velocity {axis}") == pytest.approx(2.0)
        assert deviation(apollo, f"tilt {axis}") == pytest.approx(0.5 * arcminute)
        assert 3.0 * deviation(rlv, f"tilt {axis}") == pytest.approx(np.radians(0.26))
    assert 3.0 * deviation(apollo, "bias down") == pytest.approx(0.003 * 0.3048)
    assert deviation(mars, "bias right") == pytest.approx(25.0 * micro_g)
    assert deviation(mars, "scale error forward") == pytest.approx(100e-6)
    # As NavToolkit converts them.
    assert deviation(mars, "drift yaw") == pytest.approx(1.6968e-8, rel=1e-4)
    noise = mars.scenario(world="inertial").navigation.noise
    assert float(noise.angle_random_walk) == pytest.approx(5.8178e-7, rel=1e-4)


def test_the_errors_without_the_world_are_refused():
    mission = find_mission("mars-range-tracking")
    with pytest.raises(
        ValueError, match="PerfectNavigation.*choose the world inertial"
    ):
        check_dispersions(mission.scenario(), mission.dispersion_table("knowledge"))


def test_the_world_without_its_errors_is_refused():
    """Its random walks would be those of one flight."""
    mission = find_mission("mars-range-tracking")
    scenario = mission.scenario(world="inertial")
    with pytest.raises(ValueError, match="disperse navigation.seed by Uniform"):
        check_dispersions(scenario, mission.dispersion_table("independent"))


def test_worlds_that_do_not_go_with_it_are_refused():
    mars = find_mission("mars-range-tracking")
    others = dataclasses.replace(mars.scenario(), accelerometers=Accelerometers())
    with pytest.raises(ValueError, match="accelerometers are Accelerometers, and"):
        mars.worlds["inertial"](others)
    flat = mars.scenario(world=("in-plane", "aided"))
    with pytest.raises(ValueError, match="has a filter and dynamics is Equatorial"):
        fly(flat)


# What the pages say.


def means(mission, choice, dispersions, *headings):
    saved = populations.saved()
    return [np.mean(saved[mission, choice, dispersions, h]) for h in headings]


def test_what_is_said_of_the_mars_lander():
    spreads = "downrange std, km", "crossrange std"
    laws = "predictor-corrector", "range-tracking"
    mission, usual = "mars-range-tracking", "lift-to-drag-held"
    predicted, tracked = (
        means(mission, f"{law} world inertial", f"{usual}-and-knowledge", *spreads)
        for law in laws
    )
    said = "standard deviations of downrange and crossrange error are 0.90 and 0.93 km"
    assert_says(said, *predicted)
    assert_says("and with range tracking 1.01 and 0.96 km", *tracked)
    predicted, tracked = (
        means(mission, f"{law} world aided", f"{usual}-and-knowledge", *spreads)
        for law in laws
    )
    said = "of downrange and crossrange error then fall to 0.029 and 0.014 km"
    assert_says(said, *predicted)
    assert_says("tracking to 0.038 and 0.232 km", *tracked)
    assert_says("the position is known to 0.93 km along each axis", 2.8 / 3.0)
    perfect = [means(mission, law, usual, spreads[0])[0] for law in laws]
    assert_says("the downrange errors are 0.0020 and 0.019 km", *perfect)


def test_what_is_said_of_apollo_10():
    headings = "miss, median, km", "within 1 km, %"
    law = "predictor-corrector"
    perfect = means("apollo-10", law, "everything", *headings)
    known = f"{law} world inertial", "everything-and-knowledge"
    inertial = means("apollo-10", *known, *headings)
    said = "the median of the miss is 1.07 km in place of 0.47 km, and 47 % of the"
    assert_says(said, inertial[0], perfect[0], inertial[1])
    assert_says("within 1 km in place of 98 %", 1, perfect[1])
    aided = means("apollo-10", f"{law} world aided", known[1], *headings)
    assert_says("its median is 0.47 km, and 98 % of the flights", *aided)


def test_what_is_said_of_sx_2():
    headings = "downrange error, median, km", "crossrange error, median, km"
    law = "predictor-corrector"
    known = f"{law} world inertial", "everything-and-knowledge"
    said = "the medians of downrange and crossrange error are 1.32 and 2.27 km"
    assert_says(said, *means("sx-2", *known, *headings))
    aided = means("sx-2", f"{law} world aided", known[1], *headings)
    assert_says("crossrange error are then 0.112 and 0.114 km", *aided)
    perfect = means("sx-2", law, "air-and-vehicle", *headings)
    assert_says("in place of 0.0045 and 0.028 km under", *perfect)


def test_what_is_said_of_the_rlv():
    headings = "downrange error, median, km", "crossrange error, median, km"
    law = "predictor-corrector"
    known = f"{law} world inertial", "table-1-and-knowledge"
    said = "of downrange and crossrange error are then 1.61 and 3.13 km"
    assert_says(said, *means("rlv", *known, *headings))
    perfect = means("rlv", law, "table-1", *headings)
    assert_says("place of 0.143 and 0.031 km with perfect", *perfect)
    aided = means("rlv", f"{law} world aided", known[1], *headings)
    assert_says("The medians are then 0.326 and 0.126 km", *aided)


def test_what_is_said_of_the_glide():
    headings = "miss over ground, median, km", "beyond a limit, %"
    law = "predictor-corrector"
    known = f"{law} world inertial", "everything-and-knowledge"
    median, beyond = means("cav-h-glide", *known, *headings)
    assert beyond == 0.0
    assert_says("The median of the miss over ground is 0.89 km", median)
    perfect = means("cav-h-glide", law, "everything", *headings)[:1]
    assert_says("place of 0.068 km with perfect navigation", *perfect)
    largest = "miss over ground, maximum, km"
    most = np.max(populations.saved()["cav-h-glide", *known, largest])
    assert_says("the largest of 800 flights is 18 km", 800, most)
    aided = f"{law} world aided", known[1]
    (median,) = means("cav-h-glide", *aided, headings[0])
    most = np.max(populations.saved()["cav-h-glide", *aided, largest])
    assert_says(
        "then 0.667 km, and the largest of 800 flights is 2.12", median, 800, most
    )
    growth = np.sqrt(6378137.0**3 / 2.0 / 3.986e14)
    assert_says("by a factor of e in 9.5 minutes", growth / 60.0)
