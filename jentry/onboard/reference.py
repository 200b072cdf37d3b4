"""References over an index, with time derivatives along the flight."""

import equinox as eqx
import jax.numpy as jnp

from .._dependence import Traced
from ..fields import Scalar, scalar
from ..motion.index import AbstractIndex, EnergyIndex
from .flow import BankedMotion, Flow, SensedPoint, sensed_flow, twice_along
from .measurement import Measurement
from .model import OnboardModel
from .profiles import AbstractProfile, QuinticTable


def index_motion(
    index: AbstractIndex,
    time: Scalar,
    measurement: Measurement,
    model: OnboardModel,
    angle_of_attack: Scalar,
    drag_rate: Scalar | None = None,
) -> BankedMotion:
    """Index along the flight, from the sensed drag and the modelled lift-to-drag ratio.

    The derivatives are by forward differentiation, except for the energy, whose rate is
    that of the work of the drag. `drag_rate` (m/s3) is passed if it is known already.

    **Raises:** `ValueError` for an index that depends on the flight-path angle or the
    heading, since its rate contains the bank.
    """
    planet, state = model.planet, measurement.state
    flow = sensed_flow(model, angle_of_attack, drag_rate)
    if type(index) is EnergyIndex:  # a subclass may have another value
        return _energy_motion(index.value(planet, time, state), time, measurement, flow)

    def turned(path: Scalar, heading: Scalar) -> Scalar:
        there = eqx.tree_at(
            lambda s: (s.flight_path_angle, s.heading), state, (path, heading)
        )
        return index.value(planet, time, there)

    if Traced(turned, state.flight_path_angle, state.heading).depends():
        raise ValueError(
            f"{type(index).__name__} depends on the flight-path angle or the heading: "
            "its rate contains the bank, and it must be a function of time, position and "
            "velocity"
        )

    def value(point: SensedPoint) -> Scalar:
        return index.value(planet, point.time, point.state)

    lift = model.lift_to_drag(state, angle_of_attack) * measurement.drag
    return twice_along(flow, value, measurement, time, lift)


def _energy_motion(
    energy: Scalar, time: Scalar, measurement: Measurement, flow: Flow
) -> BankedMotion:
    """E' = -D V, in which gravity cancels, and E'', which does not contain the bank.

    Forward differentiation would compute the terms of gravity, which then cancel in flight.
    Without them a loss of 256 flights takes a twentieth less time, its tangents a tenth
    less and its reverse gradient an eighth less (`benchmarks/gradient.py`).
    """
    drag, velocity = measurement.drag, measurement.state.velocity
    rates = flow(SensedPoint(time, measurement.state, drag))
    drift = -rates.drag * velocity - drag * rates.state.velocity
    return BankedMotion(energy, -drag * velocity, drift, gain=jnp.zeros_like(drag))


def along(
    derivatives: tuple[Scalar, Scalar, Scalar], index: BankedMotion
) -> BankedMotion:
    """A profile along the flight, by the chain rule from the motion of its index.

    `derivatives` are the value and both derivatives of the profile over the index.
    """
    value, first, second = derivatives
    return BankedMotion(
        value=value,
        rate=first * index.rate,
        drift=second * index.rate * index.rate + first * index.drift,
        gain=first * index.gain,
    )


class Reference(eqx.Module):
    """Quantities of a flight over one index, such as drag, bank and flight-path angle.

    motions = reference.at(time, measurement, model, angle_of_attack)
    motions["altitude"].rate
    """

    index: AbstractIndex
    quantities: QuinticTable | dict[str, AbstractProfile]
    """Quantities over the index, by name: in one table, or one profile each"""

    def over_index(self, value: Scalar) -> dict[str, tuple[Scalar, Scalar, Scalar]]:
        """Each quantity with its two derivatives over the index, by name."""
        if isinstance(self.quantities, QuinticTable):
            return self.quantities.with_derivatives(value)
        return {
            name: profile.with_derivatives(value)
            for name, profile in self.quantities.items()
        }

    def at(
        self,
        time: Scalar,
        measurement: Measurement,
        model: OnboardModel,
        angle_of_attack: Scalar,
        drag_rate: Scalar | None = None,
    ) -> dict[str, BankedMotion]:
        """Each quantity with its time derivatives at the vehicle, by name.

        The arguments are those of `index_motion`.
        """
        motion = index_motion(
            self.index, time, measurement, model, angle_of_attack, drag_rate
        )
        read = self.over_index(motion.value)
        return {name: along(values, motion) for name, values in read.items()}


class DragReference(eqx.Module):
    """Reference drag over an index, with the bank of the flight that produced it."""

    index: AbstractIndex
    drag: AbstractProfile
    """m/s2, over the index"""
    cos_bank: AbstractProfile
    """Over velocity (m/s): commanded open loop while the drag is below the gate"""
    gate: Scalar = scalar(0.0, unit="m/s2")
    """Drag above which the reference is tracked"""

    def at(
        self,
        time: Scalar,
        measurement: Measurement,
        model: OnboardModel,
        angle_of_attack: Scalar,
        drag_rate: Scalar | None = None,
    ) -> BankedMotion:
        """Reference drag and its time derivatives; arguments as in `index_motion`."""
        reference = Reference(self.index, {"drag": self.drag})
        motions = reference.at(time, measurement, model, angle_of_attack, drag_rate)
        return motions["drag"]
