"""Dispersions: the leaves of a scenario that are drawn for each run."""

import dataclasses
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int, Key

from .._printed import quantity_in_words
from .._programs import cached
from ..addresses import (
    addresses_of,
    field_metadata,
    leaves_by_address,
    unit_of,
    with_leaves,
)
from ..fields import Scalar, check_values, is_scalar
from ..flight.duplicate_numbers import require_both
from ..flight.effect import require_felt
from ..flight.scenario import Scenario
from ..flight.scenario_checks import require_effect
from ..units import forgotten_unit
from .distributions import AbstractDistribution, TruncatedNormal


def replace(nominal: Scalar, draw: Scalar) -> Scalar:
    """The draw replaces the nominal value."""
    return draw


def add(nominal: Scalar, draw: Scalar) -> Scalar:
    """The draw is added to the nominal value."""
    return nominal + draw


def multiply(nominal: Scalar, draw: Scalar) -> Scalar:
    """The nominal value is multiplied by the draw."""
    return nominal * draw


class Dispersion(eqx.Module):
    """One uncertain number, and the leaves that it changes.

        Dispersion(lambda s: s.planet.density_scale, Uniform(0.8, 1.2))
        Dispersion(lambda s: s.vehicle.mass, Uniform(0.95, 1.05), apply=multiply)

    A lens may return several leaves, `lambda s: (s.vehicle.lift_scale,
    s.vehicle.drag_scale)`. One draw changes them all. Define tables of dispersions once, at
    module level, since each new lambda is compiled again.
    """

    where: Callable[[Any], Any] = eqx.field(static=True)
    distribution: AbstractDistribution
    apply: Callable[[Scalar, Scalar], Scalar] = eqx.field(default=replace, static=True)
    stream: str | None = eqx.field(default=None, static=True)
    """Name of a stream. Dispersions of one stream use the same random number, each with its
    own distribution. By default a dispersion has a separate stream."""


def scaled_dispersions(
    dispersions: Mapping[str, Dispersion], factor: Scalar | float
) -> dict[str, Dispersion]:
    """Dispersions about the same means, wider by a factor."""
    return {
        name: dataclasses.replace(
            dispersion, distribution=dispersion.distribution.scaled(factor)
        )
        for name, dispersion in dispersions.items()
    }


_FARTHEST = 37.0
"""Standard deviations beyond which the probability is below the smallest positive number"""


Inputs = dict[str, Scalar]
"""Values of leaves, by address"""


MOST_RUNS = 2**32
"""Number of runs with different draws: a key uses 32 bits of the index of a run"""


def key_of(seed: int) -> Key[Array, ""]:
    """The key of a seed. Raises `ValueError` for a seed that JAX does not accept."""
    bits = 64 if jax.config.read("jax_enable_x64") else 32
    if not -(2 ** (bits - 1)) <= seed < 2 ** (bits - 1):
        raise ValueError(
            f"the seed is {seed}: it must be a number from -2^{bits - 1} to "
            f"2^{bits - 1} - 1"
        )
    return jax.random.key(seed)


def check_runs(runs: np.ndarray) -> None:
    """Refuse indices of runs that would have the draws of another run."""
    for wrong in runs[(runs < 0) | (runs >= MOST_RUNS)][:1]:
        raise ValueError(f"run {wrong} was asked for: runs count from 0 to 2^32 - 1")


def _codes(names: Iterable[str]) -> dict[str, int]:
    """Numbers with which a key is folded, by name. Refuses names with equal numbers."""
    codes: dict[str, int] = {}
    for name in names:
        code = zlib.crc32(name.encode())
        same = next((other for other, c in codes.items() if c == code), None)
        if same is not None:
            raise ValueError(
                f"the dispersions {same!r} and {name!r} would have the same draws, since "
                "their names have the same CRC-32: give one of them another name"
            )
        codes[name] = code
    return codes


def numbers_of_streams(dispersions: Mapping[str, Dispersion]) -> dict[str, int]:
    """How many random numbers of each stream a run takes, in the order of the table.

    **Raises:** `ValueError` for a stream from which two dispersions take different numbers.
    """
    counts: dict[str, int] = {}
    for name, dispersion in dispersions.items():
        stream, count = dispersion.stream or name, dispersion.distribution.numbers()
        before = counts.get(stream, count)
        if before != count and min(before, count) > 0:
            raise ValueError(
                f"dispersion {name!r} takes {count} random numbers of the stream "
                f"{stream!r}, and another one takes {before}: give it another stream"
            )
        counts[stream] = max(before, count)
    return counts


def draw(
    dispersions: Mapping[str, Dispersion], key: Key[Array, ""], run: Int[Array, ""]
) -> dict[str, Scalar]:
    """The draws of one run, by the names of the dispersions.

    A draw depends on the key, the name (or the stream) and the run alone. Other dispersions
    do not change it.
    """
    streams = {name: each.stream or name for name, each in dispersions.items()}
    codes = _codes(dict.fromkeys(streams.values()))
    draws = {}
    for name, stream in streams.items():
        run_key = jax.random.fold_in(jax.random.fold_in(key, codes[stream]), run)
        draws[name] = dispersions[name].distribution.sample(run_key)
    return draws


def disperse(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    draws: Mapping[str, Scalar],
) -> Inputs:
    """The values of the dispersed leaves in one run.

    Dispersions of the same leaf are applied one after the other, in their order.

    **Raises:** `ValueError` for a dispersion that reaches no leaf, a whole module, one leaf
    twice, or a leaf that is not a single real number. Also for one that replaces a leaf
    which another dispersion has already changed.
    """
    leaves = leaves_by_address(scenario)
    inputs: Inputs = {}
    for name, dispersion in dispersions.items():
        for address in addresses_of_dispersion(scenario, name, dispersion):
            if leaves[address].shape != ():
                raise ValueError(
                    f"dispersion {name!r} reaches {address}, a table of shape "
                    f"{leaves[address].shape}: disperse a factor on it instead"
                )
            if not jnp.issubdtype(leaves[address].dtype, jnp.inexact):
                raise ValueError(
                    f"dispersion {name!r} reaches {address}, a whole number: give its "
                    "values as inputs"
                )
            if address in inputs and dispersion.apply is replace:
                raise ValueError(
                    f"dispersion {name!r} replaces {address}, which another dispersion "
                    "has moved already: use add or multiply, or remove one"
                )
            nominal = inputs[address] if address in inputs else leaves[address]
            inputs[address] = dispersion.apply(nominal, draws[name])
    return inputs


def addresses_of_dispersion(
    scenario: Scenario, name: str, dispersion: Dispersion
) -> list[str]:
    """The addresses of the leaves that a dispersion changes.

    **Raises:** `ValueError` for parts that are not leaves, and for a leaf that comes twice.
    """
    try:
        addresses = addresses_of(scenario, dispersion.where)
        parts = dispersion.where(scenario)
    except (ValueError, AttributeError, LookupError, TypeError) as error:
        raise ValueError(f"dispersion {name!r}: {error}") from error
    parts = parts if isinstance(parts, list | tuple) else [parts]
    whole = next((part for part in parts if not eqx.is_array(part)), None)
    if whole is not None:
        raise ValueError(
            f"dispersion {name!r} reaches a whole {type(whole).__name__}, with "
            f"{', '.join(addresses)}: return the numbers themselves"
        )
    for address in addresses:
        if addresses.count(address) > 1:
            raise ValueError(f"dispersion {name!r} reaches {address} twice: once")
    return addresses


def unit_of_draw(
    scenario: Scenario,
    name: str,
    addresses: Iterable[str],
    apply: Callable[[Scalar, Scalar], Scalar],
) -> str:
    """Unit of the draws of a dispersion: the unit of its leaves, or 1 for a factor.

    **Raises:** `ValueError` for a draw that replaces leaves in different units.
    """
    if apply not in (replace, add):
        return "1"
    units = {address: unit_of(scenario, address) for address in addresses}
    if len(set(units.values())) > 1:
        described = ", ".join(f"{address} ({unit})" for address, unit in units.items())
        raise ValueError(
            f"dispersion {name!r} moves leaves in different units by one draw: "
            f"{described}. Disperse each by itself, or a factor on all of them"
        )
    return next(iter(units.values()))


def check_dispersions(
    scenario: Scenario, dispersions: Mapping[str, Dispersion]
) -> None:
    """Refuse dispersions that `disperse` refuses, or that cannot be drawn.

    Also those without an effect: of a number on which no flight depends, or a factor on
    zero.
    """
    draws = {name: jnp.zeros(()) for name in dispersions}
    jax.eval_shape(lambda draws: disperse(scenario, dispersions, draws), draws)
    _codes(numbers_of_streams(dispersions))
    leaves = leaves_by_address(scenario)
    moved: set[str] = set()
    replacing = []
    for name, dispersion in dispersions.items():
        addresses = addresses_of_dispersion(scenario, name, dispersion)
        unit = unit_of_draw(scenario, name, addresses, dispersion.apply)
        for address in addresses:
            require_effect(scenario, address)
            if dispersion.apply is multiply and address not in moved:
                _refuse_factor_on_zero(name, address, leaves[address])
        moved.update(addresses)
        distribution = dispersion.distribution
        try:
            distribution = with_leaves(distribution)
        except ValueError as error:
            raise ValueError(f"dispersions.{name}.{error}") from None
        numbers = leaves_by_address(distribution)
        for field, value in numbers.items():
            metadata = field_metadata(distribution, field)
            if np.ndim(value) and is_scalar(metadata):
                raise ValueError(
                    f"dispersions.{name}.{field} has the shape {np.shape(value)}: it must "
                    "be one number"
                )
            check_values(f"dispersions.{name}.{field}", np.asarray(value), metadata)
        if {"lower", "upper"} <= set(numbers):
            lower, upper = float(numbers["lower"]), float(numbers["upper"])
            if not lower < upper:
                least, most = (quantity_in_words(x, unit) for x in (lower, upper))
                raise ValueError(
                    f"dispersions.{name}.lower is {least}: it must be below upper, "
                    f"which is {most}"
                )
        if isinstance(distribution, TruncatedNormal):
            _refuse_empty_interval(name, distribution)
        if dispersion.apply is replace:
            replacing += [(name, a, leaves[a], unit, distribution) for a in addresses]
    require_felt(scenario, moved)
    require_both(scenario, moved)
    for name, address, leaf, unit, distribution in replacing:
        _refuse_replacing_factor(name, address, leaf, unit, distribution)
        mean = float(distribution.moments()[0])
        warn_of_another_unit(f"dispersion {name!r}", address, leaf, mean, unit)
    for noise, seed in _noises(leaves).items():
        size = leaves.get(noise, np.zeros(()))
        said = (
            quantity_in_words(size, unit_of(scenario, noise)) if noise in leaves else ""
        )
        if noise in moved:
            said = "dispersed"
        elif not np.any(np.asarray(size) > 0.0):
            continue
        if seed not in moved:
            raise ValueError(
                f"{noise} is {said}, and all runs would have the same: disperse "
                f"{seed} by Uniform(0, 1), or take dispersions of the mission that do "
                "(their names: jentry list)"
            )


_NOISES = {
    "accelerometers.noise": "accelerometers.noise_seed",
    "flow_sensors.noise": "flow_sensors.noise_seed",
    "navigation.noise.velocity_random_walk": "navigation.seed",
    "navigation.noise.angle_random_walk": "navigation.seed",
}
"""Address of the seed of each noise, by that of its size"""

_SENSORS, _THEIR_SEED = "navigation.filter.sensors.", "navigation.seed"


def _noises(leaves: Mapping[str, Array]) -> dict[str, str]:
    """Address of the seed of each noise of a scenario, by that of its size."""
    sensors = [a for a in leaves if a.startswith(_SENSORS) and a.endswith(".noise")]
    return _NOISES | dict.fromkeys(sensors, _THEIR_SEED)


def _refuse_factor_on_zero(name: str, address: str, leaf: Array) -> None:
    if not isinstance(leaf, Tracer) and np.asarray(leaf) == 0.0:
        raise ValueError(
            f"dispersion {name!r} has no effect: it is a factor on {address}, which is "
            "zero. Use add or replace"
        )


_FACTORS = 0.5, 2.0
"""Means of draws that are probably meant as factors"""

_NO_FACTOR = 100.0
"""Nominal value, in the SI unit, above which draws about one do not replace it"""


def is_factor(distribution: AbstractDistribution, leaf: Array, unit: str) -> bool:
    """Whether draws in place of a leaf, in its unit, were probably meant as factors."""
    if unit == "1" or isinstance(leaf, Tracer) or np.ndim(leaf):
        return False
    mean, least, most = float(distribution.moments()[0]), *_FACTORS
    return least <= mean <= most and abs(float(leaf)) > _NO_FACTOR


def _refuse_replacing_factor(
    name: str, address: str, leaf: Array, unit: str, distribution: AbstractDistribution
) -> None:
    """Refuse a mass of about 1 kg in place of one of tonnes: a forgotten `apply`."""
    if is_factor(distribution, leaf, unit):
        mean = float(distribution.moments()[0])
        raise ValueError(
            f"dispersion {name!r} replaces {address}, which is {float(leaf):g} {unit}, by "
            f"draws about {mean:g} {unit}. For a factor use apply=multiply"
        )


def warn_of_another_unit(
    source: str, address: str, leaf: Array, values: float, unit: str
) -> None:
    """Warn of values for a leaf that were probably meant in another unit than SI.

    `source` says where they come from, and `values` is a number of their size. See
    `forgotten_unit`.
    """
    if isinstance(leaf, Tracer) or np.ndim(leaf):
        return
    meant = forgotten_unit(values, float(leaf), unit)
    if meant:
        warnings.warn(
            f"{source} replaces {address}, which is {float(leaf):g} {unit}, by numbers "
            f"about {values:g} {unit}: if they are in {meant}, convert them to SI",
            stacklevel=4,
        )


def _refuse_empty_interval(name: str, distribution: TruncatedNormal) -> None:
    lower, upper = distribution.in_deviations()
    nearest = max(float(lower), -float(upper))
    if nearest > _FARTHEST:
        raise ValueError(
            f"dispersions.{name}.mean is {nearest:.0f} standard deviations from the "
            f"interval that is drawn from: it must be {_FARTHEST:g} at most"
        )


def dispersed_inputs(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    runs: Int[Array, " runs"],
) -> dict[str, Float[Array, " runs"]]:
    """Inputs of many runs, by address."""
    # As pairs: JAX sorts the names of a dictionary, and dispersions depend on their order.
    return _dispersed_inputs(scenario, tuple(dispersions.items()), key, runs)


@cached
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


@cached
def inputs_of_shares(
    scenario: Scenario,
    pairs: tuple[tuple[str, Dispersion], ...],
    shares: Mapping[str, Array],
) -> dict[str, Float[Array, " runs"]]:
    """Inputs of many runs by address, from the shares that a sampler has chosen.

    **Arguments:**

    - `pairs`: names and dispersions, in their order.
    - `shares`: the shares of each stream, of shape (runs,) or (runs, numbers).
    """
    dispersions = dict(pairs)

    def one(shares: Mapping[str, Array]) -> dict[str, Array]:
        draws = {
            name: jnp.asarray(d.distribution.quantile(shares[d.stream or name]))
            for name, d in dispersions.items()
        }
        inputs = disperse(scenario, dispersions, draws)
        return {address: jnp.asarray(value) for address, value in inputs.items()}

    return jax.vmap(one)(shares)
