"""Level flight that is held: a closed loop whose linear system is known in closed form."""

import jax.numpy as jnp
import numpy as np
from scipy import linalg

from jentry.fields import Scalar, scalar
from jentry.flight import AltitudeBelow, Scenario, Target, Termination
from jentry.guidance import AbstractContinuousLaw
from jentry.motion import Controls, EntryState, EquatorialDynamics
from jentry.units import degree, km
from jentry.world import (
    ConstantAerodynamics,
    ExponentialAtmosphere,
    InverseSquareGravity,
    Planet,
    Vehicle,
)


RADIUS, MU, SURFACE_DENSITY, SCALE_HEIGHT = 3397 * km, 4.28283e13, 0.0158, 9354.5
ALTITUDE, VELOCITY, LIFT_PER_PRESSURE = 30 * km, 2500.0, 0.6 * 16.0 / 992.0
PERIOD = 2.0


class LevelHold(AbstractContinuousLaw[Scalar]):
    """Level flight by the vertical lift, with an integral of the altitude error."""

    steady: Scalar = scalar()
    gains: Scalar = scalar()
    """of the error per 10 km"""
    path_gain: Scalar = scalar()
    integral_gain: Scalar = scalar()

    def init(self, measurement):
        return 0.0 * measurement.drag

    def __call__(self, time, measurement, memory):
        state = measurement.state
        error = (state.altitude - ALTITUDE) / (10 * km)
        feedback = self.gains * error + self.path_gain * state.flight_path_angle
        cosine = self.steady - feedback - self.integral_gain * memory
        return Controls(0.0 * cosine, cosine, jnp.sqrt(1.0 - cosine**2)), error


def motion():
    """Rates of altitude, velocity and path angle over these three, the effect of the
    cosine of the bank on them, and the cosine of steady flight: by hand, without drag."""
    r, v, h = RADIUS + ALTITUDE, VELOCITY, SCALE_HEIGHT
    g = MU / r**2
    pressure = 0.5 * SURFACE_DENSITY * np.exp(-ALTITUDE / h) * v**2
    lift = pressure * LIFT_PER_PRESSURE
    steady = (g - v**2 / r) / lift
    a = np.array(
        [
            [0.0, 0.0, v],
            [0.0, 0.0, -g],
            [
                -lift * steady / (h * v) - v / r**2 + 2.0 * g / (r * v),
                lift * steady / v**2 + 1.0 / r + g / v**2,
                0.0,
            ],
        ]
    )
    return a, np.array([0.0, 0.0, lift / v]), steady


def level(law, seconds=20.0) -> Scenario:
    return Scenario(
        planet=Planet(
            RADIUS,
            gravity=InverseSquareGravity(MU),
            atmosphere=ExponentialAtmosphere(SURFACE_DENSITY, SCALE_HEIGHT),
        ),
        vehicle=Vehicle(992.0, 16.0, aerodynamics=ConstantAerodynamics(0.6, 1e-15)),
        initial_state=EntryState(ALTITUDE, 0.0, 0.0, VELOCITY, 0.0, 90 * degree),
        guidance=law,
        termination=Termination({"ground": AltitudeBelow(0.0)}, time_limit=seconds),
        target=Target(0.0, 0.0, 0.0),
        dynamics=EquatorialDynamics(),
    )


GAINS = np.array([0.3, 0.0, 4.0, 0.02])
"""Of altitude in 10 km, velocity, path angle and the integral"""


def hold(gains=GAINS) -> LevelHold:
    return LevelHold(motion()[2], gains[0], gains[2], gains[3])


def with_integral(gains=GAINS):
    """Motion and integral, the effect of the cosine on them, and the feedback."""
    a, b, _ = motion()
    a = np.block([[a, np.zeros((3, 1))], [np.array([1e-4, 0.0, 0.0, 0.0])]])
    return a, np.append(b, 0.0), gains * np.array([1e-4, 1.0, 1.0, 1.0])


def held_map(gains):
    """The map of one cycle: the cosine is held, the integral goes on."""
    a, b, k = with_integral(gains)
    whole = linalg.expm(PERIOD * np.block([[a, b[:, None]], [np.zeros(5)]]))
    return whole[:4, :4] - np.outer(whole[:4, 4], k)


def deadbeat_gains():
    """With which one combination of altitude and path angle is gone after a cycle, and one
    is halved; the energy and, without a gain of its own, the integral stay."""

    def of(altitude, path):
        reduced = held_map(np.array([altitude, 0.0, path, 0.0]))[:3, :3]
        return np.poly(reduced)[1:3]

    # The polynomial is affine in the gains: wanted is (x - 1) (x - 0.5) x.
    base = of(0.0, 0.0)
    slopes = np.stack([of(1.0, 0.0) - base, of(0.0, 1.0) - base], axis=1)
    altitude, path = np.linalg.solve(slopes, np.array([-1.5, 0.5]) - base)
    return np.array([altitude, 0.0, path, 0.0])
