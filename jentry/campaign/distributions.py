"""Distributions of one number: what a dispersion is drawn from."""

import dataclasses
import math
from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Key

from ..fields import Scalar, scalar


class AbstractDistribution(eqx.Module):
    """Distribution of one number."""

    @abstractmethod
    def sample(self, key: Key[Array, ""]) -> Scalar:
        """Draw one number."""

    @abstractmethod
    def moments(self) -> tuple[Scalar, Scalar]:
        """Mean and standard deviation of what is drawn."""

    @abstractmethod
    def scaled(self, factor: Scalar | float) -> "AbstractDistribution":
        """The distribution about the same mean that is `factor` times as wide."""


class Normal(AbstractDistribution):
    """Normal distribution. Where a source quotes three sigma, write the division."""

    mean: Scalar = scalar()
    standard_deviation: Scalar = scalar(positive=True)

    def sample(self, key: Key[Array, ""]) -> Scalar:
        return self.mean + self.standard_deviation * jax.random.normal(key, dtype=float)

    def moments(self) -> tuple[Scalar, Scalar]:
        return self.mean, self.standard_deviation

    def scaled(self, factor: Scalar | float) -> "Normal":
        return Normal(self.mean, factor * self.standard_deviation)


class Uniform(AbstractDistribution):
    """Uniform distribution between two bounds."""

    lower: Scalar = scalar()
    upper: Scalar = scalar()

    def sample(self, key: Key[Array, ""]) -> Scalar:
        share = jax.random.uniform(key, dtype=float)
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
    """A number that is always the same, for a table of dispersions without a draw."""

    value: Scalar = scalar()

    def sample(self, key: Key[Array, ""]) -> Scalar:
        return self.value

    def moments(self) -> tuple[Scalar, Scalar]:
        return self.value, 0.0 * self.value

    def scaled(self, factor: Scalar | float) -> "Constant":
        return self


class OneOfSeveral(AbstractDistribution):
    """Uniform about zero in a share of the runs, and zero in the others.

    Dispersions with places 0 to `count` - 1 and one stream are drawn one at a time: in
    each run one of them, which is as likely as any other.
    """

    place: int = eqx.field(static=True)
    count: int = eqx.field(static=True)
    most: Scalar = scalar(positive=True)
    """Largest size of what is drawn"""

    def __check_init__(self):
        if not 0 <= self.place < self.count:
            raise ValueError(
                f"place is {self.place}: it must be from 0 to count - 1, and count is "
                f"{self.count}"
            )

    def sample(self, key: Key[Array, ""]) -> Scalar:
        number = self.count * jax.random.uniform(key, dtype=float)
        chosen = jnp.floor(number) == self.place
        share = 2.0 * (number - self.place) - 1.0
        return jnp.where(chosen, self.most * share, 0.0)

    def moments(self) -> tuple[Scalar, Scalar]:
        return 0.0 * self.most, self.most / math.sqrt(3.0 * self.count)

    def scaled(self, factor: Scalar | float) -> "OneOfSeveral":
        return OneOfSeveral(self.place, self.count, factor * self.most)


class TruncatedNormal(AbstractDistribution):
    """Normal distribution of which only what lies between two bounds is drawn."""

    mean: Scalar = scalar()
    standard_deviation: Scalar = scalar(positive=True)
    lower: Scalar = scalar()
    upper: Scalar = scalar()

    def in_deviations(self) -> tuple[Scalar, Scalar]:
        """The two bounds, counted from the mean in standard deviations."""
        lower = (self.lower - self.mean) / self.standard_deviation
        upper = (self.upper - self.mean) / self.standard_deviation
        return lower, upper

    def sample(self, key: Key[Array, ""]) -> Scalar:
        lower, upper = self.in_deviations()
        share = jax.random.uniform(key, dtype=float)
        # In the tail below the mean, by symmetry, where a probability that is small keeps
        # its digits: above it they are what is left of 1, and beyond 8 deviations nothing.
        above = lower + upper > 0.0
        near = jnp.where(above, ndtr(-lower), ndtr(lower))
        far = jnp.where(above, ndtr(-upper), ndtr(upper))
        draw = ndtri(near + (far - near) * share)
        draw = jnp.clip(jnp.where(above, -draw, draw), lower, upper)
        return self.mean + self.standard_deviation * draw

    def moments(self) -> tuple[Scalar, Scalar]:
        # By quadrature about the mode: the closed form cancels in the tails.
        lower, upper = self.in_deviations()
        mode = jnp.clip(jnp.zeros_like(lower), lower, upper)
        # As far as the density is more than exp(-80) of that at the mode.
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


def static_fields(distribution: AbstractDistribution) -> dict[str, Any]:
    """What a distribution has besides numbers that JAX sees, by name."""
    fields = dataclasses.fields(distribution)
    return {
        f.name: getattr(distribution, f.name)
        for f in fields
        if f.metadata.get("static")
    }
