"""Legendre-Gauss-Lobatto collocation: nodes, weights, derivatives and interpolation.

A function is represented by its values at N + 1 nodes on [-1, 1], which include both ends,
and by the polynomial of degree N through these values.
"""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .fields import Scalar, Vector


class Collocation(NamedTuple):
    """Nodes of degree N with their weights and differentiation matrices; NumPy arrays."""

    nodes: np.ndarray
    """Nodes, shape (N + 1,), from -1 to 1: the ends, and the zeros of the derivative of the
    Legendre polynomial of degree N"""
    weights: np.ndarray
    """Weights, shape (N + 1,), of the quadrature that is exact for polynomials of degree
    2 N - 1"""
    first: np.ndarray
    """Matrix, shape (N + 1, N + 1), that gives first derivatives at the nodes"""
    second: np.ndarray
    """Matrix, shape (N + 1, N + 1), that gives second derivatives at the nodes"""
    barycentric: np.ndarray
    """Weights of the barycentric form, shape (N + 1,); the largest is 1"""


@functools.cache
def legendre_gauss_lobatto(degree: int) -> Collocation:
    """Nodes and matrices of a degree of one or more.

    They are computed in the longest floating-point type of the machine, so that rounding
    does not grow with the degree.
    """
    if degree < 1:
        raise ValueError(f"degree is {degree}: it must be 1 or more")
    x = _nodes(degree)
    at_nodes, _ = _legendre(degree, x)
    weights = 2 / (degree * (degree + 1) * at_nodes**2)
    # The polynomial alternates in sign from node to node, as these weights do.
    barycentric = 1 / at_nodes
    apart = x[:, None] - x[None, :]
    np.fill_diagonal(apart, 1)
    first = barycentric[None, :] / barycentric[:, None] / apart
    np.fill_diagonal(first, 0)
    np.fill_diagonal(first, -np.sum(first, axis=1))
    second = 2 * first * (np.diag(first)[:, None] - 1 / apart)
    barycentric = barycentric / np.max(np.abs(barycentric))
    rounded = (np.asarray(part, float) for part in (x, weights, barycentric))
    x, weights, barycentric = rounded
    made = Collocation(x, weights, _closed(first), _closed(second), barycentric)
    for part in made:
        part.flags.writeable = False
    return made


def _nodes(degree: int) -> np.ndarray:
    """Nodes by Newton's method from those of Chebyshev, symmetric to the last bit."""
    x = -np.cos(np.pi * np.arange(degree + 1, dtype=np.longdouble) / degree)
    for _ in range(100):
        value, before = _legendre(degree, x)
        # (1 - x^2) P' = N (P_before - x P), whose derivative is -N (N + 1) P.
        step = (x * value - before) / ((degree + 1) * value)
        x = x - step
        if np.max(np.abs(step)) < 4 * np.finfo(x.dtype).eps:
            break
    x[0], x[-1] = -1, 1
    return (x - x[::-1]) / 2


def _legendre(degree: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values of the Legendre polynomials of a degree and of the degree below."""
    before, value = np.ones_like(x), x
    for n in range(1, degree):
        before, value = value, ((2 * n + 1) * x * value - n * before) / (n + 1)
    return value, before


def _closed(matrix: np.ndarray) -> np.ndarray:
    """The rounded matrix, with a diagonal that makes the derivative of a constant zero.

    Half of the rounding of a second derivative comes from the diagonal otherwise.
    """
    rounded = np.asarray(matrix, float)
    np.fill_diagonal(rounded, 0.0)
    np.fill_diagonal(rounded, [-math.fsum(row) for row in rounded])
    return rounded


@jax.custom_jvp
def interpolate(values: Vector, x: Scalar) -> Scalar:
    """The polynomial through values at the nodes, evaluated anywhere in [-1, 1].

    It uses the barycentric formula, and is differentiable to any order, at the nodes too.
    """
    collocation = legendre_gauss_lobatto(values.shape[0] - 1)
    apart = x - collocation.nodes
    here = apart == 0.0
    share = collocation.barycentric / jnp.where(here, 1.0, apart)
    between = jnp.sum(share * values) / jnp.sum(share)
    return jnp.where(jnp.any(here), jnp.sum(jnp.where(here, values, 0.0)), between)


@interpolate.defjvp
def _interpolate_jvp(primals, tangents):
    values, x = primals
    of_values, of_x = tangents
    slopes = legendre_gauss_lobatto(values.shape[0] - 1).first @ values
    rate = interpolate(of_values, x) + interpolate(slopes, x) * of_x
    return interpolate(values, x), rate
