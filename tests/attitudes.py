"""Attitude responses, and a scenario that flies them, shared by test files."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from helpers import free_scenario

from jentry.fields import Scalar, scalar
from jentry.flight import FixedStep
from jentry.guidance import AbstractContinuousLaw
from jentry.motion import Controls, Response, SecondOrderAttitude
from jentry.motion.attitude import Swing
from jentry.units import degree
from jentry.world import PolynomialAerodynamics


FREE = 1e9
"""A limit that is none"""

FREQUENCY, DAMPING = 0.6, 0.7

STEP = 0.02


def response(rate=FREE, acceleration=FREE, reach=FREE, damping=DAMPING):
    return Response(FREQUENCY, damping, rate, acceleration, -reach, reach)


def swings(given, command, seconds, start=(0.0, 0.0)):
    """Angle and rate over time, by Runge-Kutta steps; (steps + 1,) each."""
    command = jnp.asarray(command)

    def step(swing, _):
        solver = FixedStep(STEP)
        field = lambda t, s: given.turn(s, command)
        after = solver.advance(field, jnp.asarray(0.0), jnp.asarray(STEP), swing)
        return after, after

    first = Swing(*map(jnp.asarray, start))
    _, path = jax.lax.scan(step, first, length=round(seconds / STEP))
    return jax.tree.map(lambda a, b: np.append(float(a), b), first, path)


class Turning(AbstractContinuousLaw[None]):
    """A bank and an angle of attack that depends on the sensed drag of the instant."""

    bank_angle: Scalar = scalar(0.9, unit="rad")
    per_drag: Scalar = scalar(1e-3, unit="rad s2/m")

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        angle = 0.1 + self.per_drag * measurement.drag
        return Controls.from_bank(self.bank_angle, angle), None


def lagging(frequency=0.5, **limits):
    axis = lambda reach: Response(
        frequency,
        0.9,
        limits.get("rate", FREE),
        limits.get("acceleration", FREE),
        -reach,
        reach,
    )
    return SecondOrderAttitude(axis(0.5), axis(80 * degree))


def scenario(law=None, attitude=None):
    """On Mars, with a lift that grows with the angle of attack."""
    given = free_scenario()
    vehicle = dataclasses.replace(
        given.vehicle,
        aerodynamics=PolynomialAerodynamics((0.1, 1.0), (1.2, 0.0, 1.5)),
    )
    return dataclasses.replace(
        given,
        vehicle=vehicle,
        guidance=Turning() if law is None else law,
        attitude=lagging() if attitude is None else attitude,
    )
