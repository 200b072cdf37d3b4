"""What the vehicle infers of lift and drag from what its accelerometers sense."""

from abc import abstractmethod
from typing import Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp

from ..fields import NOT_NEGATIVE, Scalar, scalar


class AbstractFactors(eqx.Module):
    """Actual lift and drag in units of those of the onboard model, over the altitude."""

    @abstractmethod
    def at(self, altitude: Scalar) -> "Factors":
        """At an altitude, m."""


class Factors(AbstractFactors):
    """Actual specific forces in units of those that the onboard model expects.

    Density, and lift or drag coefficient, enter a specific force as a product: sensed
    accelerations tell the product, and the motion depends on no more. The factor on the
    density alone is not observable.
    """

    lift: Scalar = scalar(1.0, positive=True)
    drag: Scalar = scalar(1.0, positive=True)

    def at(self, altitude: Scalar) -> "Factors":
        return self


class AbstractFactorEstimate(eqx.Module):
    """What is known of the factors after some samples."""

    @property
    @abstractmethod
    def factors(self) -> Factors:
        """Where the vehicle is."""

    @property
    @abstractmethod
    def ahead(self) -> AbstractFactors:
        """Over the altitude, for what is predicted."""

    def caveats(self) -> dict[str, Scalar]:
        """What a reader of the results must know: see `AbstractSampledLaw.caveats`."""
        return {}


Estimate = TypeVar("Estimate", bound=AbstractFactorEstimate)


class AbstractFactorEstimator(eqx.Module, Generic[Estimate]):
    """Estimates the factors from sample to sample."""

    @abstractmethod
    def start(self, like: Scalar) -> Estimate:
        """Before the first sample, when the model is believed."""

    @abstractmethod
    def update(
        self,
        estimate: Estimate,
        altitude: Scalar,
        sensed: tuple[Scalar, Scalar],
        expected: tuple[Scalar, Scalar],
        elapsed: Scalar,
    ) -> Estimate:
        """After one more sample.

        **Arguments:**

        - `altitude`: of the sample, m.
        - `sensed`, `expected`: lift and drag, m/s2; of the model without factors.
        - `elapsed`: since the sample before, s.
        """


class FactorEstimate(AbstractFactorEstimate):
    """Factors, and the weight of the samples behind each, (m/s2)^2."""

    here: Factors
    lift_weight: Scalar
    drag_weight: Scalar

    @property
    def factors(self) -> Factors:
        return self.here

    @property
    def ahead(self) -> Factors:
        return self.here


class FactorEstimator(AbstractFactorEstimator[FactorEstimate]):
    """Recursive least squares with forgetting, for each axis: the same at all altitudes.

    The estimate f minimises the sum of (sensed - f expected)^2 over the samples, each
    weighted by exp(-age / time_constant): where the force is small against noise and
    bias it says little. With a time constant of zero it is the last ratio, which is
    exact with perfect accelerometers.
    """

    time_constant: Scalar = scalar(0.0, unit="s", range=NOT_NEGATIVE)

    def start(self, like: Scalar) -> FactorEstimate:
        nothing = 0.0 * like
        return FactorEstimate(Factors(nothing + 1.0, nothing + 1.0), nothing, nothing)

    def update(
        self,
        estimate: FactorEstimate,
        altitude: Scalar,
        sensed: tuple[Scalar, Scalar],
        expected: tuple[Scalar, Scalar],
        elapsed: Scalar,
    ) -> FactorEstimate:
        kept = jnp.exp(-elapsed / jnp.maximum(self.time_constant, 1e-9))
        lift, lift_weight = _refined(
            estimate.factors.lift, estimate.lift_weight, sensed[0], expected[0], kept
        )
        drag, drag_weight = _refined(
            estimate.factors.drag, estimate.drag_weight, sensed[1], expected[1], kept
        )
        return FactorEstimate(Factors(lift, drag), lift_weight, drag_weight)


def _refined(factor, weight, sensed, expected, kept):
    weight = kept * weight + expected * expected
    known = weight > 0.0
    gain = jnp.where(known, expected / jnp.where(known, weight, 1.0), 0.0)
    return factor + gain * (sensed - factor * expected), weight
