"""The covariance of the errors of inertial navigation, in flight and when measured."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..fields import Scalar


Square = Float[Array, "n n"]
Rows = Float[Array, "k n"]
Column = Float[Array, " k"]

MOTION = 9
"""Number of errors of position, velocity and attitude, which come first"""


class MeasuredValue(NamedTuple):
    """One measured value of a number that the errors change."""

    residual: Scalar
    """Measured minus expected"""
    row: Float[Array, " n"]
    """Derivatives of the expected value with respect to the errors"""
    deviation: Scalar
    """Standard deviation of the noise that is assumed"""
    gate: Scalar
    """Number of standard deviations of the residual beyond which the value is rejected"""
    made: Any
    """Whether there is a measurement"""


class ErrorCovariance(eqx.Module):
    """Covariance of n errors at a time, and what has happened to them since.

    The errors of the motion change, those of the instruments do not.
    """

    matrix: Square
    change: Rows
    """The errors of the motion since, minus those at that time: derivatives with respect to
    all errors at that time, of shape (9, n)"""
    noise: Column
    """Variances that noise has added since to the errors of the motion, of shape (9,)"""

    @classmethod
    def now(cls, matrix: Square) -> "ErrorCovariance":
        """A covariance to which nothing has happened."""
        return cls(matrix, jnp.zeros((MOTION, matrix.shape[0])), jnp.zeros(MOTION))

    def later(self, step: Rows, noise: Column) -> "ErrorCovariance":
        """The covariance after a short time, in which noise adds variances.

        `step` is the mean of the derivatives of the rates of the motion, of shape (9, n),
        times that time. Its transition is of the second order.
        """
        first = step + _product(step[:, :MOTION], self.change)
        change = self.change + first + 0.5 * _product(step[:, :MOTION], first)
        return ErrorCovariance(self.matrix, change, self.noise + noise)

    def moved(self) -> "ErrorCovariance":
        """The covariance of the errors now, with the noise added at the end."""
        before, change = self.matrix, self.change
        moved = _product(change, before)
        grown = moved[:, :MOTION] + _product(moved, change.T) + jnp.diag(self.noise)
        motion = before[:MOTION, :MOTION] + grown + moved[:, :MOTION].T
        across = before[:MOTION, MOTION:] + moved[:, MOTION:]
        rows = [[motion, across], [across.T, before[MOTION:, MOTION:]]]
        return ErrorCovariance.now(jnp.block(rows))

    def corrected(
        self, values: MeasuredValue
    ) -> tuple["ErrorCovariance", Float[Array, " n"], Float[Array, " values"]]:
        """The covariance after measured values, which are taken one after the other.

        Returned beside it: the correction of what is estimated, of shape (n,), and for each
        value 1 if it was rejected and 0 if not.

        `values` has a first axis, one place for each value. The errors are of the time of
        `matrix`: nothing may have happened to them since.
        """

        def take(
            known: tuple[Square, Array], value: MeasuredValue
        ) -> tuple[tuple[Square, Array], Scalar]:
            covariance, shift = known
            along = covariance @ value.row
            off = value.residual - value.row @ shift
            variance = value.row @ along + value.deviation**2
            near = off * off <= value.gate**2 * variance
            gain = jnp.where(value.made & near, along / variance, 0.0)
            # Both factors are of the same vector: the covariance stays symmetric, to
            # rounding.
            covariance = covariance - variance * gain[:, None] * gain[None]
            rejected = jnp.where(value.made & ~near, 1.0, 0.0)
            return (covariance, shift + gain * off), rejected

        known = self.matrix, jnp.zeros(self.matrix.shape[0])
        (matrix, shift), rejected = lax.scan(take, known, values)
        return ErrorCovariance.now(matrix), shift, jnp.asarray(rejected)


def derivatives(function: Callable[[Any], Any], at: Any) -> Rows:
    """Derivatives of the numbers that a function returns, one row for each, by `jvp`."""
    leaves, structure = jax.tree.flatten(jax.tree.map(jnp.asarray, at))

    def push(direction: Array) -> list[Array]:
        tangents = jax.tree.unflatten(structure, list(direction))
        at = jax.tree.unflatten(structure, leaves)
        return jax.tree.leaves(jax.jvp(function, (at,), (tangents,))[1])

    return jnp.stack(jax.vmap(push)(jnp.eye(len(leaves))))


def _product(a: Rows, b: Float[Array, "n m"]) -> Float[Array, "k m"]:
    """The product of two matrices.

    As a sum of outer products it is compiled with what surrounds it. In a batch of flights
    XLA hands a small product to a library, and the filter takes twice the time.
    """
    outer = [a[:, i, None] * b[None, i] for i in range(a.shape[1])]
    return functools.reduce(jnp.add, outer)
