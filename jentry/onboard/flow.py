"""Onboard motion of the vehicle: sensed forces, and second derivatives by jvp."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from ..fields import Scalar
from ..motion.dynamics import rates_under
from ..motion.state import EntryState
from .measurement import Measurement
from .model import OnboardModel, require_still_air


class SensedPoint(eqx.Module):
    """A point of the flight as sensed by the vehicle, or its time derivative."""

    time: Scalar
    state: EntryState
    drag: Scalar
    """Sensed, m/s2"""


class BankedMotion(eqx.Module):
    """A quantity x along the flight: x, x' and x'' = drift + gain cos(bank)."""

    value: Scalar
    rate: Scalar
    drift: Scalar
    gain: Scalar


Flow = Callable[[SensedPoint], SensedPoint]
"""Time derivative of a point, without the contribution of the bank."""


def sensed_flow(
    model: OnboardModel, angle_of_attack: Scalar, drag_rate: Scalar | None = None
) -> Flow:
    """Onboard motion under the sensed drag, at an angle of attack (rad).

    The planet is at rest, the air is still and the lift acts sideways: `twice_along` adds
    the contribution of the vertical lift. The sensed drag is one of the coordinates. It
    changes in proportion to the drag of the model. If its rate (m/s3) is known already it
    is passed as `drag_rate`.

    **Raises:** `ValueError` for a model with a wind.
    """

    require_still_air(model.planet, "the motion under a sensed drag")

    def flow(point: SensedPoint) -> SensedPoint:
        rates = rates_under(model.planet, point.state, -point.drag)
        if drag_rate is None:
            _, relative = jax.jvp(
                lambda state: model.logarithm_of_drag(state, angle_of_attack),
                (point.state,),
                (rates,),
            )
            changes = point.drag * relative
        else:
            changes = drag_rate
        return SensedPoint(jnp.ones_like(point.time), rates, changes)

    return flow


def twice_along(
    flow: Flow,
    quantity: Callable[[SensedPoint], Scalar],
    measurement: Measurement,
    time: Scalar,
    lift: Scalar,
) -> BankedMotion:
    """A quantity along the flight, with its second derivative affine in cos(bank).

    The derivatives are two nested forward derivatives. The quantity is a function of time,
    position, velocity and drag, so its rate does not contain the bank: the vertical lift,
    `lift` (m/s2) times cos(bank), only turns the flight path. The contribution of the
    sideways lift to the second derivative is neglected. It is zero for quantities of the
    motion in the vertical plane.
    """
    point = SensedPoint(time, measurement.state, measurement.drag)

    def first(point: SensedPoint) -> tuple[Scalar, tuple[Scalar, SensedPoint]]:
        rates = flow(point)
        value, rate = jax.jvp(quantity, (point,), (rates,))
        return rate, (value, rates)

    # Linearised once for two directions, which halves the tracing time.
    rate, second, (value, rates) = jax.linearize(first, point, has_aux=True)
    turn = eqx.tree_at(
        lambda point: point.state.flight_path_angle,
        jax.tree.map(jnp.zeros_like, point),
        lift / measurement.state.velocity,
    )
    return BankedMotion(value, rate, drift=second(rates), gain=second(turn))
