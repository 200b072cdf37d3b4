"""Truths and vehicles of the cases of other authors, shared by test files."""

from helpers import truths

from jentry.flight import Target
from jentry.units import foot, slug
from jentry.world import ConstantAerodynamics, Vehicle


CLOSED = truths("closed_forms.csv")

NOWHERE = Target(0.0, 1.0, 0.0)


def ballistic_vehicle(ballistic_coefficient, lift_to_drag=0.0):
    """Drag coefficient and area one, so that the mass is the ballistic coefficient."""
    aerodynamics = ConstantAerodynamics(lift_to_drag, 1.0)
    return Vehicle(ballistic_coefficient, 1.0, aerodynamics=aerodynamics)


def sphere_of_nasa(drag_coefficient=0.1):
    """That of the NESC check cases, NASA/TM-2015-218675: 1 slug, 0.1963495 ft2."""
    aerodynamics = ConstantAerodynamics(0.0, drag_coefficient)
    return Vehicle(1.0 * slug, 0.1963495 * foot**2, aerodynamics=aerodynamics)
