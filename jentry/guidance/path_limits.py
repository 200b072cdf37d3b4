"""Path constraints in flight: bounds of the bank that respect their limits."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from .._interpolation import clamp
from ..fields import Scalar, scalar
from ..motion.constraints import AbstractConstraint, PathPoint
from ..motion.dynamics import AbstractDynamics, EntryDynamics
from ..motion.state import Controls, EntryState
from ..onboard.estimation import Factors
from ..onboard.measurement import Measurement
from ..onboard.model import OnboardModel


class BankBounds(eqx.Module):
    """Bounds of the cosine of the bank between which a limit is respected."""

    lower: Scalar
    upper: Scalar

    def kept(self, cos_bank: Scalar) -> Scalar:
        """A cosine clamped to the bounds. If the bounds exclude each other it is the lower
        one, which brings the vehicle out of denser air."""
        cosine = jnp.minimum(cos_bank, self.upper)
        return clamp(jnp.maximum(cosine, self.lower), -1.0, 1.0)


class PathLimits(eqx.Module):
    """Respects the path constraints of a scenario by bounding the bank.

    Along the flight the second derivative of a constrained quantity q is affine in the
    cosine of the bank. The cosine is bounded so that

        q'' + 2 w q' + w^2 (q - limit) <= 0

    Under this condition a quantity whose rate is at most w times the margin to its limit
    tends to the limit and does not exceed it. The bounds are computed at the guidance
    cycle, for the model with the sensed factors. The factor of the drag is attributed to
    the density, which is the least known. A limit that full lift up cannot respect is
    exceeded, which the peaks of the flight show.

    The rate q' is that under the requested bank. Only for the equilibrium glide does it
    depend on the bank itself, by a share of the order of the flight-path angle.

    This is an exponential control barrier function: Q. Nguyen, K. Sreenath, American
    Control Conference, 2016. Constraints that are integrals are not covered.
    """

    frequency: Scalar = scalar(0.05, unit="1/s", positive=True)
    """w"""

    def bounds(
        self,
        model: OnboardModel,
        measurement: Measurement,
        factors: Factors,
        controls: Callable[[EntryState], Controls],
        dynamics: AbstractDynamics = EntryDynamics(),
    ) -> BankBounds:
        """Bounds of the bank for the measured state.

        **Arguments:**

        - `controls`: controls that the law requests, as a function of the state.
        - `dynamics`: equations of motion.

        **Raises:** `ValueError` if no constraint has a limit.
        """
        limited = {
            name: constraint
            for name, constraint in measurement.constraints.items()
            if isinstance(constraint, AbstractConstraint)
            and constraint.limit is not None
        }
        if not limited:
            raise ValueError(
                "PathLimits keeps the limits of Scenario.constraints, and none of them "
                f"has one ({', '.join(measurement.constraints) or 'there are none'}): "
                "give a limit, or leave limits at None"
            )
        planet, vehicle = model.planet, model.vehicle
        ratio = factors.lift / factors.drag
        planet = eqx.tree_at(
            lambda p: p.density_scale, planet, planet.density_scale * factors.drag
        )
        vehicle = eqx.tree_at(
            lambda v: v.lift_scale, vehicle, vehicle.lift_scale * ratio
        )
        state = measurement.state

        def rates(state: EntryState, cosine: Scalar) -> EntryState:
            wanted = controls(state)
            turned = Controls(wanted.angle_of_attack, cosine, wanted.sin_bank)
            return dynamics.rates(planet, vehicle, state, turned)

        def values(state: EntryState) -> tuple[Scalar, ...]:
            point = PathPoint.of(planet, vehicle, state, controls(state), dynamics)
            return tuple(each.value(point) for each in limited.values())

        now = controls(state).cos_bank

        # For all constraints at once: their common parts are differentiated once.
        def slopes(state: EntryState) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
            here, along = jax.jvp(values, (state,), (rates(state, now),))
            return along, here

        level = rates(state, jnp.zeros_like(now))
        # Difference before derivative: where the bank has no effect it is exactly zero.
        turn = jax.tree.map(jnp.subtract, rates(state, jnp.ones_like(now)), level)
        along, second, here = jax.linearize(slopes, state, has_aux=True)
        every = zip(
            limited.values(), here, along, second(level), second(turn), strict=True
        )
        lower, upper = jnp.full_like(now, -1.0), jnp.ones_like(now)
        w = self.frequency
        for constraint, value, slope, drift, gain in every:
            room = -(drift + 2.0 * w * slope + w * w * (value - constraint.limit))
            moves = gain != 0.0
            bound = room / jnp.where(moves, gain, 1.0)
            lower = jnp.where(gain < 0.0, jnp.maximum(lower, bound), lower)
            upper = jnp.where(gain > 0.0, jnp.minimum(upper, bound), upper)
        return BankBounds(lower, upper)
