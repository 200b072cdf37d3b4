"""Ends and misses of an aerocapture: captured, escaped, crashed, by Kepler's arcs."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ConstantBank, along_each, fly_compiled, with_leaf
from worlds import WGS_84

from jentry.campaign.results import output_names
from jentry.flight import (
    CapturedAbove,
    EscapedAbove,
    FixedStep,
    Outcome,
    Target,
    fly,
    misses,
)
from jentry.missions import find_mission
from jentry.missions.mars_aerocapture.scenario import entry
from jentry.motion import OrbitTarget, orbit_of
from jentry.units import degree, km


def flown(bank, path, density=1.0):
    scenario = with_leaf(entry(), lambda s: s.guidance, ConstantBank(bank))
    start = scenario.initial_state
    start = dataclasses.replace(start, flight_path_angle=jnp.asarray(path))
    planet = dataclasses.replace(scenario.planet, density_scale=jnp.asarray(density))
    scenario = dataclasses.replace(scenario, initial_state=start, planet=planet)
    return scenario, fly_compiled(scenario, FixedStep(1.0))


def test_without_air_a_hyperbola_escapes_and_has_no_finite_miss():
    scenario, flight = flown(0.0, -8.0 * degree, 1e-12)
    before = orbit_of(scenario.planet, scenario.initial_state)
    after = orbit_of(scenario.planet, flight.state)
    assert flight.outcome == Outcome.SKIPPED_OUT
    assert float(flight.state.altitude) == pytest.approx(125 * km, abs=1e-3)
    # Steps of 1 s, of fourth order.
    assert float(after.energy) == pytest.approx(float(before.energy), abs=1.0)
    assert float(after.inclination) == pytest.approx(
        float(before.inclination), abs=1e-8
    )
    missed = misses(scenario, flight)
    assert np.isposinf(missed.apoapsis) and np.isposinf(missed.velocity_increment)


@pytest.mark.parametrize(
    ("bank", "path", "outcome"),
    [
        (0.0, -8.0 * degree, Outcome.SKIPPED_OUT),
        (60.0 * degree, -10.24 * degree, Outcome.REACHED),
        (180.0 * degree, -11.0 * degree, Outcome.CRASHED),
    ],
)
def test_the_outcome_tells_a_capture_from_an_escape_and_a_crash(bank, path, outcome):
    scenario, flight = flown(bank, path)
    assert flight.outcome == outcome
    bound = bool(orbit_of(scenario.planet, flight.state).is_bound)
    assert bound == (outcome != Outcome.SKIPPED_OUT)
    missed = misses(scenario, flight)
    # A crash would need a start from the ground.
    costs = float(missed.velocity_increment)
    assert (costs < 1000.0) == (outcome == Outcome.REACHED)


def test_misses_of_an_orbit_are_no_misses_of_a_place():
    scenario, flight = flown(60.0 * degree, -10.24 * degree)
    missed, orbit = misses(scenario, flight), orbit_of(scenario.planet, flight.state)
    assert missed.distance is None and missed.downrange is None
    assert float(missed.apoapsis) == float(orbit.apoapsis_altitude) - 500 * km
    off = float(orbit.inclination) - 50 * degree
    assert float(missed.inclination) == pytest.approx(off, abs=1e-15)
    names = output_names(scenario)
    assert {"apoapsis_error", "inclination_error", "velocity_increment"} < set(names)
    assert not {"miss_distance", "downrange_error", "altitude_error"} & set(names)


def test_a_place_has_no_misses_of_an_orbit():
    names = output_names(find_mission("apollo-10").scenario())
    assert not {"apoapsis_error", "velocity_increment"} & set(names)


def test_the_derivative_of_a_miss_is_its_difference():
    scenario, _ = flown(60.0 * degree, -10.24 * degree)

    def apoapsis(paths):
        start = dataclasses.replace(scenario.initial_state, flight_path_angle=paths[0])
        moved = dataclasses.replace(scenario, initial_state=start)
        return misses(moved, fly(moved, FixedStep(1.0))).apoapsis

    slope, difference = along_each(apoapsis, [-10.24 * degree], [1e-7])
    # The second difference over the step.
    np.testing.assert_allclose(slope, difference, rtol=1e-3)


def test_a_law_and_a_target_of_different_kinds_are_refused():
    lander = find_mission("mars-range-tracking").scenario("predictor-corrector")
    orbit = OrbitTarget(500 * km, 500 * km)
    with pytest.raises(
        ValueError, match="flies to a place, and the target .* an orbit"
    ):
        fly(dataclasses.replace(lander, target=orbit))
    orbiter = find_mission("mars-aerocapture").scenario()
    place = Target(10 * km, 500.0, 700 * km, origin=orbiter.initial_state)
    with pytest.raises(
        ValueError, match="flies to an orbit, and the target .* a place"
    ):
        fly(dataclasses.replace(orbiter, target=place))
    with pytest.raises(
        ValueError, match="target is an OrbitTarget.*place on the ground"
    ):
        _ = orbiter.place


@pytest.mark.parametrize(
    ("velocity", "end"), [(4e3, CapturedAbove), (6e3, EscapedAbove)]
)
def test_over_an_ellipsoid_the_exit_is_at_the_geodetic_altitude(velocity, end):
    """At the pole it is higher by the difference of the semi-axes."""
    planet = entry().planet
    shape = dataclasses.replace(WGS_84, equatorial_radius=planet.radius)
    oblate = dataclasses.replace(planet, shape=shape)
    state = dataclasses.replace(
        entry().initial_state, latitude=jnp.asarray(0.5 * jnp.pi), velocity=velocity
    )
    margin = end(altitude=125 * km).margin(state, oblate)
    flattened = float(planet.radius) * float(shape.flattening)
    expected = 125 * km - float(state.altitude) - flattened
    assert float(margin) == pytest.approx(expected, abs=1e-6)
