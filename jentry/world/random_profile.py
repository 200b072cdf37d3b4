"""Random functions of the altitude or of the Mach number, with a correlation length."""

import dataclasses
import itertools
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array

from .._interpolation import clamp
from ..fields import Scalar, scalar


Tree = TypeVar("Tree")


class RandomAltitudeProfile(eqx.Module):
    """A random function of the altitude with mean 0 and variance 1 everywhere.

    Its values at equally spaced nodes are a stationary Gauss-Markov sequence: two of them
    are normal with the correlation exp(-distance / correlation_length). Between the nodes
    the function is smooth and has variance 1 too. Beyond the ends it is constant. One
    number, `seed`, selects the function: disperse it by `Uniform(0, 1)`.

    Choose a spacing of the nodes well below the correlation length. The function has no
    variation over less than that spacing.
    """

    correlation_length: Scalar = scalar(unit="m", positive=True)
    low: Scalar = scalar(0.0, unit="m")
    """Altitude of the first node"""
    high: Scalar = scalar(100e3, unit="m")
    """Altitude of the last node"""
    seed: Scalar = scalar(0.0, range=(0.0, 1.0), choice=True)
    """A number between 0 and 1, of which 31 bits count"""
    nodes: int = eqx.field(default=41, static=True)
    values: tuple[Scalar, ...] | None = None
    """At the nodes; drawn by `fly` from the seed"""

    def __check_init__(self):
        _check(self)

    def __call__(self, altitude: Scalar) -> Scalar:
        return _gauss_markov(self, altitude)


class RandomMachProfile(eqx.Module):
    """A random function of the Mach number, analogous to `RandomAltitudeProfile`."""

    correlation_length: Scalar = scalar(positive=True)
    """Correlation length, in Mach numbers"""
    low: Scalar = scalar(0.0)
    """Mach number of the first node"""
    high: Scalar = scalar(30.0)
    """Mach number of the last node"""
    seed: Scalar = scalar(0.0, range=(0.0, 1.0), choice=True)
    """A number between 0 and 1, of which 31 bits count"""
    nodes: int = eqx.field(default=31, static=True)
    values: tuple[Scalar, ...] | None = None
    """At the nodes; drawn by `fly` from the seed"""

    def __check_init__(self):
        _check(self)

    def __call__(self, mach: Scalar) -> Scalar:
        return _gauss_markov(self, mach)


_Profile = RandomAltitudeProfile | RandomMachProfile


def _check(profile: _Profile) -> None:
    if profile.nodes < 2:
        raise ValueError(f"nodes is {profile.nodes}: a profile has 2 or more")
    ends = profile.low, profile.high
    if any(not eqx.is_array(x) or isinstance(x, Tracer) for x in ends):
        return
    low, high = (float(x) for x in ends)
    if not low < high:
        raise ValueError(f"low is {low:g}: it must be below high, which is {high:g}")


def settled(tree: Tree) -> Tree:
    """The tree with the nodes of all random profiles drawn once for a whole flight.

    The values of the profiles do not change. Without this, each evaluation of a profile
    draws all of its nodes.
    """

    def is_profile(node: Any) -> bool:
        return isinstance(node, _Profile)

    def drawn(node: Any) -> Any:
        if not is_profile(node) or node.values is not None:
            return node
        return dataclasses.replace(node, values=_drawn(node))

    return jax.tree.map(drawn, tree, is_leaf=is_profile)


def _spacing(profile: _Profile) -> Scalar:
    return (profile.high - profile.low) / (profile.nodes - 1)


def _likeness(profile: _Profile) -> Scalar:
    """Correlation of two adjacent nodes."""
    return jnp.exp(-_spacing(profile) / profile.correlation_length)


def _drawn(profile: _Profile) -> tuple[Scalar, ...]:
    """Values at the nodes, of unit variance."""
    seed = jnp.asarray(profile.seed * (2.0**31 - 1.0)).astype(jnp.uint32)
    key = jax.random.fold_in(jax.random.key(0), seed)
    likeness = _likeness(profile)
    # sqrt(1 - likeness^2), without loss of digits if adjacent nodes are highly correlated.
    fresh = jnp.sqrt(-jnp.expm1(-2.0 * _spacing(profile) / profile.correlation_length))

    def advance(before: Array, node: Array) -> tuple[Array, Array]:
        normal = jax.random.normal(jax.random.fold_in(key, node), dtype=float)
        value = jnp.where(node == 0, normal, likeness * before + fresh * normal)
        return value, value

    nodes = jnp.arange(profile.nodes, dtype=jnp.uint32)
    _, values = jax.lax.scan(advance, jnp.zeros_like(likeness), nodes)
    # Separate scalars: if each flight indexes its own array, the compiler may treat the
    # last flights of a block differently from the others.
    return tuple(values[i] for i in range(profile.nodes))


def _gauss_markov(profile: _Profile, place: Scalar) -> Scalar:
    """Value at an altitude or Mach number, of unit variance."""
    values = _drawn(profile) if profile.values is None else profile.values
    position = (place - profile.low) / _spacing(profile)
    position = clamp(position, 0.0, profile.nodes - 1.0)
    before = jnp.clip(jnp.floor(position), 0.0, profile.nodes - 2.0)
    along = position - before
    left = right = jnp.zeros_like(position)
    for node, (value, following) in enumerate(itertools.pairwise(values)):
        here = before == node
        left = jnp.where(here, value, left)
        right = jnp.where(here, following, right)
    # The blend has no curvature at the nodes, so the slope of the profile has no kink.
    share = along * along * along * (10.0 + along * (6.0 * along - 15.0))
    rest = 1.0 - share
    # A mean of two numbers varies less than each of them: scale the variance back to 1.
    variance = rest * rest + share * share + 2.0 * rest * share * _likeness(profile)
    return (rest * left + share * right) / jnp.sqrt(variance)
