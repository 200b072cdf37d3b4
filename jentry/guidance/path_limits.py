"""Path constraints in flight: the bank that keeps them, whatever a law would bank."""

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
from ..onboard.model import OnboardModel
from ..onboard.navigation import Measurement


class BankBounds(eqx.Module):
    """Between which cosines of the bank a limit is kept."""

    lower: Scalar
    upper: Scalar

    def kept(self, cos_bank: Scalar) -> Scalar:
        """A cosine moved between them; where they exclude each other it is the lower one,
        which keeps the vehicle out of denser air."""
        cosine = jnp.minimum(cos_bank, self.upper)
        return clamp(jnp.maximum(cosine, self.lower), -1.0, 1.0)


class PathLimits(eqx.Module):
    """Keeps the path constraints of a scenario below their limits by the bank.

    Along the flight the second derivative of a constrained quantity q is affine in the
    cosine of the bank. That is bounded so that

        q'' + 2 w q' + w^2 (q - limit) <= 0

    under which a quantity that comes no faster than by w times what is left to the limit
    tends to the limit and does not exceed it. It acts at the guidance cycle, on the model
    with the factors that were sensed; the whole factor of the drag is taken for one of the
    density, which is what is least known. A limit that the full lift up cannot keep is
    broken all the same: the peaks of the flight say so.

    The rate q' is that under the bank that is wished. It goes with the bank itself for the
    equilibrium glide alone, by a share of the order of the path angle.

    An exponential control barrier function: Q. Nguyen, K. Sreenath, American Control
    Conference, 2016. Constraints that are integrals are not kept.
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
        """For the state that is measured.

        **Arguments:**

        - `controls`: that the law would fly, over the state.
        - `dynamics`: equations of motion.

        **Raises:** `ValueError` where no constraint has a limit.
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

        # Of all of them at once: what they share is differentiated once.
        def slopes(state: EntryState) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
            here, along = jax.jvp(values, (state,), (rates(state, now),))
            return along, here

        level = rates(state, jnp.zeros_like(now))
        # The difference before the derivative: where the bank moves nothing it is zero.
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
