"""The ellipsoid: geodetic altitude and latitude, against root finding and by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from worlds import WGS_84

import jentry
from jentry.motion import (
    EntryState,
    GeodeticState,
    from_geodetic,
    geodetic_position,
    to_geodetic,
)
from jentry.units import degree
from jentry.world import (
    ConstantWind,
    Ellipsoid,
    ExponentialAtmosphere,
    InverseSquareGravity,
    Planet,
    Sphere,
)


# IAU 2015 (Archinal et al., Celest. Mech. Dyn. Astron. 130:22, 2018), tables 4.
MARS = Ellipsoid(3396190.0, (3396190.0 - 3376200.0) / 3396190.0)
JUPITER = Ellipsoid(71492e3, (71492e3 - 66854e3) / 71492e3)
BODIES = {"earth": WGS_84, "mars": MARS, "jupiter": JUPITER}

ALTITUDES = np.array([-11e3, -100.0, 0.0, 5.0, 30e3, 120e3, 400e3, 1000e3])
LATITUDES = np.array([-90.0, -89.999, -60.0, -0.001, 0.0, 1e-9, 20.0, 45.0, 90.0])


def planet(shape, radius=6371e3, **changes):
    gravity = InverseSquareGravity(3.986004418e14)
    air = ExponentialAtmosphere(1.225, 7200.0)
    return Planet(radius, gravity=gravity, atmosphere=air, shape=shape, **changes)


def scalars(*numbers):
    return [jnp.asarray(float(x)) for x in numbers]


def points():
    altitude, latitude = np.meshgrid(ALTITUDES, np.radians(LATITUDES))
    return jnp.asarray(altitude.ravel()), jnp.asarray(latitude.ravel())


def by_hand(body, altitude, latitude):
    """Distance from the axis and height over the equator of geodetic coordinates."""
    a, b = float(body.equatorial_radius), float(body.polar_radius)
    sine, cosine = np.sin(latitude), np.cos(latitude)
    support = np.sqrt((a * cosine) ** 2 + (b * sine) ** 2)
    out, up = a * a / support + altitude, b * b / support + altitude
    return out * cosine, up * sine


@pytest.mark.parametrize("name", BODIES)
def test_geodetic_coordinates_are_found_again(name):
    body, (altitude, latitude) = BODIES[name], points()
    out, up = by_hand(body, np.asarray(altitude), np.asarray(latitude))
    radius, below = jax.vmap(body.geocentric)(altitude, latitude)
    np.testing.assert_allclose(radius, np.hypot(out, up), rtol=1e-15)
    np.testing.assert_allclose(below, np.arctan2(up, out), rtol=0, atol=1e-15)
    found, there = jax.vmap(body.geodetic)(radius, below)
    # Rounding of the radius for Earth and Mars; by the iteration, a micrometre for Jupiter.
    tolerance = 1e-8 if name != "jupiter" else 1e-6
    np.testing.assert_allclose(found, altitude, rtol=0, atol=tolerance)
    np.testing.assert_allclose(there, latitude, rtol=0, atol=2e-15)


@pytest.mark.parametrize("latitude", [-75.0, 10.0, 45.0, 89.0])
@pytest.mark.parametrize("altitude", [-5e3, 100e3, 1000e3])
def test_the_geodetic_altitude_is_the_distance_from_the_ellipsoid(altitude, latitude):
    a, b = float(WGS_84.equatorial_radius), float(WGS_84.polar_radius)
    radius, angle = 6371e3 + altitude, np.radians(latitude)
    out, up = radius * np.cos(angle), radius * np.sin(angle)

    def distance(parametric):
        return np.hypot(out - a * np.cos(parametric), up - b * np.sin(parametric))

    near = angle - 0.02, angle + 0.02
    nearest = minimize_scalar(distance, bounds=near, options={"xatol": 1e-12})
    inside = (out / a) ** 2 + (up / b) ** 2 < 1.0
    found = float(WGS_84.altitude(*scalars(radius, angle)))
    # Smallest distances of a search, which are flat in the angle: rounding of 6e6 m.
    assert found == pytest.approx(-nearest.fun if inside else nearest.fun, abs=2e-8)


def test_altitude_and_latitude_by_other_software():
    """The example of EPSG Guidance Note 7-2, section 4.1.1, of WGS 84."""
    x, y, z = 3771793.968, 140253.342, 5124304.349
    out = np.hypot(x, y)
    altitude, latitude = WGS_84.geodetic(*scalars(np.hypot(out, z), np.arctan2(z, out)))
    # Printed to a millimetre, and to a thousandth of a second of arc.
    assert float(altitude) == pytest.approx(73.0, abs=1e-3)
    second = (53.0 + 48.0 / 60.0 + 33.820 / 3600.0) * degree
    assert float(latitude) == pytest.approx(float(second), abs=3e-9)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("latitude", [-90.0, -30.0, 0.0, 45.0, 90.0])
def test_derivatives_are_those_of_the_distance(latitude, order):
    """The gradient of a distance has the length one; the second by differences."""
    here = jnp.asarray([6471e3, latitude * degree])
    slope = jax.grad(lambda x: WGS_84.altitude(*x))
    if order == 1:
        radial, aside = slope(here)
        assert float(jnp.hypot(radial, aside / here[0])) == pytest.approx(1.0, abs=1e-9)
        return
    forward, reverse = jax.jacfwd(slope)(here), jax.jacrev(slope)(here)
    # In metres and radians: rounding of 6e6 m.
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-7)
    step = 1e-4
    ends = [slope(here + jnp.asarray([0.0, s * step])) for s in (1.0, -1.0)]
    by_steps = (ends[0] - ends[1]) / (2.0 * step)
    # Central differences: their curvature, 1e-8, of 43 km/rad2.
    np.testing.assert_allclose(forward[:, 1], by_steps, rtol=0, atol=1e-2)


def test_a_batch_equals_one_by_one():
    altitude, latitude = points()
    radius = 6371e3 + altitude
    batch = jax.vmap(WGS_84.geodetic)(radius, latitude)
    one = jax.jit(lambda r, x: WGS_84.geodetic(r, x))
    alone = [one(r, x) for r, x in zip(radius, latitude, strict=True)]
    np.testing.assert_allclose(np.array(batch).T, alone, rtol=0, atol=3e-9)


@pytest.mark.parametrize("latitude", [-88.0, -40.0, 0.0, 65.0])
def test_states_have_the_velocity_of_their_geodetic_coordinates(latitude):
    earth = planet(WGS_84)
    given = GeodeticState(
        80e3, 0.4, latitude * degree, 7000.0, -20 * degree, 2.0 * np.pi - 0.1
    )
    state = from_geodetic(earth, given)
    out, up = by_hand(WGS_84, 80e3, float(given.latitude))
    assert float(state.altitude) == pytest.approx(np.hypot(out, up) - 6371e3, abs=1e-8)
    assert float(state.latitude) == pytest.approx(np.arctan2(up, out), abs=1e-15)
    tilt = float(given.latitude) - np.arctan2(up, out)

    def velocity(s):
        path, heading = float(s.flight_path_angle), float(s.heading)
        level = np.cos(path) * np.array([np.sin(heading), np.cos(heading)])
        return float(s.velocity) * np.array([*level, np.sin(path)])

    east, north, high = velocity(given)
    # The normal is tilted to the north by `tilt`: so are north and up.
    turned = np.array(
        [
            north * np.cos(tilt) + high * np.sin(tilt),
            high * np.cos(tilt) - north * np.sin(tilt),
        ]
    )
    np.testing.assert_allclose(velocity(state), [east, *turned], rtol=0, atol=1e-11)
    again = to_geodetic(earth, state)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(given), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


def test_on_a_sphere_nothing_changes():
    earth = planet(Sphere())
    state = EntryState(80e3, 0.4, 0.5, 7000.0, -0.3, 1.0)
    assert geodetic_position(earth, state) == (state.altitude, state.latitude)
    assert earth.above(*scalars(0.1, 0.2)) is earth
    assert earth.wind_above(jnp.asarray(0.2)) is earth.wind
    assert earth.geodetic_altitude(state.altitude, state.latitude) is state.altitude


def test_density_speed_of_sound_and_wind_are_those_of_the_geodetic_altitude():
    earth = planet(WGS_84, wind=ConstantWind(10.0, 20.0, 3.0))
    radius, below = WGS_84.geocentric(*scalars(50e3, 60 * degree))
    above = earth.above(0.0 * below, below)
    altitude, high = radius - 6371e3, jnp.asarray(50e3)
    air = earth.atmosphere
    assert float(above.density(altitude)) == pytest.approx(
        float(air.density(high)), rel=1e-12
    )
    for name in ("pressure", "temperature", "speed_of_sound"):
        found = getattr(above.atmosphere, name)(altitude)
        assert float(found) == pytest.approx(float(getattr(air, name)(high)), rel=1e-12)
    tilt = 60 * degree - float(below)
    north = 20.0 * np.cos(tilt) + 3.0 * np.sin(tilt)
    up = 3.0 * np.cos(tilt) - 20.0 * np.sin(tilt)
    for wind in (above.wind, earth.wind_above(below)):
        np.testing.assert_allclose(
            wind.velocity(altitude), [10.0, north, up], rtol=1e-13
        )


@pytest.mark.parametrize("radius", [6371.0, 3396.19e3, 6.371e9, 6378137 * 1.11])
def test_an_ellipsoid_of_another_planet_is_refused(radius):
    """Or one in other units: its altitudes would be thousands of kilometres."""
    with pytest.raises(ValueError, match="radius of 6378.14 km: altitudes would be"):
        planet(WGS_84, radius)
    planet(Sphere(), radius)
    # Saturn, whose mean radius is between the others; one bar (IAU 2015).
    planet(Ellipsoid(60268e3, (60268.0 - 54364.0) / 60268.0), 58232e3)


def test_geodetic_coordinates_in_degrees_are_refused():
    at = lambda *numbers: from_geodetic(planet(WGS_84), GeodeticState(*numbers))
    with pytest.raises(ValueError, match="geodetic.latitude is 45 rad.*mean 45deg"):
        at(120e3, 0.0, 45.0, 7500.0, -0.02, 1.0)
    with pytest.raises(ValueError, match="geodetic.heading is 80 rad"):
        at(120e3, 0.0, 0.5, 7500.0, -0.02, 80.0)
    with pytest.raises(ValueError, match="geodetic.altitude is nan"):
        at(np.nan, 0.0, 0.5, 7500.0, -0.02, 1.0)


def test_density_over_the_altitude_alone_is_refused():
    with pytest.raises(ValueError, match=r"is an Ellipsoid.*give this planet.*Sphere"):
        planet(WGS_84).density(jnp.asarray(1e3))


def test_shapes_are_public():
    assert jentry.Ellipsoid is Ellipsoid and jentry.Sphere is Sphere
