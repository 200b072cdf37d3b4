"""Flights about an oblate planet, against vectors and conserved quantities."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import oblate
import pytest
from external_cases import NOWHERE, sphere_of_nasa
from helpers import ConstantBank, fly_compiled
from worlds import tabulated_atmosphere

from jentry.flight import (
    AltitudeBelow,
    FixedStep,
    Outcome,
    Scenario,
    Termination,
    misses,
)
from jentry.motion import (
    EntryState,
    GeodeticAltitude,
    GeodeticLatitude,
    GeodeticState,
    from_geodetic,
)
from jentry.units import degree, foot, km
from jentry.world import (
    ConstantAerodynamics,
    ConstantWind,
    Ellipsoid,
    ExponentialAtmosphere,
    InverseSquareGravity,
    Planet,
    Sphere,
    USStandardAtmosphere1976,
    Vehicle,
    ZonalGravity,
)


MARS = oblate.Body(4.282837e13, 3396e3, {2: 1.9566e-3}, 7.088e-5, 3396190.0, 1 / 169.9)


def planet(body, atmosphere, radius, **changes):
    harmonics = {f"j{degree}": value for degree, value in body.harmonics.items()}
    return Planet(
        radius,
        gravity=ZonalGravity(body.parameter, body.reference_radius, harmonics),
        atmosphere=atmosphere,
        rotation_rate=body.rotation_rate,
        shape=Ellipsoid(body.equatorial_radius, body.flattening),
        **changes,
    )


def scenario(planet, vehicle, start, duration, bank=0.0, ends=None):
    """A flight at a constant bank, which the time ends unless `ends` do."""
    return Scenario(
        planet,
        vehicle,
        start,
        ConstantBank(bank),
        Termination({} if ends is None else ends, duration, Outcome.REACHED),
        NOWHERE,
        constraints={},
    )


def off(body, flown, radius, state, time):
    """Distance of the ends of two flights, m, and difference of their velocities, m/s."""
    position, velocity = oblate.as_vectors(body, radius, state, time)
    return np.linalg.norm(position - flown[0]), np.linalg.norm(velocity - flown[1])


@pytest.mark.parametrize(
    ("latitude", "heading"), [(0.0, 90.0), (0.0, 0.0), (45.0, 30.0), (-70.0, 200.0)]
)
def test_a_sphere_thrown_over_wgs_84_flies_as_in_vectors(latitude, heading):
    """Thrown upwards at 45 degrees: a fall from rest is singular in speed and angles."""
    air, vehicle = USStandardAtmosphere1976(), sphere_of_nasa()
    geodetic = GeodeticState(
        1e3 * foot,
        0.3,
        latitude * degree,
        1000.0 * np.sqrt(2.0) * foot,
        45 * degree,
        heading * degree,
    )
    radius = 6371e3
    earth = planet(oblate.EARTH, air, radius)
    start = from_geodetic(earth, geodetic)
    flight = fly_compiled(scenario(earth, vehicle, start, 60.0), FixedStep(0.02))
    density = jax.jit(air.density)
    factor = 0.05 * float(vehicle.reference_area / vehicle.mass)
    level, turn = 1000.0 * foot, heading * degree
    begin = oblate.EARTH.from_geodetic(
        1e3 * foot,
        0.3,
        latitude * degree,
        level * np.sin(turn),
        level * np.cos(turn),
        level,
    )
    drag = lambda altitude, speed: factor * float(density(altitude)) * speed**2
    expected = oblate.flown(oblate.EARTH, *begin, 60.0, drag)
    away, slower = off(oblate.EARTH, expected, radius, flight.state, 60.0)
    assert away < 1e-6 * foot
    assert slower < 1e-7 * foot


def lander():
    """Ballistic coefficient 115 kg/m2 and a lift-to-drag ratio of 0.18."""
    return Vehicle(115.0, 1.0, aerodynamics=ConstantAerodynamics(0.18, 1.0))


@pytest.mark.parametrize("wind", [None, (40.0, -60.0, 5.0)], ids=["calm", "wind"])
def test_an_entry_at_mars_flies_as_in_vectors(wind):
    bank, radius = 50 * degree, 3390e3
    changes = {} if wind is None else {"wind": ConstantWind(*wind)}
    mars = planet(MARS, ExponentialAtmosphere(0.0158, 9354.5), radius, **changes)
    start = EntryState(126 * km, 0.2, 35 * degree, 5800.0, -14 * degree, 60 * degree)
    flight = fly_compiled(scenario(mars, lander(), start, 200.0, bank), FixedStep(0.02))

    def drag(altitude, speed):
        return 0.5 * 0.0158 * np.exp(-altitude / 9354.5) * speed**2 / 115.0

    lift = lambda altitude, speed: 0.18 * drag(altitude, speed)
    begin = oblate.as_vectors(MARS, radius, start, 0.0)
    expected = oblate.flown(MARS, *begin, 200.0, drag, lift, bank, wind)
    away, slower = off(MARS, expected, radius, flight.state, 200.0)
    assert away < 1e-6 * foot
    assert slower < 1e-7 * foot


def in_vacuum(latitude_of_start=20 * degree, speed=7500.0):
    """A vehicle that air hardly touches, and a start of a long flight above the Earth."""
    air = ExponentialAtmosphere(1e-30, 7e3)
    start = EntryState(
        400 * km, 0.1, latitude_of_start, speed, 0.4 * degree, 50 * degree
    )
    return planet(oblate.EARTH, air, 6371e3), start


def test_the_jacobi_integral_is_conserved():
    """Energy less that of the rotation: half an orbit with J2, J3 and J4."""
    earth, start = in_vacuum()
    flight = fly_compiled(
        scenario(earth, lander(), start, 2000.0), FixedStep(1.0), 50.0
    )
    position, velocity = np.stack(
        [
            oblate.as_vectors(oblate.EARTH, 6371e3, state, time)
            for state, time in zip(
                rows(flight.history.states), flight.history.time, strict=False
            )
        ],
        axis=1,
    )
    relative = velocity - np.cross([0.0, 0.0, oblate.EARTH.rotation_rate], position)
    spun = oblate.EARTH.rotation_rate * np.hypot(position[:, 0], position[:, 1])
    potential = np.array([oblate.EARTH.potential(each) for each in position])
    jacobi = 0.5 * (relative**2).sum(axis=1) + potential - 0.5 * spun**2
    assert len(jacobi) == 40
    # Of 6e7 J/kg, of which J2 moves 4e4: rounding of 2000 steps.
    np.testing.assert_allclose(jacobi, jacobi[0], rtol=2e-13)


def rows(states):
    columns = [np.asarray(x) for x in jax.tree.leaves(states)]
    flying = np.isfinite(columns[0])
    return [EntryState(*row) for row in np.stack(columns, axis=1)[flying]]


def test_the_node_of_a_circular_orbit_regresses():
    """By -3/2 J2 (R / a)^2 n cos(inclination) to the first order, over one revolution."""
    body = dataclasses.replace(oblate.EARTH, harmonics={2: 1e-6}, rotation_rate=0.0)
    semi_axis, tilt = 7000e3, float(55 * degree)
    motion = np.sqrt(body.parameter / semi_axis**3)
    earth = planet(body, ExponentialAtmosphere(1e-30, 7e3), 6371e3)
    speed = motion * semi_axis
    start = EntryState(semi_axis - 6371e3, 0.0, 0.0, speed, 0.0, 0.5 * np.pi - tilt)
    period = float(2.0 * np.pi / motion)
    steps = 4000
    flight = fly_compiled(
        scenario(earth, lander(), start, period), FixedStep(period / steps)
    )
    position, velocity = oblate.as_vectors(body, 6371e3, flight.state, period)
    normal = np.cross(position, velocity)
    node = np.arctan2(normal[0], -normal[1])
    ratio = body.equatorial_radius / semi_axis
    expected = -1.5 * 1e-6 * ratio**2 * 2.0 * np.pi * np.cos(tilt)
    # The second order is a share of J2, 1e-6; the steps err by some 1e-11 rad.
    assert node == pytest.approx(expected, rel=2e-5)


def descent(latitude, **ends):
    """An entry over Mars that ends by an altitude, from a latitude."""
    mars = planet(MARS, ExponentialAtmosphere(0.0158, 9354.5), 3396190.0)
    start = EntryState(100 * km, 0.0, latitude, 5500.0, -14 * degree, 90 * degree)
    flown = scenario(mars, lander(), start, 600.0, 60 * degree, ends)
    constraints = {
        "geodetic_altitude": GeodeticAltitude(),
        "geodetic_latitude": GeodeticLatitude(),
    }
    return dataclasses.replace(
        flown, constraints=constraints, values_at_end=tuple(constraints)
    )


@pytest.mark.parametrize("latitude", [0.0, 40 * degree, -80 * degree])
def test_an_end_by_altitude_is_at_the_geodetic_altitude(latitude):
    flown = descent(latitude, low=AltitudeBelow(10 * km))
    flight = fly_compiled(flown, FixedStep(0.1))
    assert Outcome(int(flight.outcome)) is Outcome.REACHED
    position, _ = oblate.as_vectors(MARS, 3396190.0, flight.state, 0.0)
    altitude, there = MARS.geodetic(position)
    # The end is found to rounding of a step.
    assert altitude == pytest.approx(10 * km, abs=1e-6)
    assert float(flight.at_end["geodetic_altitude"]) == pytest.approx(
        altitude, abs=1e-8
    )
    assert float(flight.at_end["geodetic_latitude"]) == pytest.approx(there, abs=1e-15)
    # The altitude of the state is that above the sphere: 20 km less at a pole.
    lower = 3396190.0 * np.sin(float(flight.state.latitude)) ** 2 / 169.9
    assert float(flight.state.altitude) == pytest.approx(10 * km - lower, abs=100.0)
    missed = misses(flown, flight).altitude
    assert float(missed) == pytest.approx(10 * km - float(NOWHERE.altitude), abs=1e-6)


def test_without_flattening_and_harmonics_the_flight_is_that_of_a_sphere():
    flown = descent(40 * degree, low=AltitudeBelow(10 * km))
    smooth = dataclasses.replace(MARS, harmonics={2: 0.0}, flattening=0.0)
    oblate_sphere = planet(smooth, flown.planet.atmosphere, 3396190.0)
    sphere = dataclasses.replace(
        oblate_sphere, shape=Sphere(), gravity=InverseSquareGravity(MARS.parameter)
    )
    one, other = (
        fly_compiled(dataclasses.replace(flown, planet=p), FixedStep(0.1)).state
        for p in (oblate_sphere, sphere)
    )
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        # Rounding of the altitude, which is a difference of radii.
        np.testing.assert_allclose(a, b, rtol=1e-10)


@pytest.mark.slow
def test_a_batch_and_derivatives_of_an_oblate_flight():
    flown = descent(40 * degree, low=AltitudeBelow(10 * km))

    def end(j2, flattening):
        moved = dataclasses.replace(
            flown.planet,
            shape=Ellipsoid(3396190.0, flattening),
            gravity=ZonalGravity(MARS.parameter, 3396e3, {"j2": j2}),
        )
        state = fly_compiled(
            dataclasses.replace(flown, planet=moved), FixedStep(1.0)
        ).state
        return jnp.stack([state.longitude, state.velocity / 1e3])

    at = jnp.asarray(1.9566e-3), jnp.asarray(1 / 169.9)
    forward = jnp.stack(jax.jacfwd(end, (0, 1))(*at))
    reverse = jnp.stack(jax.jacrev(end, (0, 1))(*at))
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    for which, step in enumerate((1e-5, 1e-5)):
        moves = step * np.array([[0.0, 0.0], [1.0, 1.0], [-1.0, -1.0]])
        moves[:, 1 - which] = 0.0
        ends = jax.vmap(end)(*(x + moves[:, i] for i, x in enumerate(at)))
        np.testing.assert_allclose(ends[0], end(*at), rtol=1e-13)
        # Central differences: their curvature.
        slope = (ends[1] - ends[2]) / (2.0 * step)
        np.testing.assert_allclose(forward[which], slope, rtol=1e-5)


def test_a_table_of_air_ends_at_a_geodetic_altitude():
    """Near a pole the altitude of the state falls to -9 km, and the table begins at 0."""
    flown = descent(-80 * degree, low=AltitudeBelow(10 * km))
    tabulated = dataclasses.replace(flown.planet, atmosphere=tabulated_atmosphere())
    flight = fly_compiled(dataclasses.replace(flown, planet=tabulated), FixedStep(0.1))
    assert float(flight.state.altitude) < -8 * km
    (distance,) = flight.beyond_tables.values()
    assert float(distance) == 0.0
