"""Estimation of lift and drag factors from the accelerometers."""

from abc import abstractmethod
from typing import Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp

from ..fields import NOT_NEGATIVE, Scalar, scalar


class AbstractFactors(eqx.Module):
    """Actual lift and drag in units of those of the onboard model, over the altitude."""

    @abstractmethod
    def at(self, altitude: Scalar) -> "Factors":
        """Factors at an altitude, m."""


class Factors(AbstractFactors):
    """Actual specific forces in units of those that the onboard model predicts.

    Density and the lift or drag coefficient enter a specific force as a product. Sensed
    accelerations determine the product, and the motion depends only on it. A factor on the
    density alone is not observable.
    """

    lift: Scalar = scalar(1.0, positive=True)
    drag: Scalar = scalar(1.0, positive=True)

    def at(self, altitude: Scalar) -> "Factors":
        return self


class AbstractFactorEstimate(eqx.Module):
    """Estimate of the factors after some samples."""

    @property
    @abstractmethod
    def factors(self) -> Factors:
        """Factors at the vehicle."""

    @property
    @abstractmethod
    def ahead(self) -> AbstractFactors:
        """Factors over the altitude, for predictions."""

    def caveats(self) -> dict[str, Scalar]:
        """Reasons to doubt the results: see `AbstractSampledLaw.caveats`."""
        return {}


Estimate = TypeVar("Estimate", bound=AbstractFactorEstimate)


class AbstractFactorEstimator(eqx.Module, Generic[Estimate]):
    """Estimates the factors from sample to sample."""

    @abstractmethod
    def start(self, like: Scalar) -> Estimate:
        """Estimate before the first sample: the model without factors."""

    @abstractmethod
    def update(
        self,
        estimate: Estimate,
        altitude: Scalar,
        sensed: tuple[Scalar, Scalar],
        expected: tuple[Scalar, Scalar],
        elapsed: Scalar,
    ) -> Estimate:
        """Estimate after one more sample.

        **Arguments:**

        - `altitude`: altitude of the sample, m.
        - `sensed`: sensed lift and drag, m/s2.
        - `expected`: lift and drag of the model without factors, m/s2.
        - `elapsed`: time since the previous sample, s.
        """


class FactorEstimate(AbstractFactorEstimate):
    """Factors, and the weight of the samples for each, (m/s2)^2."""

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
    """Recursive least squares with forgetting, for each axis; equal at all altitudes.

    The estimate f minimises the sum of (sensed - f expected)^2 over the samples, each
    weighted by exp(-age / time_constant). A force that is small beside noise and bias has
    little influence. With a time constant of zero the estimate is the last ratio, which is
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
