"""Onboard re-planning of a ground track, the predictive half of the guidance.

The law of S. Bharadwaj, A. V. Rao, K. D. Mease, "Entry Trajectory Tracking Law via
Feedback Linearization", Journal of Guidance, Control, and Dynamics 21(5), 1998, tracks a
fixed reference. The paper does not cover re-planning: everything here is beyond the paper.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from .._newton import solve
from ..fields import NOT_NEGATIVE, Count, Flag, Scalar, scalar
from ..motion.state import Controls, EntryState
from ..onboard.estimation import (
    AbstractFactorEstimate,
    AbstractFactorEstimator,
    AbstractFactors,
    FactorEstimator,
    Factors,
)
from ..onboard.measurement import Measurement
from ..onboard.profiles import AbstractProfile
from ..onboard.propagation import Prediction, propagate_over
from .cycle import FixedCycle
from .feedback_linearization import (
    GroundTrackModel,
    GroundTrackTracking,
    ModelledForces,
    TrackErrors,
    along_reference,
)
from .law import AbstractSampledLaw


Shares = Float[Array, " 3"]
"""The coefficients of an adjustment in units of their limits"""
Miss = Float[Array, " 2"]
"""Downrange and crossrange of the end minus those of the reference, m"""


class AdjustedProfile(AbstractProfile):
    """A profile, multiplied by a factor and shifted."""

    profile: AbstractProfile
    factor: Scalar = scalar(1.0)
    shift: Scalar = scalar(0.0)
    """Shift in the unit of the profile"""

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        value, first, second = self.profile.with_derivatives(index)
        return (
            self.factor * value + self.shift,
            self.factor * first,
            self.factor * second,
        )


class Adjustment(eqx.Module):
    """Change of the reference controls, or its largest magnitude."""

    angle_of_attack: Scalar = scalar(unit="rad")
    """Added to the reference angle of attack"""
    bank_factor: Scalar = scalar()
    """Added to the factor on the reference bank, which is one"""
    bank: Scalar = scalar(unit="rad")
    """Added to the bank, positive to the right. It turns the vehicle to one side, before
    and after a reversal"""

    def applied(self, model: GroundTrackModel) -> GroundTrackModel:
        """A model with the reference controls changed."""
        one = jnp.ones_like(self.bank_factor)
        return dataclasses.replace(
            model,
            angle_of_attack=AdjustedProfile(
                model.angle_of_attack, one, self.angle_of_attack
            ),
            bank=AdjustedProfile(model.bank, one + self.bank_factor, self.bank),
        )


class OnboardReference(eqx.Module):
    """Reference motion that the law integrates on board during the flight, or its rate."""

    state: EntryState
    """State of the reference at the energy of the vehicle"""
    errors: TrackErrors
    """Integrals of the errors of the vehicle with respect to it"""


class Replanned(eqx.Module):
    """Decision at a guidance cycle."""

    adjustment: Adjustment
    estimate: AbstractFactorEstimate
    """Estimate of the factors on lift and drag of the model"""
    decisions: Scalar
    """Number of decisions so far"""
    without_prediction: Scalar
    """Number of decisions without a predicted end, which left the adjustment unchanged"""


class ReplannedTracking(AbstractSampledLaw[OnboardReference, Replanned]):
    """Tracks a reference that is planned again in each guidance cycle.

    At the start of a cycle the sensed lift and drag are compared with those of the model at
    the actual angle of attack. The ratios are held through the cycle, so that the angle of
    attack does not depend on the forces of the same instant. With these ratios, and with
    three coefficients that change the reference controls (`Adjustment`), the rest of the
    flight is predicted over the energy from the measured state. One damped Gauss-Newton
    step corrects the coefficients so that the prediction ends at the downrange and
    crossrange of the reference. The step has the minimum norm in units of the limits. The
    next cycle continues from these coefficients, so after the first cycles the steps are
    small.

    Within the cycle the law integrates the motion of the model under the changed controls
    from the measured state, and tracks this motion in place of its table. The bounds of
    the angle of attack remain those about the reference angle of attack of the law. Errors
    that cannot be removed within the limits remain. A prediction without an end leaves the
    coefficients unchanged.

    Memory is the reference motion and the integrals of the errors with respect to it. Both
    restart at each decision. Where the ratios change along the flight, the plan starts from
    the present state, and a reference that continued from elsewhere would not end at the
    target.

    Source: beyond the paper, which does not cover re-planning.
    """

    law: GroundTrackTracking
    limits: Adjustment
    """Largest change of each coefficient, to either side; all positive"""
    end: Scalar = scalar(unit="J/kg")
    """Energy at the end of the reference"""
    largest_step: Scalar = scalar(0.3, positive=True)
    """Largest change of a coefficient at one decision, in units of its limit"""
    least_effect: Scalar = scalar(20.0, unit="m", positive=True)
    """Effect of a coefficient, changed by its limit, on the end below which the coefficient
    is left unchanged: Levenberg damping"""
    least_share: Scalar = scalar(0.3, range=NOT_NEGATIVE)
    """Threshold as in `least_effect`, but as a share of the miss. It matters near the end,
    where the miss can no longer be removed"""
    estimator: AbstractFactorEstimator = eqx.field(default_factory=FactorEstimator)
    cycle: FixedCycle = FixedCycle(10.0)
    steps: int = eqx.field(default=100, static=True)
    """Number of steps of a prediction. At the start a step should be shorter over the
    energy than a bank reversal. The steps become shorter in proportion to the way to go"""

    def __check_init__(self):
        if not isinstance(self.law.force_knowledge, ModelledForces):
            name = type(self.law.force_knowledge).__name__
            raise ValueError(
                f"force_knowledge of the law is {name}, which would not be asked: "
                "re-planning measures the forces itself; leave it at ModelledForces()"
            )
        if self.steps < 1:
            raise ValueError(f"steps is {self.steps}: it must be 1 or more")
        reference = self.law.reference
        place = self.end, reference.start, reference.spacing
        if any(isinstance(x, Tracer) or not eqx.is_array(x) for x in place):
            return
        with jax.ensure_compile_time_eval():
            count = reference.coefficients["downrange"].shape[0]
            share = float((self.end - reference.start) / reference.spacing) / count
            last = float(reference.start + count * reference.spacing)
        if not 0.0 < share < 1.01:
            raise ValueError(
                f"end is {float(self.end):g} J/kg: the reference is known from "
                f"{float(reference.start):g} to {last:g} J/kg"
            )

    def init(self, measurement: Measurement) -> tuple[OnboardReference, Replanned]:
        nothing = 0.0 * measurement.drag
        adjustment = Adjustment(nothing, nothing, nothing)
        estimate = self.estimator.start(measurement.drag)
        held = Replanned(adjustment, estimate, nothing, nothing)
        return self._from_here(measurement), held

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: OnboardReference,
        held: Replanned,
    ) -> tuple[OnboardReference, Replanned]:
        state, angle = measurement.state, measurement.angle_of_attack
        one = jnp.ones_like(measurement.drag)
        expected = self.law.model.forces(state, angle, Factors(one, one))
        sensed = measurement.lift, measurement.drag
        elapsed = self.cycle.period * one
        estimate = self.estimator.update(
            held.estimate, state.altitude, sensed, expected, elapsed
        )
        adjustment, found = self._adjusted(state, estimate.ahead, held.adjustment)
        missing = jnp.where(found, 0.0, 1.0)
        return self._from_here(measurement), Replanned(
            adjustment,
            estimate,
            held.decisions + 1.0,
            held.without_prediction + missing,
        )

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: OnboardReference,
        held: Replanned,
    ) -> tuple[Controls, OnboardReference]:
        law, factors = self.law, held.estimate.factors
        model = held.adjustment.applied(law.model)
        here = memory.state
        wanted = along_reference(law.linearization, model, here, factors)
        controls, errors = law.towards(
            wanted, model, factors, measurement, memory.errors
        )
        above, right, drag = model.reference_forces(here, factors)
        over_energy = model.over_energy(here, drag, above, right)
        falls = -measurement.state.velocity * measurement.drag / model.energy_span
        return controls, OnboardReference(
            jax.tree.map(lambda rate: rate * falls, over_energy), errors
        )

    def caveats(self, held: Replanned) -> dict[str, Scalar]:
        """Share of the decisions without a predicted end, and caveats of the estimate."""
        share = held.without_prediction / jnp.maximum(held.decisions, 1.0)
        return {"decisions_without_prediction": share} | held.estimate.caveats()

    def predicted(
        self, state: EntryState, factors: AbstractFactors, adjustment: Adjustment
    ) -> Prediction:
        """Predicted flight of the model from a state to the end, under changed controls."""
        model = adjustment.applied(self.law.model)

        def command(time: Scalar, state: EntryState) -> Controls:
            here = model.energy(state)
            return Controls.from_bank(model.bank(here), model.angle_of_attack(here))

        return propagate_over(
            model.energy,
            self.end,
            model.onboard,
            state,
            command,
            steps=self.steps,
            factors=factors,
        )

    def _from_here(self, measurement: Measurement) -> OnboardReference:
        return OnboardReference(measurement.state, self.law.init(measurement))

    def _adjusted(
        self, state: EntryState, factors: AbstractFactors, before: Adjustment
    ) -> tuple[Adjustment, Flag]:
        """The next adjustment, and whether a prediction had an end."""
        model = self.law.model
        radius = model.onboard.planet.radius
        read = self.law.reference.with_derivatives(self.end)
        aim = jnp.stack([read["downrange"][0], read["crossrange"][0]])
        limits, structure = jax.tree.flatten(self.limits)
        limits = jnp.stack(limits)

        def missed(shares: Shares) -> tuple[Miss, Count]:
            adjustment = jax.tree.unflatten(structure, list(shares * limits))
            end = self.predicted(state, factors, adjustment)
            reached = jnp.stack(model.outputs(end.state))
            return radius * (reached - aim), end.ended_by

        shares = jnp.stack(jax.tree.leaves(before)) / limits
        miss, effects, ended_by = _with_effects(missed, shares)
        damping = self.least_effect**2 + self.least_share**2 * jnp.sum(miss * miss)
        damped = effects.T @ effects + damping * jnp.eye(2)
        step = -effects @ solve(damped, miss)
        step = jnp.clip(step, -self.largest_step, self.largest_step)
        moved = jnp.clip(shares + step, -1.0, 1.0)
        found = (ended_by >= 0) & jnp.isfinite(jnp.sum(moved))
        moved = jnp.where(found, moved, shares)
        return jax.tree.unflatten(structure, list(moved * limits)), found


def _with_effects(
    missed: Callable[[Shares], tuple[Miss, Count]], shares: Shares
) -> tuple[Miss, Float[Array, "3 2"], Count]:
    """The miss, and the effect of each coefficient; the motion is propagated once."""

    def along(direction: Shares) -> tuple[Miss, Miss, Count]:
        return jax.jvp(missed, (shares,), (direction,), has_aux=True)

    every = jnp.eye(shares.shape[0])
    return jax.vmap(along, out_axes=(None, 0, None))(every)
