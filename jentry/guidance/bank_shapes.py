"""Shapes of the bank over the rest of a flight, told by one number or by two."""

import math
from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._interpolation import clamp
from .._math import sincos
from ..fields import Scalar, scalar
from ..onboard.profiles import AbstractProfile
from ..units import degree


Numbers = Float[Array, " numbers"]
"""One or two, which tell a bank over the rest of the flight"""


class AbstractBankShape(eqx.Module):
    """The bank over the rest of the flight, told by one number or by two.

    They are corrected between bounds, within which every number is a bank. The first one
    is such that more of it flies farther.
    """

    bounds: ClassVar[tuple[tuple[float, float], ...]]
    """Least and largest value of each number"""

    @property
    @abstractmethod
    def numbers(self) -> Numbers:
        """At the start, before there is anything to predict with."""

    @abstractmethod
    def cos_bank(self, numbers: Numbers, index: Scalar, since: Scalar) -> Scalar:
        """Cosine of the bank at a value of the index of the law, from -1 to 1.

        **Arguments:**

        - `numbers`: as they are corrected.
        - `index`: there.
        - `since`: its value at the decision.
        """


class ConstantBankShape(AbstractBankShape):
    """One bank for the rest of the flight. For capsules.

    Its cosine goes from that of the largest bank, with the number 0, to 1.
    """

    bounds = ((0.0, 1.0),)

    first: Scalar = scalar(0.75, range=(0.0, 1.0))
    """Number at the start"""
    lowest: Scalar = scalar(-1.0, range=(-1.0, 1.0))
    """Cosine of the largest bank"""

    @property
    def numbers(self) -> Numbers:
        return jnp.stack([self.first])

    def cos_bank(self, numbers: Numbers, index: Scalar, since: Scalar) -> Scalar:
        return self.lowest + numbers[0] * (1.0 - self.lowest)


class LinearBankShape(AbstractBankShape):
    """A bank that goes linearly over the index to one at the end. For gliders.

    The first number is the bank now: with 0 it is the largest, with 1 the wings are level.
    That at the end is given.
    """

    end: Scalar = scalar()
    """Value of the index at the end"""
    final: Scalar = scalar(60.0 * degree, unit="rad", range=(0.0, math.pi))
    """Bank at the end"""
    largest: Scalar = scalar(90.0 * degree, unit="rad", range=(0.0, math.pi))
    """Largest bank"""
    first: Scalar = scalar(0.5, range=(0.0, 1.0))
    """First number at the start"""

    bounds = ((0.0, 1.0),)

    @property
    def numbers(self) -> Numbers:
        return jnp.stack([self.first])

    def cos_bank(self, numbers: Numbers, index: Scalar, since: Scalar) -> Scalar:
        return self._between(numbers[0], self.final, index, since)

    def _between(
        self, number: Scalar, final: Scalar, index: Scalar, since: Scalar
    ) -> Scalar:
        left = self.end - since
        there = left != 0.0
        way = (index - since) / jnp.where(there, left, 1.0)
        way = jnp.where(there, clamp(way, 0.0, 1.0), 1.0)
        start = self.largest * (1.0 - number)
        return sincos(start + way * (final - start))[1]


class TwoEndedBankShape(LinearBankShape):
    """A linear bank of which both ends are free: it meets the altitude at the end as well.

    The second number is the bank at the end, likewise; `final` is where it begins.
    """

    bounds = ((0.0, 1.0), (0.0, 1.0))

    @property
    def numbers(self) -> Numbers:
        return jnp.stack([self.first, 1.0 - self.final / self.largest])

    def cos_bank(self, numbers: Numbers, index: Scalar, since: Scalar) -> Scalar:
        final = self.largest * (1.0 - numbers[1])
        return self._between(numbers[0], final, index, since)


class GivenBankShape(AbstractBankShape):
    """The cosine of a given bank, moved towards wings level or towards the largest bank.

    With the number 0 it is as given, with 1 the wings are level all the way, with -1 the
    bank is the largest, and the cosine is linear in between. A bank that was planned will
    do, of which nothing else is tracked.
    """

    bounds = ((-1.0, 1.0),)

    shape: AbstractProfile
    """Cosine of the bank over the index of the law"""
    lowest: Scalar = scalar(-1.0, range=(-1.0, 1.0))
    """Cosine of the largest bank"""
    first: Scalar = scalar(0.0, range=(-1.0, 1.0))
    """Number at the start"""

    @property
    def numbers(self) -> Numbers:
        return jnp.stack([self.first])

    def cos_bank(self, numbers: Numbers, index: Scalar, since: Scalar) -> Scalar:
        (number,) = numbers
        cosine = clamp(self.shape(index), self.lowest, 1.0)
        room = jnp.where(number > 0.0, 1.0 - cosine, cosine - self.lowest)
        return cosine + number * room
