"""Toy laws of the angle of attack, and scenarios that fly them beside a bank law."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from helpers import free_scenario, mars_entry, with_leaf

from jentry.fields import Scalar, scalar
from jentry.flight import Scenario
from jentry.guidance import AbstractContinuousLaw, AngleOfAttackCommand, BankProfile
from jentry.guidance.law import begun, commanded
from jentry.motion import Controls, Response, SecondOrderAttitude
from jentry.motion.index import EnergyIndex
from jentry.onboard import DragReference, Measurement, PolynomialProfile
from jentry.units import degree
from jentry.world import PolynomialAerodynamics


def reference():
    drag = PolynomialProfile([20.0, -15.0], -5e6, -8e6)
    return DragReference(EnergyIndex(), drag, PolynomialProfile([0.5]), gate=4.0)


class DragModulation(AbstractContinuousLaw[Scalar]):
    """A toy: the angle of attack about a schedule, by the error of the sensed drag.

    Memory is the filtered error, m/s2; the bank is to follow the deviation and its rate.
    """

    schedule: PolynomialProfile
    drag: Scalar = scalar(unit="m/s2")
    gain: Scalar = scalar(0.004, unit="rad s2/m")
    time_constant: Scalar = scalar(4.0, unit="s")
    bank_gain: Scalar = scalar(4.0)
    bank_rate_gain: Scalar = scalar(2.0, unit="s")
    below: Scalar = scalar(6500.0, unit="m/s")

    def init(self, measurement):
        return 0.0 * measurement.drag

    def __call__(self, time, measurement, memory):
        active = measurement.state.velocity < self.below
        error = jnp.where(active, self.drag - measurement.drag, 0.0)
        rate = (error - memory) / self.time_constant
        deviation = self.gain * memory
        increment = self.bank_gain * deviation + self.bank_rate_gain * self.gain * rate
        angle = self.schedule(measurement.state.velocity) + deviation
        angle = angle + 0.002 * self.gain * error
        return AngleOfAttackCommand(angle, increment), rate


def modulation(**given):
    return DragModulation(PolynomialProfile([0.15, 0.1], 500.0, 6000.0), 15.0, **given)


def lifting(law, **changes) -> Scenario:
    """Free flight on Mars, with lift and drag that grow with the angle of attack."""
    given = free_scenario()
    aerodynamics = PolynomialAerodynamics((0.1, 1.0), (1.2, 0.0, 1.5))
    vehicle = dataclasses.replace(given.vehicle, aerodynamics=aerodynamics)
    return dataclasses.replace(given, vehicle=vehicle, guidance=law, **changes)


def lagging():
    axis = lambda frequency, reach: Response(
        frequency, 0.9, 5 * degree, 1.7 * degree, -reach, reach
    )
    return SecondOrderAttitude(axis(2.0, 0.6), axis(0.6, 80 * degree))


def steady(cosine=0.5, **given):
    return BankProfile(PolynomialProfile([cosine]), **given)


def flown(history):
    there = np.isfinite(history.time)
    return jax.tree.map(lambda x: np.asarray(x)[there], history)


class Asking(AbstractContinuousLaw[None]):
    """A constant angle of attack, and a constant increment of the bank."""

    increment: Scalar = scalar(unit="rad")

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        return AngleOfAttackCommand(0.1, self.increment), None


def at_start(law, **changes) -> Controls:
    """What a law commands at the entry."""
    one = jnp.asarray(1.0)
    measurement = Measurement(mars_entry(), one, one, 0.07 * one, 0.07 * one)
    for name, value in changes.items():
        measurement = with_leaf(measurement, lambda m, n=name: getattr(m, n), value)
    return commanded(law, 0.0 * one, measurement, *begun(law, measurement))[0]
