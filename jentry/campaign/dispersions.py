"""What is uncertain: distributions, and the leaves of a scenario that they move."""

import dataclasses
import math
import zlib
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from .._addresses import addresses_of, field_metadata, leaves_by_address
from .._types import Scalar, scalar
from ..flight.scenario import Scenario, check_values, require_effect


class AbstractDistribution(eqx.Module):
    """Distribution of one number."""

    @abstractmethod
    def sample(self, key: Key[Array, ""]) -> Scalar:
        """One draw."""

    @abstractmethod
    def moments(self) -> tuple[Scalar, Scalar]:
        """Mean and standard deviation of what is drawn."""

    @abstractmethod
    def scaled(self, factor: Scalar | float) -> "AbstractDistribution":
        """The same about the same mean, so many times as wide."""


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
    """Always the same: what belongs to a table of dispersions without being drawn."""

    value: Scalar = scalar()

    def sample(self, key: Key[Array, ""]) -> Scalar:
        return self.value

    def moments(self) -> tuple[Scalar, Scalar]:
        return self.value, 0.0 * self.value

    def scaled(self, factor: Scalar | float) -> "Constant":
        return self


class TruncatedNormal(AbstractDistribution):
    """Normal distribution of which only what lies between two bounds is drawn."""

    mean: Scalar = scalar()
    standard_deviation: Scalar = scalar(positive=True)
    lower: Scalar = scalar()
    upper: Scalar = scalar()

    def sample(self, key: Key[Array, ""]) -> Scalar:
        lower = (self.lower - self.mean) / self.standard_deviation
        upper = (self.upper - self.mean) / self.standard_deviation
        draw = jax.random.truncated_normal(key, lower, upper, dtype=float)
        return self.mean + self.standard_deviation * draw

    def moments(self) -> tuple[Scalar, Scalar]:
        # By quadrature about the mode: the closed form cancels in the tails.
        lower = (self.lower - self.mean) / self.standard_deviation
        upper = (self.upper - self.mean) / self.standard_deviation
        mode = jnp.clip(jnp.zeros_like(lower), lower, upper)
        lower, upper = jnp.maximum(lower, mode - 12.0), jnp.minimum(upper, mode + 12.0)
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


def replace(nominal: Scalar, draw: Scalar) -> Scalar:
    """The draw takes the place of the nominal value."""
    return draw


def add(nominal: Scalar, draw: Scalar) -> Scalar:
    """The draw is added to the nominal value."""
    return nominal + draw


def multiply(nominal: Scalar, draw: Scalar) -> Scalar:
    """The nominal value is multiplied by the draw."""
    return nominal * draw


class Dispersion(eqx.Module):
    """One uncertain number, and the leaves that it moves.

        Dispersion(lambda s: s.planet.density_scale, Uniform(0.8, 1.2))
        Dispersion(lambda s: s.vehicle.mass, Uniform(0.95, 1.05), apply=multiply)

    A lens may return several leaves, `lambda s: (s.vehicle.lift_scale,
    s.vehicle.drag_scale)`: the one draw moves them all. Define tables of dispersions
    once, at module level: a fresh lambda is compiled anew.
    """

    where: Callable[[Any], Any] = eqx.field(static=True)
    distribution: AbstractDistribution
    apply: Callable[[Scalar, Scalar], Scalar] = eqx.field(default=replace, static=True)


def scaled_dispersions(
    dispersions: Mapping[str, Dispersion], factor: Scalar | float
) -> dict[str, Dispersion]:
    """The same dispersions about the same means, so many times as wide."""
    return {
        name: dataclasses.replace(
            dispersion, distribution=dispersion.distribution.scaled(factor)
        )
        for name, dispersion in dispersions.items()
    }


Inputs = dict[str, Scalar]
"""Values of leaves by their addresses."""


def draw(
    dispersions: Mapping[str, Dispersion], key: Key[Array, ""], run: Int[Array, ""]
) -> dict[str, Scalar]:
    """The draws of one run, by the names of the dispersions.

    They depend on the key, the name and the run alone, not on what else is drawn.
    """
    draws = {}
    for name, dispersion in dispersions.items():
        name_key = jax.random.fold_in(key, zlib.crc32(name.encode()))
        draws[name] = dispersion.distribution.sample(jax.random.fold_in(name_key, run))
    return draws


def disperse(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    draws: Mapping[str, Scalar],
) -> Inputs:
    """The values that the dispersed leaves take in one run.

    Dispersions that move the same leaf do so one after the other, in their order.

    Raises `ValueError` for a dispersion that reaches no leaf, one that is no single
    number, or one that would discard what another has done to the same leaf.
    """
    leaves = leaves_by_address(scenario)
    inputs: Inputs = {}
    for name, dispersion in dispersions.items():
        try:
            reached = addresses_of(scenario, dispersion.where)
        except (ValueError, AttributeError, KeyError, TypeError) as error:
            raise ValueError(f"dispersion {name!r}: {error}") from error
        for address in reached:
            if leaves[address].shape != ():
                raise ValueError(
                    f"dispersion {name!r} reaches {address}, a table of shape "
                    f"{leaves[address].shape}: disperse a factor on it instead"
                )
            if address in inputs and dispersion.apply is replace:
                raise ValueError(
                    f"dispersion {name!r} replaces {address}, which another dispersion "
                    "has moved already: use add or multiply, or remove one"
                )
            nominal = inputs.get(address, leaves[address])
            inputs[address] = dispersion.apply(nominal, draws[name])
    return inputs


def check_dispersions(
    scenario: Scenario, dispersions: Mapping[str, Dispersion]
) -> None:
    """Refuse what `disperse` would, and distributions that cannot be drawn from."""
    draws = {name: jnp.zeros(()) for name in dispersions}
    jax.eval_shape(lambda draws: disperse(scenario, dispersions, draws), draws)
    for name, dispersion in dispersions.items():
        for address in addresses_of(scenario, dispersion.where):
            require_effect(scenario, address)
        distribution = dispersion.distribution
        numbers = leaves_by_address(distribution)
        for field, value in numbers.items():
            metadata = field_metadata(distribution, field)
            check_values(f"dispersions.{name}.{field}", np.asarray(value), metadata)
        if {"lower", "upper"} <= set(numbers):
            lower, upper = float(numbers["lower"]), float(numbers["upper"])
            if not lower < upper:
                raise ValueError(
                    f"dispersions.{name}.lower is {lower:g}: it must be below upper, "
                    f"which is {upper:g}"
                )


def dispersed_inputs(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    runs: Int[Array, " runs"],
) -> dict[str, Float[Array, " runs"]]:
    """Inputs of many runs, by address."""
    # As pairs: JAX sorts the names of a dictionary, and the order is part of the meaning.
    return _dispersed_inputs(scenario, tuple(dispersions.items()), key, runs)


@eqx.filter_jit
def _dispersed_inputs(
    scenario: Scenario,
    pairs: tuple[tuple[str, Dispersion], ...],
    key: Key[Array, ""],
    runs: Int[Array, " runs"],
) -> dict[str, Float[Array, " runs"]]:
    dispersions = dict(pairs)

    def one(run: Int[Array, ""]) -> dict[str, Array]:
        inputs = disperse(scenario, dispersions, draw(dispersions, key, run))
        return {address: jnp.asarray(value) for address, value in inputs.items()}

    return jax.vmap(one)(runs)
