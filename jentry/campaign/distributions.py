"""Distributions of one number, from which dispersions are drawn."""

import dataclasses
import math
from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Float, Key

from .._math import safe_sqrt
from ..fields import Scalar, Vector, as_float_array, scalar, table


_OFF = 1e-9
"""Tolerance of the sum of probabilities, per probability, since they are decimals"""


class AbstractDistribution(eqx.Module):
    """Distribution of one number."""

    @abstractmethod
    def sample(self, key: Key[Array, ""]) -> Scalar:
        """Draw one number."""

    def quantile(self, share: Float[Array, "..."]) -> Scalar:
        """The number below which a share of all draws lies, for samplers.

        The share is above 0 and below 1. A distribution that takes several `numbers` has
        one share for each, of shape (numbers,). They are uniform and independent.
        """
        raise ValueError(
            f"{type(self).__name__} has no quantile(share), the inverse of its cumulative "
            "distribution: give it one, or draw plainly, without a sampler"
        )

    def numbers(self) -> int:
        """How many independent random numbers one draw takes."""
        return 1

    @abstractmethod
    def moments(self) -> tuple[Scalar, Scalar]:
        """Mean and standard deviation of the draws."""

    @abstractmethod
    def scaled(self, factor: Scalar | float) -> "AbstractDistribution":
        """The distribution about the same mean that is `factor` times as wide."""


class Normal(AbstractDistribution):
    """Normal distribution. If a source quotes three sigma, write the division by 3."""

    mean: Scalar = scalar()
    standard_deviation: Scalar = scalar(positive=True)

    def sample(self, key: Key[Array, ""]) -> Scalar:
        return self.mean + self.standard_deviation * jax.random.normal(key, dtype=float)

    def quantile(self, share: Float[Array, "..."]) -> Scalar:
        return self.mean + self.standard_deviation * ndtri(share)

    def moments(self) -> tuple[Scalar, Scalar]:
        return self.mean, self.standard_deviation

    def scaled(self, factor: Scalar | float) -> "Normal":
        return Normal(self.mean, factor * self.standard_deviation)


class LogNormal(AbstractDistribution):
    """Distribution of a positive number whose logarithm is normal.

    A factor that is halved as often as doubled has the median 1. If a factor of 2 is one
    standard deviation, the deviation of the logarithm is `math.log(2.0)`.
    """

    median: Scalar = scalar(positive=True)
    deviation_of_logarithm: Scalar = scalar(positive=True)
    """Standard deviation of the natural logarithm"""

    def sample(self, key: Key[Array, ""]) -> Scalar:
        normal = jax.random.normal(key, dtype=float)
        return self.median * jnp.exp(self.deviation_of_logarithm * normal)

    def quantile(self, share: Float[Array, "..."]) -> Scalar:
        return self.median * jnp.exp(self.deviation_of_logarithm * ndtri(share))

    def moments(self) -> tuple[Scalar, Scalar]:
        variance = self.deviation_of_logarithm * self.deviation_of_logarithm
        mean = self.median * jnp.exp(0.5 * variance)
        return mean, mean * jnp.sqrt(jnp.expm1(variance))

    def scaled(self, factor: Scalar | float) -> "LogNormal":
        mean, _ = self.moments()
        variance = self.deviation_of_logarithm * self.deviation_of_logarithm
        # The standard deviation over the mean becomes larger by the factor.
        variance = jnp.log1p(factor * factor * jnp.expm1(variance))
        return LogNormal(mean * jnp.exp(-0.5 * variance), jnp.sqrt(variance))


class Uniform(AbstractDistribution):
    """Uniform distribution between two bounds."""

    lower: Scalar = scalar()
    upper: Scalar = scalar()

    def sample(self, key: Key[Array, ""]) -> Scalar:
        return self.quantile(jax.random.uniform(key, dtype=float))

    def quantile(self, share: Float[Array, "..."]) -> Scalar:
        return self.lower + (self.upper - self.lower) * share

    def moments(self) -> tuple[Scalar, Scalar]:
        middle = 0.5 * (self.lower + self.upper)
        return middle, (self.upper - self.lower) / math.sqrt(12.0)

    def scaled(self, factor: Scalar | float) -> "Uniform":
        middle, _ = self.moments()
        return Uniform(
            middle + factor * (self.lower - middle),
            middle + factor * (self.upper - middle),
        )


class Constant(AbstractDistribution):
    """A constant in a table of dispersions, without a draw."""

    value: Scalar = scalar()

    def sample(self, key: Key[Array, ""]) -> Scalar:
        return self.value

    def quantile(self, share: Float[Array, "..."]) -> Scalar:
        return self.value

    def numbers(self) -> int:
        return 0

    def moments(self) -> tuple[Scalar, Scalar]:
        return self.value, 0.0 * self.value

    def scaled(self, factor: Scalar | float) -> "Constant":
        return self


class Discrete(AbstractDistribution):
    """One of several numbers, each with a probability.

    Discrete([0.0, 1.0], [0.9, 0.1])  # a failure in a tenth of the runs
    Discrete([900.0, 950.0, 1000.0])  # equally likely
    """

    values: Vector = table(increasing=True)
    """(n,), increasing"""
    probabilities: Vector = table()
    """(n,), with the sum 1. By default all are equal."""

    def __init__(self, values: Any, probabilities: Any = None):
        self.values = as_float_array(values)
        if self.values.ndim != 1 or self.values.size == 0:
            raise ValueError(
                f"values has shape {self.values.shape}: give a list of numbers"
            )
        if probabilities is None:
            probabilities = jnp.full(self.values.shape, 1.0 / self.values.size)
        self.probabilities = as_float_array(probabilities)

    def __check_init__(self):
        if self.probabilities.shape != self.values.shape:
            raise ValueError(
                f"probabilities has shape {self.probabilities.shape}: give one for each "
                f"value, {self.values.shape}"
            )
        if isinstance(self.values, Tracer) or isinstance(self.probabilities, Tracer):
            return
        values, shares = np.asarray(self.values), np.asarray(self.probabilities)
        if not np.all(np.diff(values) > 0.0):
            raise ValueError(f"values is {values.tolist()}: list them in rising order")
        for share in shares[~(shares >= 0.0)][:1]:
            raise ValueError(f"a probability is {share:g}: each must be zero or more")
        total = float(np.sum(shares))
        if not abs(total - 1.0) <= _OFF * shares.size:
            raise ValueError(
                f"the probabilities {shares.tolist()} have the sum {total:.10g}: it must "
                "be 1"
            )

    def sample(self, key: Key[Array, ""]) -> Scalar:
        return self.quantile(jax.random.uniform(key, dtype=float))

    def quantile(self, share: Float[Array, "..."]) -> Scalar:
        # The last bound is left out: it is 1, however the sum is rounded.
        below = jnp.cumsum(self.probabilities)[:-1]
        return self.values[jnp.searchsorted(below, share, side="right")]

    def moments(self) -> tuple[Scalar, Scalar]:
        mean = jnp.sum(self.probabilities * self.values)
        variance = jnp.sum(self.probabilities * (self.values - mean) ** 2)
        return mean, safe_sqrt(variance)

    def scaled(self, factor: Scalar | float) -> "Discrete":
        mean, _ = self.moments()
        return Discrete(mean + factor * (self.values - mean), self.probabilities)


class CorrelatedNormal(AbstractDistribution):
    """One of several correlated normal distributions: see `correlated_normals`.

    A draw is the mean plus the standard deviation times a weighted sum of independent
    standard normal numbers. All distributions of a stream share these numbers. The weights
    are a row of the lower triangular root of the correlation matrix.
    """

    mean: Scalar = scalar()
    standard_deviation: Scalar = scalar(positive=True)
    weights: Vector = table()
    """(n,), with squares that have the sum 1"""

    def sample(self, key: Key[Array, ""]) -> Scalar:
        keys = (jax.random.fold_in(key, place) for place in range(self.weights.size))
        return self._of([jax.random.normal(key, dtype=float) for key in keys])

    def quantile(self, share: Float[Array, "..."]) -> Scalar:
        return self._of([ndtri(share[place]) for place in range(self.weights.size)])

    def _of(self, normals: list[Array]) -> Scalar:
        total = sum(self.weights[i] * normal for i, normal in enumerate(normals))
        return self.mean + self.standard_deviation * total

    def numbers(self) -> int:
        return self.weights.size

    def moments(self) -> tuple[Scalar, Scalar]:
        return self.mean, self.standard_deviation

    def scaled(self, factor: Scalar | float) -> "CorrelatedNormal":
        return dataclasses.replace(
            self, standard_deviation=factor * self.standard_deviation
        )


class OneOfSeveral(AbstractDistribution):
    """Uniform about zero in one of `count` runs on average, and zero in the others.

    In each run, exactly one of the dispersions with places 0 to `count` - 1 and one stream
    is not zero. All are equally likely.
    """

    place: int = eqx.field(static=True)
    count: int = eqx.field(static=True)
    most: Scalar = scalar(positive=True)
    """Largest absolute value of a draw"""

    def __check_init__(self):
        if not 0 <= self.place < self.count:
            raise ValueError(
                f"place is {self.place}: it must be from 0 to count - 1, and count is "
                f"{self.count}"
            )

    def sample(self, key: Key[Array, ""]) -> Scalar:
        return self.quantile(jax.random.uniform(key, dtype=float))

    def quantile(self, share: Float[Array, "..."]) -> Scalar:
        # It does not rise with the share, whose first digits choose the dispersion.
        number = self.count * share
        chosen = jnp.floor(number) == self.place
        size = 2.0 * (number - self.place) - 1.0
        return jnp.where(chosen, self.most * size, 0.0)

    def moments(self) -> tuple[Scalar, Scalar]:
        return 0.0 * self.most, self.most / math.sqrt(3.0 * self.count)

    def scaled(self, factor: Scalar | float) -> "OneOfSeveral":
        return OneOfSeveral(self.place, self.count, factor * self.most)


class TruncatedNormal(AbstractDistribution):
    """Normal distribution that is truncated at two bounds."""

    mean: Scalar = scalar()
    standard_deviation: Scalar = scalar(positive=True)
    lower: Scalar = scalar()
    upper: Scalar = scalar()

    def in_deviations(self) -> tuple[Scalar, Scalar]:
        """The two bounds relative to the mean, in standard deviations."""
        lower = (self.lower - self.mean) / self.standard_deviation
        upper = (self.upper - self.mean) / self.standard_deviation
        return lower, upper

    def sample(self, key: Key[Array, ""]) -> Scalar:
        return self.quantile(jax.random.uniform(key, dtype=float))

    def quantile(self, share: Float[Array, "..."]) -> Scalar:
        lower, upper = self.in_deviations()
        # Computed in the tail below the mean, where small probabilities have all digits.
        # Above the mean they are differences from 1, which vanish beyond 8 deviations.
        above = lower + upper > 0.0
        near = jnp.where(above, ndtr(-lower), ndtr(lower))
        far = jnp.where(above, ndtr(-upper), ndtr(upper))
        draw = ndtri(near + (far - near) * share)
        draw = jnp.clip(jnp.where(above, -draw, draw), lower, upper)
        return self.mean + self.standard_deviation * draw

    def moments(self) -> tuple[Scalar, Scalar]:
        # Computed by quadrature about the mode: the closed form loses digits in the tails.
        lower, upper = self.in_deviations()
        mode = jnp.clip(jnp.zeros_like(lower), lower, upper)
        # The density is more than exp(-80) of its value at the mode.
        reach = jnp.sqrt(mode * mode + 160.0) - jnp.abs(mode)
        lower, upper = (
            jnp.maximum(lower, mode - reach),
            jnp.minimum(upper, mode + reach),
        )
        nodes, weights = np.polynomial.legendre.leggauss(128)
        x = lower + 0.5 * (upper - lower) * (1.0 + nodes)
        weights = weights * jnp.exp(0.5 * (mode * mode - x * x))
        weights = weights / jnp.sum(weights)
        mean = jnp.sum(weights * x)
        deviation = jnp.sqrt(jnp.sum(weights * (x - mean) ** 2))
        scale = self.standard_deviation
        return self.mean + scale * mean, scale * deviation

    def scaled(self, factor: Scalar | float) -> "TruncatedNormal":
        centre, _ = self.moments()
        numbers = (self.mean, self.lower, self.upper)
        mean, lower, upper = (centre + factor * (x - centre) for x in numbers)
        return TruncatedNormal(mean, factor * self.standard_deviation, lower, upper)


def static_fields(module: eqx.Module) -> dict[str, Any]:
    """The static fields of a distribution or a sampler, by name."""
    fields = dataclasses.fields(module)
    return {f.name: getattr(module, f.name) for f in fields if f.metadata.get("static")}
