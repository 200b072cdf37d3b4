"""Aerodynamic coefficients over angle of attack and Mach number."""

from abc import abstractmethod

import equinox as eqx

from .._types import Scalar, scalar


class AbstractAerodynamics(eqx.Module):
    """Lift and drag coefficients of a vehicle in trimmed flight."""

    @abstractmethod
    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Lift and drag coefficient at an angle of attack (rad) and a Mach number."""


class ConstantAerodynamics(AbstractAerodynamics):
    """The same coefficients in every attitude and at every speed."""

    lift_coefficient: Scalar = scalar()
    drag_coefficient: Scalar = scalar(positive=True)

    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar
    ) -> tuple[Scalar, Scalar]:
        return self.lift_coefficient, self.drag_coefficient
