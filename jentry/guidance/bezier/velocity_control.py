"""Adjustment of the curve in flight, to reach the target at a required velocity."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._batching import where_due
from ..._newton import by_jvp, newton
from ...fields import Flag, Scalar, scalar, table
from .anchoring import Shape, StoredParameters
from .prediction import AbstractVelocityPredictor, FlownModel, Glide, Situation


class Predictions(eqx.Module):
    """Number of predictions of a velocity control, and how many had no answer."""

    asked: Scalar
    unanswered: Scalar
    """Predictions that were not finite, since an input of a network was outside of its
    range or the model did not reach the target. The curve was then left unchanged"""

    @classmethod
    def none(cls, like: Scalar) -> "Predictions":
        """Counts before the first prediction."""
        nothing = 0.0 * jnp.asarray(like)
        return cls(nothing, nothing)


class AbstractVelocityControl(eqx.Module):
    """Adjusts the third control point of the curve, or leaves it."""

    @abstractmethod
    def check(self, glide: Glide) -> None:
        """Refuse an anchoring rule that this control cannot work with."""

    @abstractmethod
    def adjusted(
        self, glide: Glide, situation: Situation, cycle: Scalar, seconds_to_go: Scalar
    ) -> tuple[Shape, Predictions]:
        """Shape after the decision of a guidance cycle (counted from 0), and the counts.

        The counts are those of the predictions in this cycle. If a prediction has no
        answer, the shape is left unchanged.
        """


class NoVelocityControl(AbstractVelocityControl):
    """No adjustment: the velocity at the target is not controlled."""

    def check(self, glide: Glide) -> None:
        return

    def adjusted(
        self, glide: Glide, situation: Situation, cycle: Scalar, seconds_to_go: Scalar
    ) -> tuple[Shape, Predictions]:
        return situation.shape, Predictions.none(cycle)


class Epochs(eqx.Module):
    """Epochs at which the velocity is predicted: every n guidance cycles from the first.

    Where the cycles become shorter, so does the time between the epochs. All flights of
    a batch have their epochs at the same cycles, which makes them cheap.
    """

    every: int | None = eqx.field(default=25, static=True)
    """Number n of guidance cycles; None for an epoch at the first cycle alone"""
    last: float = eqx.field(default=60.0, static=True)
    """Time before the target inside which there is no epoch, s. There the third control
    point moves far for a small effect, at the cost of the flight-path angle"""

    def __check_init__(self):
        if self.every is not None and self.every < 1:
            raise ValueError(f"every is {self.every} cycles: it must be 1 or more")

    def due(self, cycle: Scalar, seconds_to_go: Scalar) -> Flag:
        """Whether an epoch falls on this cycle."""
        now = cycle == 0.0
        if self.every is not None:
            now = jnp.mod(cycle, float(self.every)) == 0.0
        return now & (seconds_to_go > self.last)


class PolynomialAdjustment(AbstractVelocityControl):
    """k2 by the polynomial k2(v) of the nominal flight: equations (37) and (38).

    The velocity at the target is predicted with the nominal k2. The effect of a disturbance
    on it is assumed to be equal for all k2. The law therefore takes the k2 with which the
    nominal flight would end as much above its nominal velocity as the present flight is
    predicted to end below it.

    A polynomial is valid at one place on the nominal flight. The law interpolates in a
    table of polynomials (`planning.k2_polynomials`). If the first polynomial is used at
    every epoch, as printed, the result is worse. Where the prediction is not finite, k2 is
    left unchanged. The derivative of such a flight in reverse mode is not finite, and
    `tune` leaves it out.
    """

    to_go: Float[Array, "..."] = table(unit="rad", increasing=True)
    """Angle to go at the places of the polynomials, shape (n,), increasing"""
    nominal_k2: Scalar = scalar()
    nominal_velocity: Float[Array, "..."] = table(unit="m/s")
    """Velocity at the target that is predicted there for the nominal flight, shape (n,)"""
    polynomials: Float[Array, "..."] = table()
    """Coefficients of k2 = p0 + p1 x + p2 x^2 with x = (v - nominal) / 100 m/s, shape
    (n, 3)"""
    predictor: AbstractVelocityPredictor = FlownModel()
    epochs: Epochs = Epochs(every=None)

    def __check_init__(self):
        (count,) = self.to_go.shape
        if self.nominal_velocity.shape != (count,) or self.polynomials.shape != (
            count,
            3,
        ):
            raise ValueError(
                f"{count} places, nominal velocities of shape "
                f"{self.nominal_velocity.shape} and polynomials of shape "
                f"{self.polynomials.shape}: expected ({count},) and ({count}, 3)"
            )

    def check(self, glide: Glide) -> None:
        if not isinstance(glide.anchoring, StoredParameters):
            raise ValueError(
                f"the polynomial is one of k2, and {type(glide.anchoring).__name__} does "
                "not keep it: use StoredParameters, or NewtonAdjustment"
            )

    def adjusted(
        self, glide: Glide, situation: Situation, cycle: Scalar, seconds_to_go: Scalar
    ) -> tuple[Shape, Predictions]:
        def act(before: tuple[Shape, Predictions]) -> tuple[Shape, Predictions]:
            shape, _ = before
            as_nominal = Shape(shape.first, self.nominal_k2)
            predicted = self.predictor.predict(
                glide, eqx.tree_at(lambda s: s.shape, situation, as_nominal)
            )
            to_go = situation.target.along - situation.point.along
            nominal, p0, p1, p2 = (
                jnp.interp(to_go, self.to_go, column)
                for column in (self.nominal_velocity, *self.polynomials.T)
            )
            known = jnp.isfinite(nominal - predicted)
            x = jnp.where(known, 1e-2 * (nominal - predicted), 0.0)
            lower, upper = glide.anchoring.bounds(situation.point, situation.target)
            second = jnp.clip(p0 + x * (p1 + x * p2), lower, upper)
            second = jnp.where(known, second, shape.second)
            return Shape(shape.first, second), _one(known)

        before = situation.shape, Predictions.none(cycle)
        return where_due(self.epochs.due(cycle, seconds_to_go), act, before)


class NewtonAdjustment(AbstractVelocityControl):
    """Beyond the paper: Newton's method on the predicted velocity at the target.

    Any predictor can be used, since all are differentiable: the flown model or the network.
    Where a prediction is not finite, the curve is left unchanged until the next epoch. The
    derivative of such a flight in reverse mode is not finite, and `tune` leaves it out.

    The authority of this control is limited. With little drag the third control point moves
    towards the target, and its lower bound is 1 % of the way to go. At the bound the
    vehicle is too fast at the target, and in its last second the path bends more than
    gravity bends it. An example among the `normal-sensed` runs of the CAV-H mission (seed
    4, run 265: drag at 80 %) ends 5.7 m/s too fast, 0.15 m and 0.1 deg of flight-path
    angle off.
    """

    target_velocity: Scalar = scalar(unit="m/s", positive=True)
    predictor: AbstractVelocityPredictor = FlownModel()
    epochs: Epochs = Epochs()
    iterations: int = eqx.field(default=1, static=True)
    largest_step: float = eqx.field(default=0.3, static=True)
    """Largest step of one iteration, as a share of the interval between the bounds"""

    def check(self, glide: Glide) -> None:
        return

    def adjusted(
        self, glide: Glide, situation: Situation, cycle: Scalar, seconds_to_go: Scalar
    ) -> tuple[Shape, Predictions]:
        lower, upper = glide.anchoring.bounds(situation.point, situation.target)

        def act(before: tuple[Shape, Predictions]) -> tuple[Shape, Predictions]:
            shape, _ = before

            def miss(second: Scalar) -> Scalar:
                moved = Shape(shape.first, second)
                moved = eqx.tree_at(lambda s: s.shape, situation, moved)
                return self.predictor.predict(glide, moved) - self.target_velocity

            found = newton(
                by_jvp(miss),
                shape.second,
                self.iterations,
                lower=lower,
                upper=upper,
                largest_step=self.largest_step * (upper - lower),
                unroll=True,
            )
            return Shape(shape.first, found.x), _one(found.known)

        before = situation.shape, Predictions.none(cycle)
        return where_due(self.epochs.due(cycle, seconds_to_go), act, before)


def _one(answered: Flag) -> Predictions:
    """Counts of one prediction."""
    asked = jnp.ones_like(answered, dtype=float)
    return Predictions(asked, jnp.where(answered, 0.0, asked))
