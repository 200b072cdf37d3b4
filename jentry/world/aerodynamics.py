"""Aerodynamic coefficients over angle of attack and speed."""

import os
from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._interpolation import check_grid, interpolate_surface
from .._math import horner
from .._tables import read_columns
from ..fields import NOT_NEGATIVE, Scalar, scalar, table
from ..units import degree
from .random_profile import RandomMachProfile
from .tabulated import AbstractTabulated, Edges


class AbstractAerodynamics(eqx.Module):
    """Lift and drag coefficients of a vehicle in trimmed flight."""

    @abstractmethod
    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar, airspeed: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Lift and drag coefficient at an angle of attack (rad), a Mach number and an
        airspeed (m/s). Published fits use either the Mach number or the airspeed."""


class AbstractInvertibleAerodynamics(AbstractAerodynamics):
    """Aerodynamics whose angle of attack follows from the lift coefficient."""

    @abstractmethod
    def angle_of_attack(self, lift: Scalar, mach: Scalar, airspeed: Scalar) -> Scalar:
        """Angle of attack (rad) at which the lift coefficient has a value."""


class ConstantAerodynamics(AbstractAerodynamics):
    """Coefficients that do not depend on attitude or speed."""

    lift_coefficient: Scalar = scalar()
    drag_coefficient: Scalar = scalar(positive=True)

    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar, airspeed: Scalar
    ) -> tuple[Scalar, Scalar]:
        return self.lift_coefficient, self.drag_coefficient


class PolynomialAerodynamics(AbstractAerodynamics):
    """Coefficients that are polynomials in the angle of attack (rad) at any Mach number.

    This example has a lift coefficient of -0.04 + 0.8 a and a drag coefficient of
    0.05 - 0.1 a + 0.9 a^2:

        PolynomialAerodynamics([-0.04, 0.8], [0.05, -0.1, 0.9])
    """

    lift_polynomial: Float[Array, "..."] = table()
    """Coefficients of the lift, shape (n,), the constant term first, in 1/rad^k"""
    drag_polynomial: Float[Array, "..."] = table()
    """Coefficients of the drag, shape (m,), the constant term first, in 1/rad^k"""

    def __check_init__(self):
        for name in ("lift_polynomial", "drag_polynomial"):
            shape = getattr(self, name).shape
            if len(shape) != 1 or shape[0] == 0:
                raise ValueError(
                    f"{name} has shape {shape}: expected one axis, the constant term "
                    "first"
                )

    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar, airspeed: Scalar
    ) -> tuple[Scalar, Scalar]:
        return (
            horner(self.lift_polynomial[::-1], angle_of_attack),
            horner(self.drag_polynomial[::-1], angle_of_attack),
        )


class ExponentialAerodynamics(AbstractInvertibleAerodynamics):
    """Lift linear and drag quadratic in the angle of attack, with exponentials in airspeed.

    C_L = lift_slope a + lift_tail exp(-lift_decay v) + lift_constant and
    C_D = drag_curvature max(a, least)^2 + drag_tail exp(-drag_decay v) + drag_constant,
    with the angle of attack a in rad and the airspeed v in m/s. The fit to the tables of
    the Common Aero Vehicle has this form. These tables begin at the `least` angle of
    attack; below it the drag is constant.
    """

    lift_slope: Scalar = scalar(unit="1/rad", positive=True)
    lift_tail: Scalar = scalar()
    lift_decay: Scalar = scalar(unit="s/m")
    lift_constant: Scalar = scalar()
    drag_curvature: Scalar = scalar(unit="1/rad2")
    drag_tail: Scalar = scalar()
    drag_decay: Scalar = scalar(unit="s/m")
    drag_constant: Scalar = scalar()
    least_angle_of_attack: Scalar = scalar(unit="rad")

    def lift_at_zero(self, airspeed: Scalar) -> Scalar:
        """Lift coefficient at an angle of attack of zero."""
        return self.lift_tail * jnp.exp(-self.lift_decay * airspeed) + (
            self.lift_constant
        )

    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar, airspeed: Scalar
    ) -> tuple[Scalar, Scalar]:
        lift = self.lift_slope * angle_of_attack + self.lift_at_zero(airspeed)
        beyond = jnp.maximum(angle_of_attack, self.least_angle_of_attack)
        drag = (
            self.drag_curvature * beyond * beyond
            + self.drag_tail * jnp.exp(-self.drag_decay * airspeed)
            + self.drag_constant
        )
        return lift, drag

    def angle_of_attack(self, lift: Scalar, mach: Scalar, airspeed: Scalar) -> Scalar:
        return (lift - self.lift_at_zero(airspeed)) / self.lift_slope


class TabulatedAerodynamics(AbstractAerodynamics, AbstractTabulated):
    """Tables over angle of attack and Mach number, interpolated by a bicubic surface.

    The surface is once differentiable. It is monotone along the lines of the table, so
    that it does not overshoot where drag rises at the speed of sound. Beyond the edges
    the coefficients hold their value at the edge: see `AbstractTabulated`.
    """

    angles_of_attack: Float[Array, "..."] = table(unit="rad", increasing=True)
    """Angles of attack, rad, shape (n,), increasing"""
    mach_numbers: Float[Array, "..."] = table(increasing=True)
    """Mach numbers, shape (m,), increasing"""
    lift_coefficients: Float[Array, "..."] = table()
    """Lift coefficients, shape (n, m)"""
    drag_coefficients: Float[Array, "..."] = table()
    """Drag coefficients, shape (n, m)"""

    def __check_init__(self):
        check_grid("angles_of_attack", self.angles_of_attack)
        check_grid("mach_numbers", self.mach_numbers)
        expected = (self.angles_of_attack.shape[0], self.mach_numbers.shape[0])
        for name in ("lift_coefficients", "drag_coefficients"):
            shape = getattr(self, name).shape
            if shape != expected:
                raise ValueError(
                    f"{name} has shape {shape}: expected {expected}, a row for each of "
                    f"the {expected[0]} angles of attack and a column for each of the "
                    f"{expected[1]} Mach numbers"
                )

    def edges(self) -> Edges:
        machs, angles = self.mach_numbers, self.angles_of_attack
        return {
            "mach_numbers": (machs[0], machs[-1]),
            "angles_of_attack": (angles[0], angles[-1]),
        }

    @classmethod
    def from_csv(
        cls, path: str | os.PathLike, refuse_beyond: bool = False
    ) -> "TabulatedAerodynamics":
        """Read a table with one row for each pair of angle of attack and Mach number.

        Its columns are `angle_of_attack_deg,mach,lift_coefficient,drag_coefficient`.
        The rows may be in any order, and every pair must occur once.

        Raises `ValueError` that names the file, the line and what was expected there.
        """
        columns, lines = read_columns(
            path,
            ("angle_of_attack_deg", "mach", "lift_coefficient", "drag_coefficient"),
        )
        angles, row = np.unique(columns["angle_of_attack_deg"], return_inverse=True)
        machs, column = np.unique(columns["mach"], return_inverse=True)
        first_line = np.zeros((len(angles), len(machs)), dtype=int)
        for i, j, line in zip(row, column, lines, strict=True):
            if first_line[i, j]:
                raise ValueError(
                    f"{path}, line {line}: {angles[i]:g} deg at Mach {machs[j]:g} "
                    f"stands on line {first_line[i, j]} already; expected every pair "
                    "once"
                )
            first_line[i, j] = line
        if not np.all(first_line):
            i, j = np.argwhere(first_line == 0)[0]
            raise ValueError(
                f"{path}: no row for {angles[i]:g} deg at Mach {machs[j]:g}; expected "
                f"all {len(angles)} x {len(machs)} pairs"
            )
        lift = np.empty(first_line.shape)
        drag = np.empty(first_line.shape)
        lift[row, column] = columns["lift_coefficient"]
        drag[row, column] = columns["drag_coefficient"]
        tables = angles * degree, machs, lift, drag
        numbers = (jnp.asarray(each) for each in tables)
        return cls(*numbers, refuse_beyond=refuse_beyond)

    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar, airspeed: Scalar
    ) -> tuple[Scalar, Scalar]:
        lift, drag = interpolate_surface(
            self.angles_of_attack,
            self.mach_numbers,
            jnp.stack([self.lift_coefficients, self.drag_coefficients], axis=-1),
            angle_of_attack,
            mach,
        )
        return lift, drag


class RandomAerodynamics(AbstractAerodynamics):
    """Aerodynamics whose lift and drag are multiplied by random factors over Mach number.

    The factors are exponentials of random profiles. At every Mach number they are lognormal
    with a median of 1, so the drag is never negative. Disperse
    `vehicle.aerodynamics.lift.seed` and `vehicle.aerodynamics.drag.seed`, each by
    `Uniform(0, 1)`. Disperse both by one draw to leave lift over drag unchanged.
    """

    undisturbed: AbstractAerodynamics
    lift: RandomMachProfile
    drag: RandomMachProfile
    lift_deviation: Scalar = scalar(range=NOT_NEGATIVE)
    """Standard deviation of the natural logarithm of the factor on the lift"""
    drag_deviation: Scalar = scalar(range=NOT_NEGATIVE)
    """Standard deviation of the natural logarithm of the factor on the drag"""

    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar, airspeed: Scalar
    ) -> tuple[Scalar, Scalar]:
        lift, drag = self.undisturbed.coefficients(angle_of_attack, mach, airspeed)
        return (
            lift * jnp.exp(self.lift_deviation * self.lift(mach)),
            drag * jnp.exp(self.drag_deviation * self.drag(mach)),
        )
