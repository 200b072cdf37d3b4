"""The reference drag and what it is a function of: energy, velocity or time."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp

from .._math import sincos
from ..fields import Scalar, scalar
from ..motion.quantities import energy
from ..motion.state import EntryState
from ..world.planet import Planet
from .model import OnboardModel
from .navigation import Measurement
from .profiles import AbstractProfile


class IndexMotion(eqx.Module):
    """An index along the flight: x, x' and x'' = drift + gain cos(bank)."""

    value: Scalar
    rate: Scalar
    drift: Scalar
    gain: Scalar


class AbstractIndex(eqx.Module):
    """What a reference is a function of. A law follows it through its rates."""

    @abstractmethod
    def value(self, planet: Planet, time: Scalar, state: EntryState) -> Scalar:
        """The index in a state."""

    @abstractmethod
    def motion(
        self,
        time: Scalar,
        measurement: Measurement,
        model: OnboardModel,
        drag_rate: Scalar,
    ) -> IndexMotion:
        """The index now, with rates by the onboard model; `drag_rate` is in m/s3."""


class EnergyIndex(AbstractIndex):
    """V^2/2 + potential, J/kg: it falls throughout, so that it needs no gate."""

    def value(self, planet, time, state):
        return energy(planet, state)

    def motion(self, time, measurement, model, drag_rate):
        state, drag = measurement.state, measurement.drag
        velocity = state.velocity
        sin, _ = sincos(state.flight_path_angle)
        gravity = model.planet.gravity.acceleration(
            model.planet.radius + state.altitude
        )
        acceleration = -drag - gravity * sin
        return IndexMotion(
            value=self.value(model.planet, time, state),
            rate=-drag * velocity,
            drift=-drag_rate * velocity - drag * acceleration,
            gain=jnp.zeros_like(drag),
        )


class VelocityIndex(AbstractIndex):
    """Velocity, m/s. It rises at first, and its second rate contains the bank."""

    def value(self, planet, time, state):
        return state.velocity

    def motion(self, time, measurement, model, drag_rate):
        state, drag = measurement.state, measurement.drag
        velocity = state.velocity
        sin, cos = sincos(state.flight_path_angle)
        radius = model.planet.radius + state.altitude
        gravity = model.planet.gravity.acceleration(radius)
        lift = model.lift_to_drag * drag
        turn = (velocity / radius - gravity / velocity) * cos
        gravity_rate = -2.0 * gravity * velocity * sin / radius
        return IndexMotion(
            value=self.value(model.planet, time, state),
            rate=-drag - gravity * sin,
            drift=-drag_rate - gravity_rate * sin - gravity * cos * turn,
            gain=-gravity * cos * lift / velocity,
        )


class TimeIndex(AbstractIndex):
    """Time since the start, s: exact in the nominal case, poor under dispersions."""

    def value(self, planet, time, state):
        return time

    def motion(self, time, measurement, model, drag_rate):
        nothing = jnp.zeros_like(time)
        return IndexMotion(time, jnp.ones_like(time), nothing, nothing)


class WantedDrag(eqx.Module):
    """Reference drag, D*, its rate, and D*'' = acceleration + gain cos(bank)."""

    drag: Scalar
    rate: Scalar
    acceleration: Scalar
    gain: Scalar


class DragReference(eqx.Module):
    """Reference drag over an index, with the bank that was flown to make it."""

    index: AbstractIndex
    drag: AbstractProfile
    """m/s2, over the index"""
    cos_bank: AbstractProfile
    """Over velocity (m/s): flown open loop while the drag is below the gate"""
    gate: Scalar = scalar(0.0, unit="m/s2")
    """Drag from which on the reference is tracked"""

    def at(
        self,
        time: Scalar,
        measurement: Measurement,
        model: OnboardModel,
        drag_rate: Scalar,
    ) -> WantedDrag:
        """Reference drag and its time derivatives here, by the chain rule."""
        index = self.index.motion(time, measurement, model, drag_rate)
        value, first, second = self.drag.with_derivatives(index.value)
        return WantedDrag(
            drag=value,
            rate=first * index.rate,
            acceleration=second * index.rate * index.rate + first * index.drift,
            gain=first * index.gain,
        )
