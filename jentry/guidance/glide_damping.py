"""Damping of the phugoid: a bank with feedback of the altitude rate of the glide."""

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
    """Corrects the bank so that a glide does not oscillate about its equilibrium.

    In level flight at a bank the vehicle has an upward acceleration s(h, v), a function of
    altitude and velocity: lift and centrifugal acceleration minus gravity. Where s is zero
    the vehicle glides in equilibrium. Elsewhere it oscillates about the equilibrium with
    the frequency w and almost no damping. The glide itself descends at such a rate that s
    remains zero while the drag decelerates the vehicle,

        w^2 = -ds/dh        h'_glide = -(ds/dv) v' / (ds/dh)

    and the cosine of the bank becomes

        cos(bank) = cos(requested bank) - 2 ratio w (h' - h'_glide) / lift

    With a ratio of zero the bank is the requested one. It is also the requested one where
    w^2 is not positive, for example where the air is too thin.

    The altitude rate of an equilibrium glide in the feedback is that of P. Lu, "Entry
    Guidance: A Unified Method", Journal of Guidance, Control, and Dynamics 37(3), 2014.
    Beyond the paper: the gain is a damping ratio, and the derivatives are exact for any
    atmosphere and aerodynamics.
    """

    ratio: Scalar = scalar(0.7, range=NOT_NEGATIVE)
    """Damping ratio: damping over critical damping"""
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
        """Cosine of the bank with damping.

        **Arguments:**

        - `factors`: factors on the lift and the drag of the model.
        - `angle_of_attack`: actual angle of attack, rad.
        - `cosine`: cosine of the requested bank.
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
            # The lateral component of the lift has no upward effect.
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
        # On both sides of the `where`, so that the unused branch has no derivative.
        square = jnp.where(swings, -over_altitude, 1.0)
        gliding = over_velocity * slows / square
        rises = state.velocity * sincos(state.flight_path_angle)[0]
        too_fast = safe_sqrt(square) * (rises - gliding) / jnp.where(swings, lift, 1.0)
        less = jnp.where(swings, 2.0 * self.ratio * too_fast, 0.0)
        return clamp(cosine - less, jnp.minimum(self.lowest, cosine), 1.0)
