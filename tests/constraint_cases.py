"""Path constraints at a point and in a scenario, and the numbers of the air and vehicle."""

import dataclasses

import numpy as np
from helpers import free_scenario, mars_planet, mars_vehicle

from jentry.fields import Scalar, optional_scalar, scalar
from jentry.motion import (
    AbstractConstraint,
    Controls,
    EntryState,
    HeatLoad,
    HeatRate,
    PathPoint,
)
from jentry.units import degree, km


G0 = 9.80665
DENSITY, SCALE_HEIGHT, RADIUS = 0.0158, 9354.5, 3397 * km
"""Of `mars_planet`"""
BETA, LIFT_TO_DRAG = 115.0, 0.18
"""Ballistic coefficient (kg/m2) and lift over drag of `mars_vehicle`"""
GRAVITATION = 4.28283e13


class NoseTemperature(AbstractConstraint):
    """A user's own: radiative equilibrium at the stagnation point."""

    emissivity: Scalar = scalar(0.85, positive=True)
    limit: Scalar | None = optional_scalar(unit="K")
    unit = "K"

    def value(self, point):
        heat_rate = HeatRate().value(point)
        return (heat_rate / (self.emissivity * 5.670374419e-8)) ** 0.25


def point(angle_of_attack=0.3, rotation_rate=0.0, **changes):
    state = EntryState(40 * km, 0.1, 0.2, 4000.0, -0.05, 1.1)
    state = dataclasses.replace(state, **changes)
    controls = Controls(angle_of_attack, np.cos(0.7), np.sin(0.7))
    return PathPoint.of(
        mars_planet(rotation_rate=rotation_rate), mars_vehicle(), state, controls
    )


def constrained_scenario():
    """The usual constraints, an integral and one of a user's own; all peaks located."""
    scenario = free_scenario(50 * degree)
    constraints = {
        **scenario.constraints,
        "heat_load": HeatLoad(5e6),
        "nose_temperature": NoseTemperature(limit=1500.0),
    }
    return dataclasses.replace(
        scenario, constraints=constraints, located_peaks=tuple(constraints)
    )
