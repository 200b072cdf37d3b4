"""Indices of a reference: time, velocity, energy, altitude or downrange."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx

from ..fields import Scalar
from ..world.planet import Planet
from .quantities import energy, ground_track
from .state import EntryState


class AbstractIndex(eqx.Module):
    """The independent variable of a reference, a gain schedule or a segment of a flight.

    An index defines only its value. Its rates along a flight follow by forward
    differentiation; those of `EnergyIndex` are known in closed form. A law that commands
    the bank needs an index whose rate does not depend on the bank. This holds for every
    function of time, position and velocity. An index of your own:

        class MachIndex(AbstractIndex):
            def value(self, planet, time, state):
                here = planet.above(state.longitude, state.latitude)
                sound = here.atmosphere.speed_of_sound(state.altitude)
                return state.velocity / sound
    """

    unit: ClassVar[str] = "1"
    """SI unit of the value"""

    @abstractmethod
    def value(self, planet: Planet, time: Scalar, state: EntryState) -> Scalar:
        """The index at a time (s) and in a state; twice differentiable in both."""


class TimeIndex(AbstractIndex):
    """Time since the start, s: exact in nominal flights, poor in dispersed ones."""

    unit = "s"

    def value(self, planet: Planet, time: Scalar, state: EntryState) -> Scalar:
        return time


class VelocityIndex(AbstractIndex):
    """Velocity, m/s. It rises at first; its second derivative depends on the bank."""

    unit = "m/s"

    def value(self, planet: Planet, time: Scalar, state: EntryState) -> Scalar:
        return state.velocity


class EnergyIndex(AbstractIndex):
    """Energy, V^2/2 + potential, J/kg. It falls throughout, so it needs no gate."""

    unit = "J/kg"

    def value(self, planet: Planet, time: Scalar, state: EntryState) -> Scalar:
        return energy(planet, state)


class AltitudeIndex(AbstractIndex):
    """Altitude, m. It falls throughout in entries that do not skip."""

    unit = "m"

    def value(self, planet: Planet, time: Scalar, state: EntryState) -> Scalar:
        return state.altitude


class DownrangeIndex(AbstractIndex):
    """Downrange from an origin, m, as in `ground_track`. It rises throughout.

    The range to go to a target is the downrange of the target minus this downrange.
    """

    unit = "m"

    origin: EntryState

    def value(self, planet: Planet, time: Scalar, state: EntryState) -> Scalar:
        downrange, _ = ground_track(planet, self.origin, state)
        return downrange


def index_named(name: str, origin: EntryState) -> AbstractIndex:
    """The index with a name; the downrange is counted from an origin.

    **Raises:** `ValueError` for an unknown name.
    """
    indices = {
        "time": TimeIndex(),
        "velocity": VelocityIndex(),
        "energy": EnergyIndex(),
        "altitude": AltitudeIndex(),
        "downrange": DownrangeIndex(origin),
    }
    if name not in indices:
        raise ValueError(f"no index {name!r}: choose from {', '.join(indices)}")
    return indices[name]
