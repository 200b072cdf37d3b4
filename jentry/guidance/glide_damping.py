"""Damping of the phugoid: a bank that keeps to the glide of the one asked for."""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._interpolation import clamp
from .._math import safe_sqrt, sincos
from ..fields import NOT_NEGATIVE, Scalar, scalar
from ..motion.dynamics import entry_dynamics
from ..motion.state import Controls, EntryState
from ..onboard.estimation import Factors
from ..onboard.model import OnboardModel


class GlideDamping(eqx.Module):
    """Turns the bank so that a glide does not swing about its equilibrium.

    In level flight at a bank the vehicle is pushed upwards by an acceleration s(h, v) of
    the altitude and the velocity: lift, gravity and what the curved path takes off it.
    Where s is zero it glides in equilibrium, and where it is not it swings about that,
    with the frequency w and hardly damped. The glide itself descends at such a rate that s
    stays zero while the drag slows it down,

        w^2 = -ds/dh        h'_glide = -(ds/dv) v' / (ds/dh)

    and the cosine of the bank becomes

        cos(bank) = cos(bank asked for) - 2 ratio w (h' - h'_glide) / lift

    With the ratio of zero it is the bank that is asked for. Where the air has no such
    frequency, as where it is too thin, it is that as well.

    The altitude rate of an equilibrium glide in the feedback is that of P. Lu, "Entry
    Guidance: A Unified Method", Journal of Guidance, Control, and Dynamics 37(3), 2014.
    What is our own: the gain, which is a damping ratio, and derivatives that are exact for
    any atmosphere and aerodynamics.
    """

    ratio: Scalar = scalar(0.7, range=NOT_NEGATIVE)
    """Of the damping, to the critical one"""
    lowest: Scalar = scalar(-1.0, range=(-1.0, 1.0))
    """Cosine of the largest bank"""

    def cos_bank(
        self,
        model: OnboardModel,
        factors: Factors,
        state: EntryState,
        angle_of_attack: Scalar,
        cosine: Scalar,
    ) -> Scalar:
        """Cosine of the bank to fly.

        **Arguments:**

        - `factors`: on the lift and the drag of the model.
        - `angle_of_attack`: that is flown, rad.
        - `cosine`: of the bank that is asked for.
        """
        scales = (
            model.vehicle.lift_scale * factors.lift,
            model.vehicle.drag_scale * factors.drag,
        )
        vehicle = eqx.tree_at(
            lambda v: (v.lift_scale, v.drag_scale), model.vehicle, scales
        )
        nothing = jnp.zeros_like(state.altitude)

        def push(
            altitude: Scalar, velocity: Scalar, cosine: Scalar
        ) -> tuple[Scalar, Scalar]:
            level = eqx.tree_at(
                lambda s: (s.altitude, s.velocity, s.flight_path_angle),
                state,
                (altitude, velocity, nothing),
            )
            # What the lift does to the side pushes nothing upwards.
            upwards = Controls(angle_of_attack, cosine, nothing)
            rates = entry_dynamics(model.planet, vehicle, level, upwards)
            return velocity * rates.flight_path_angle, rates.velocity

        at = state.altitude, state.velocity, cosine
        _, slope, slows = jax.linearize(push, *at, has_aux=True)
        one = jnp.ones_like(nothing)
        over_altitude = slope(one, nothing, nothing)
        over_velocity = slope(nothing, one, nothing)
        lift = slope(nothing, nothing, one)
        swings = (over_altitude < 0.0) & (lift > 0.0)
        # On both sides of the `where`, so that no derivative comes from there.
        square = jnp.where(swings, -over_altitude, 1.0)
        gliding = over_velocity * slows / square
        rises = state.velocity * sincos(state.flight_path_angle)[0]
        too_fast = safe_sqrt(square) * (rises - gliding) / jnp.where(swings, lift, 1.0)
        less = jnp.where(swings, 2.0 * self.ratio * too_fast, 0.0)
        return clamp(cosine - less, jnp.minimum(self.lowest, cosine), 1.0)
