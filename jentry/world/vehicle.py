"""The vehicle: mass, size and aerodynamics."""

import equinox as eqx

from .._printed import as_text
from ..fields import Scalar, scalar
from .aerodynamics import AbstractAerodynamics


class Vehicle(eqx.Module):
    """A point mass with lift and drag."""

    mass: Scalar = scalar(unit="kg", positive=True)
    reference_area: Scalar = scalar(unit="m2", positive=True)
    aerodynamics: AbstractAerodynamics = eqx.field(kw_only=True)
    lift_scale: Scalar = scalar(1.0)
    """Factor on the lift coefficient: the usual dispersion."""
    drag_scale: Scalar = scalar(1.0, positive=True)
    """Factor on the drag coefficient: the usual dispersion."""
    trim_angle_of_attack: Scalar = scalar(0.0, unit="rad")
    """Angle of attack before guidance begins. After that every law commands an angle of
    attack."""
    nose_radius: Scalar = scalar(1.0, unit="m", positive=True)
    """Nose radius for the heat rate at the stagnation point."""

    __str__ = as_text

    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar, airspeed: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Lift and drag coefficient, including the factors."""
        lift, drag = self.aerodynamics.coefficients(angle_of_attack, mach, airspeed)
        return self.lift_scale * lift, self.drag_scale * drag
