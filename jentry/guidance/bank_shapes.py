"""Shapes of the bank over the rest of a flight, defined by one number or by two."""

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
"""One or two numbers that define the bank over the rest of the flight"""


class AbstractBankShape(eqx.Module):
    """Bank over the rest of the flight, defined by one number or by two.

    The numbers are corrected between bounds, within which each value gives a valid bank. A
    larger first number gives a longer range.
    """

    bounds: ClassVar[tuple[tuple[float, float], ...]]
    """Least and largest value of each number"""

    @property
    @abstractmethod
    def numbers(self) -> Numbers:
        """Numbers at the start, before there is a prediction."""

    @abstractmethod
    def cos_bank(self, numbers: Numbers, index: Scalar, since: Scalar) -> Scalar:
        """Cosine of the bank at a value of the index of the law, from -1 to 1.

        **Arguments:**

        - `numbers`: the corrected numbers.
        - `index`: value of the index of the law at which the bank is evaluated.
        - `since`: value of the index at the decision.
        """


class ConstantBankShape(AbstractBankShape):
    """Constant bank for the rest of the flight, for capsules.

    Its cosine goes from that of the largest bank, for the number 0, to 1, for the number 1.
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
    """Bank that changes linearly over the index to a final bank, for gliders.

    The number defines the bank now: 0 is the largest bank, 1 is wings level. The bank at
    the end is fixed.
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
    """Linear bank with two free ends, which also meets the altitude at the end.

    The second number defines the bank at the end in the same way; it starts at `final`.
    """

    bounds = ((0.0, 1.0), (0.0, 1.0))

    @property
    def numbers(self) -> Numbers:
        return jnp.stack([self.first, 1.0 - self.final / self.largest])

    def cos_bank(self, numbers: Numbers, index: Scalar, since: Scalar) -> Scalar:
        final = self.largest * (1.0 - numbers[1])
        return self._between(numbers[0], final, index, since)


class PrescribedBankShape(AbstractBankShape):
    """Prescribed cosine of the bank, shifted towards wings level or the largest bank.

    The number 0 gives the prescribed cosine, 1 wings level throughout, and -1 the largest
    bank; the cosine is linear in between. A planned bank can be used, of which nothing
    else is tracked.
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
