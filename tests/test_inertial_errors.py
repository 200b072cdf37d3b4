"""Errors of inertial navigation against their closed forms."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_vehicle
from scipy.spatial.transform import Rotation

from jentry._integrate import runge_kutta
from jentry.motion import AirData, Controls, EntryState
from jentry.onboard import (
    AbstractAccelerometers,
    Actual,
    BodyAccelerometers,
    Gyroscopes,
    InertialNavigation,
    KnowledgeError,
    PerfectAccelerometers,
)
from jentry.units import degree
from jentry.world import (
    ConstantGravity,
    ExponentialAtmosphere,
    InverseSquareGravity,
    Planet,
)


EARTH_RADIUS, EARTH_GRAVITY = 6371e3, 9.81

FAST = 2e4
"""Faster than any force of these tests brings to rest, m/s"""


def still(gravity, radius=EARTH_RADIUS):
    """A planet that does not turn."""
    return Planet(radius, gravity=gravity, atmosphere=ExponentialAtmosphere(1.2, 7e3))


def scalars(*numbers):
    return [jnp.asarray(float(x)) for x in numbers]


FLAT = still(ConstantGravity(0.0), 1e11)
EARTH = still(InverseSquareGravity(EARTH_GRAVITY * EARTH_RADIUS**2))


class Sensing(AbstractAccelerometers):
    """Senses by other accelerometers a force that is the same all the time."""

    others: AbstractAccelerometers
    lift: jax.Array
    drag: jax.Array

    def read(self, air, sampled_at):
        same = dataclasses.replace(air, lift=self.lift, drag=self.drag)
        return self.others.read(same, sampled_at)


def navigated(
    seconds, navigation, others=None, lift=0.0, drag=0.0, planet=EARTH, speed=10.0
):
    """East, north, up (m) of the believed place from the actual one, of a vehicle that
    flies east along the equator at an altitude of zero, with constant speed."""
    state = EntryState(0.0, 0.0, 0.0, speed, 0.0, 90.0 * degree)
    sensing = Sensing(others or PerfectAccelerometers(), *scalars(lift, drag))
    controls = Controls.from_bank(jnp.asarray(0.0), jnp.asarray(0.0))

    def slope(time, known):
        longitude = speed * time / planet.radius
        here = dataclasses.replace(state, longitude=longitude)
        actual = Actual(planet, mars_vehicle(), here, controls, sensing)
        return navigation.rate(actual, known, None)

    first = navigation.start(planet, state)
    fly_on = jax.jit(lambda: runge_kutta(slope, 0.0, seconds, first, 400))
    believed = fly_on().state
    longitude = believed.longitude - speed * seconds / planet.radius
    place = longitude * planet.radius, believed.latitude * planet.radius
    return np.array([*place, believed.altitude], float)


def held(speed=10.0):
    """Specific force up that holds the altitude, m/s2."""
    return EARTH_GRAVITY - speed**2 / EARTH_RADIUS


def test_a_bias_in_free_flight_grows_with_the_square_of_time():
    """b t^2 / 2, over a flat field without gravity."""
    bias, seconds = np.array([1e-3, 2e-3, -3e-3]), 300.0
    others = BodyAccelerometers(*bias)
    off = navigated(
        seconds,
        InertialNavigation(),
        others,
        planet=FLAT,
        speed=FAST,
        lift=-(FAST**2) / float(FLAT.radius),  # which holds the altitude
    )
    # Forward is east, right south, and down.
    expected = np.array([1.0, -1.0, -1.0]) * bias * seconds**2 / 2.0
    np.testing.assert_allclose(off, expected, rtol=1e-3)


def test_an_error_of_altitude_diverges_exponentially():
    """As cosh(t sqrt(2 g / r)), (12.11) of Titterton and Weston."""
    rate = np.sqrt(2.0 * EARTH_GRAVITY / EARTH_RADIUS)
    for seconds in (300.0, 900.0, 1800.0):
        off = navigated(
            seconds, InertialNavigation(KnowledgeError(up=1.0)), lift=held()
        )
        assert off[2] == pytest.approx(np.cosh(rate * seconds), rel=1e-3)


def test_a_horizontal_error_swings_with_the_period_of_schuler():
    """84.4 minutes; an error of the velocity to the north is v sin(w t) / w."""
    rate = np.sqrt(EARTH_GRAVITY / EARTH_RADIUS)
    assert 2.0 * np.pi / rate / 60.0 == pytest.approx(84.4, abs=0.05)
    navigation = InertialNavigation(KnowledgeError(velocity_north=0.01))
    for share in (0.1, 0.25, 0.5, 0.75):
        seconds = share * 2.0 * np.pi / rate
        off = navigated(seconds, navigation, lift=held())
        expected = 0.01 / rate * np.sin(rate * seconds)
        assert off[1] == pytest.approx(expected, abs=0.002 * 0.01 / rate)


@pytest.mark.parametrize(
    ("turn", "direction"),
    [
        # The force is to the rear: what turns with the instrument senses it to the left
        # of its own rear, or above it.
        ({"misalignment_yaw": 1e-3}, [0.0, -1.0, 0.0]),
        ({"misalignment_pitch": 1e-3}, [0.0, 0.0, 1.0]),
        ({"misalignment_roll": 1e-3}, [0.0, 0.0, 0.0]),
    ],
)
def test_a_misalignment_of_1_mrad_at_10_g(turn, direction):
    force, seconds = 98.1, 20.0
    off = [
        navigated(
            seconds, InertialNavigation(), others, drag=force, planet=FLAT, speed=FAST
        )
        for others in (BodyAccelerometers(**turn), BodyAccelerometers())
    ]
    expected = np.array(direction) * 1e-3 * force * seconds**2 / 2.0
    np.testing.assert_allclose(off[0] - off[1], expected, rtol=5e-3, atol=1e-3)


def test_a_drift_tilts_with_time():
    """Position error f d t^3 / 6: the force to the rear is believed to turn left when the
    vehicle is believed to turn right, and down when it is believed to pitch up."""
    force, seconds, drift = 98.1, 20.0, 1e-5
    size = force * drift * seconds**3 / 6.0
    exact = navigated(
        seconds, InertialNavigation(), drag=force, planet=FLAT, speed=FAST
    )
    for which, direction in (
        ("drift_yaw", [0.0, 1.0, 0.0]),
        ("drift_pitch", [0.0, 0.0, -1.0]),
        ("drift_roll", [0.0, 0.0, 0.0]),
    ):
        navigation = InertialNavigation(gyroscopes=Gyroscopes(**{which: drift}))
        off = (
            navigated(seconds, navigation, drag=force, planet=FLAT, speed=FAST) - exact
        )
        np.testing.assert_allclose(off / size, direction, atol=5e-3)


def test_a_tilt_turns_the_force():
    """About the direction to the north: the force up is believed to lean to the east."""
    force, seconds, tilt = 98.1, 20.0, 1e-4
    size = tilt * force * seconds**2 / 2.0
    exact = navigated(
        seconds, InertialNavigation(), lift=force, planet=FLAT, speed=FAST
    )
    for which, direction in (
        ("tilt_north", [1.0, 0.0, 0.0]),
        ("tilt_east", [0.0, -1.0, 0.0]),
        ("tilt_up", [0.0, 0.0, 0.0]),
    ):
        navigation = InertialNavigation(KnowledgeError(**{which: tilt}))
        off = (
            navigated(seconds, navigation, lift=force, planet=FLAT, speed=FAST) - exact
        )
        np.testing.assert_allclose(off / size, direction, atol=5e-3)


def test_accelerometers_of_the_body_sense_along_their_axes():
    """Against a rotation matrix of scipy: forward is above the velocity by the angle of
    attack, and the instrument is turned from there."""
    angle, lift, drag = 0.6, 7.0, 30.0
    air = AirData(*scalars(1e-3, 5e3, 1.2e4, 15.0, lift, drag, angle))
    bias, scale, turn = [0.01, -0.02, 0.03], [4e-4, 0.0, -7e-4], [1e-5, 2e-5, -3e-5]
    sensing = BodyAccelerometers(*bias, scale[0], scale[2], *turn)
    # Axes of the body in those of the velocity: along, right, below.
    body = Rotation.from_euler("y", angle).as_matrix()
    actual = body.T @ [-drag, 0.0, -lift]
    turned = Rotation.from_rotvec(turn).as_matrix().T @ actual
    sensed = body @ (turned + np.array(bias) + np.array(scale) * actual)
    found = sensing.read(air, None)
    np.testing.assert_allclose(
        [-found.drag, found.side, -found.lift], sensed, rtol=0, atol=1e-7
    )
    alone = BodyAccelerometers().read(air, None)
    assert [float(x) for x in alone] == pytest.approx([lift, drag, 0.0], abs=1e-14)
