"""Orbits against vectors in numpy, and burns against textbook transfers."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry import find_mission
from jentry.addresses import replace_leaves
from jentry.flight import check
from jentry.motion import EntryState, OrbitTarget, burns_to, orbit_of
from jentry.units import degree, km
from jentry.world import ConstantGravity, ExponentialAtmosphere, InverseSquareGravity
from jentry.world.planet import Planet


def planet_of(radius, parameter, rotation_rate=0.0):
    return Planet(
        radius=radius,
        gravity=InverseSquareGravity(parameter),
        atmosphere=ExponentialAtmosphere(0.02, 10e3),
        rotation_rate=rotation_rate,
    )


MARS = 3396.2e3, 4.2828e13
TURNS = 7.088e-5
EXITS = {
    "ellipse": (130e3, 0.4, 0.3, 3300.0, 0.05, 0.7),
    "to the west": (130e3, -2.0, -0.6, 3700.0, 0.1, -1.9),
    "hyperbola": (120e3, 0.0, 0.0, 5687.0, -0.1787, 0.664),
}


def by_vectors(state, radius, parameter, rate):
    """Axis, eccentricity, inclination and apses by vectors of the inertial frame."""
    altitude, longitude, latitude, speed, path, heading = state
    (sa, ca), (sb, cb) = ((np.sin(x), np.cos(x)) for x in (longitude, latitude))
    up = np.array([cb * ca, cb * sa, sb])
    east, north = np.array([-sa, ca, 0.0]), np.array([-sb * ca, -sb * sa, cb])
    place = (radius + altitude) * up
    level = np.sin(heading) * east + np.cos(heading) * north
    velocity = speed * (np.sin(path) * up + np.cos(path) * level)
    velocity = velocity + np.cross([0.0, 0.0, rate], place)
    r = np.linalg.norm(place)
    momentum = np.cross(place, velocity)
    vector = np.cross(velocity, momentum) / parameter - place / r
    eccentricity = np.linalg.norm(vector)
    axis = 1.0 / (2.0 / r - velocity @ velocity / parameter)
    apses = axis * (1.0 - eccentricity) - radius, axis * (1.0 + eccentricity) - radius
    inclination = np.arccos(momentum[2] / np.linalg.norm(momentum))
    return axis, eccentricity, inclination, *apses


@pytest.mark.parametrize("name", EXITS)
@pytest.mark.parametrize("rate", [0.0, TURNS])
def test_orbits_are_those_of_vectors(name, rate):
    planet = planet_of(*MARS, rate)
    orbit = orbit_of(planet, EntryState(*EXITS[name]))
    axis, eccentricity, inclination, low, high = by_vectors(EXITS[name], *MARS, rate)
    # Rounding, of altitudes beside the radius.
    assert float(orbit.semi_major_axis) == pytest.approx(axis, rel=1e-11)
    assert float(orbit.eccentricity) == pytest.approx(eccentricity, rel=1e-11)
    assert float(orbit.inclination) == pytest.approx(inclination, rel=1e-11)
    assert float(orbit.periapsis_altitude) == pytest.approx(low, abs=1e-3)
    assert bool(orbit.is_bound) == (axis > 0.0)
    inverse = 1.0 / (high + MARS[0])
    assert float(orbit.inverse_apoapsis_radius) == pytest.approx(inverse, rel=1e-10)
    if axis > 0.0:
        assert float(orbit.apoapsis_altitude) == pytest.approx(high, abs=1e-3)
    else:
        assert np.isinf(orbit.apoapsis_altitude) and orbit.apoapsis_altitude > 0.0


def at_apsis(low, high, inclination=0.0):
    """A state at the lower apsis of an orbit over Mars at rest, due east at a node."""
    radius, parameter = MARS
    near, far = radius + low, radius + high
    speed = np.sqrt(2.0 * parameter * far / (near * (near + far)))
    return EntryState(low, 0.0, 0.0, speed, 0.0, 0.5 * np.pi - inclination)


def burns(low, high, target, inclination=0.0):
    planet = planet_of(*MARS)
    return burns_to(planet, orbit_of(planet, at_apsis(low, high, inclination)), target)


def test_the_periapsis_raise_is_that_of_gelly_and_vernis():
    """From 11 km x 500 km to a circle of 500 km over Mars, 113 m/s as printed."""
    needed = burns(11 * km, 500 * km, OrbitTarget(500 * km, 500 * km))
    assert float(needed.periapsis_raise) == pytest.approx(113.0, abs=0.5)
    assert float(needed.apoapsis_correction) == pytest.approx(0.0, abs=1e-6)
    assert float(needed.plane_change) == 0.0


def test_two_burns_are_a_hohmann_transfer():
    """Vallado, Fundamentals of Astrodynamics, example 6-1: 191.344 km to 35 781.349 km,
    2.457 and 1.478 km/s. The lower burn is left out: the orbit is the transfer."""
    radius, parameter = 6378.137 * km, 398_600.4415e9
    planet = planet_of(radius, parameter)
    low, high = 191.34411 * km, 35_781.34857 * km
    circle = np.sqrt(parameter / (radius + low))
    start = EntryState(low, 0.0, 0.0, circle + 2457.038, 0.0, 0.5 * np.pi)
    needed = burns_to(planet, orbit_of(planet, start), OrbitTarget(high, high))
    assert float(needed.total) == pytest.approx(1478.187, abs=0.05)
    # Back again: the other burn, from the circle above.
    above = np.sqrt(parameter / (radius + high))
    up_there = EntryState(high, 0.0, 0.0, above, 0.0, 0.5 * np.pi)
    back = burns_to(planet, orbit_of(planet, up_there), OrbitTarget(low, low))
    assert float(back.periapsis_raise) == pytest.approx(1478.187, abs=0.05)
    assert float(back.apoapsis_correction) == pytest.approx(2457.038, abs=0.05)


def test_a_wrong_plane_costs_a_burn_at_the_target():
    circle = OrbitTarget(500 * km, 500 * km, 50 * degree)
    needed = burns(100 * km, 500 * km, circle, 48 * degree)
    speed = np.sqrt(MARS[1] / (MARS[0] + 500 * km))
    expected = 2.0 * speed * np.sin(1.0 * degree)
    assert float(needed.plane_change) == pytest.approx(expected, rel=1e-9)


def test_an_orbit_that_is_not_bound_costs_infinitely_much_without_nan_in_derivatives():
    planet, target = planet_of(*MARS, TURNS), OrbitTarget(500 * km, 500 * km)

    def cost(velocity):
        orbit = orbit_of(planet, EntryState(130e3, 0.0, 0.1, velocity, 0.1, 0.7))
        total = burns_to(planet, orbit, target).total
        return total, orbit.apoapsis_altitude, orbit.inverse_apoapsis_radius

    values, slopes = jax.jvp(cost, (jnp.asarray(5600.0),), (jnp.asarray(1.0),))
    assert np.isposinf(values[0]) and np.isposinf(values[1]) and values[2] < 0.0
    assert slopes[0] == slopes[1] == 0.0 and np.isfinite(slopes[2]) and slopes[2] < 0.0
    slope = jax.grad(lambda v: cost(v)[0])
    assert slope(5600.0) == 0.0 and np.isfinite(slope(3400.0))


def test_the_derivative_of_the_cost_is_its_difference():
    planet, target = planet_of(*MARS, TURNS), OrbitTarget(500 * km, 500 * km)

    def cost(velocity):
        state = EntryState(130e3, 0.0, 0.1, velocity, 0.06, 0.7)
        return burns_to(planet, orbit_of(planet, state), target).total

    difference = (cost(3401.0) - cost(3399.0)) / 2.0
    # The second difference of an increment over its steps of 1 m/s.
    assert float(jax.grad(cost)(3400.0)) == pytest.approx(float(difference), rel=1e-4)


def test_a_circle_has_finite_derivatives():
    speed = float(np.sqrt(MARS[1] / (MARS[0] + 500e3)))
    state = EntryState(500e3, 0.0, 0.0, speed, 0.0, 0.5 * np.pi)
    slopes = jax.jacfwd(lambda s: orbit_of(planet_of(*MARS), s))(state)
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(slopes))


def test_a_target_whose_apoapsis_is_below_its_periapsis_is_refused():
    with pytest.raises(ValueError, match="is 400 km and periapsis_altitude 2000 km"):
        OrbitTarget(400e3, 2000e3)
    circle = OrbitTarget(400e3, 400e3)
    scenario = find_mission("mars-aerocapture").scenario()
    moved = dataclasses.replace(scenario, target=circle)
    check(moved)
    moved = replace_leaves(moved, {"target.periapsis_altitude": 401e3})
    with pytest.raises(
        ValueError, match="target, OrbitTarget: apoapsis_altitude is 400"
    ):
        check(moved)


def test_another_gravity_has_no_orbits():
    air = ExponentialAtmosphere(0.02, 10e3)
    flat = Planet(radius=3e6, gravity=ConstantGravity(3.7), atmosphere=air)
    with pytest.raises(ValueError, match="gravity is ConstantGravity.*InverseSquare"):
        orbit_of(flat, EntryState(130e3, 0.0, 0.1, 3400.0, 0.1, 0.7))
