"""Planned drag profiles and aerodynamics written again in numpy, shared by test files."""

import numpy as np

from jentry.missions.x_33.airframe import ScheduledAngleOfAttack, vehicle
from jentry.motion.constraints import (
    DynamicPressure,
    EquilibriumGlide,
    HeatRate,
    NormalLoadFactor,
)
from jentry.planning.drag_profile import plan_drag_profile
from jentry.units import km, standard_gravity
from jentry.world.atmosphere import ExponentialAtmosphere
from jentry.world.gravity import InverseSquareGravity
from jentry.world.planet import Planet


RADIUS, GRAVITY = 6378.0 * km, 9.81
FIRST, LAST = 7450.0, 760.0
D0, DF = 4.0487, 5.4482
DISTANCE = 3000.0 * km


def planet():
    return Planet(
        radius=RADIUS,
        gravity=InverseSquareGravity(GRAVITY * RADIUS**2),
        atmosphere=ExponentialAtmosphere(1.225, 6600.0),
        heating_coefficient=1.0,
    )


def limits():
    return {
        "heat_rate": HeatRate(3.305e9),
        "normal_load_factor": NormalLoadFactor(2.0 * GRAVITY / standard_gravity),
        "dynamic_pressure": DynamicPressure(16280.0),
        "equilibrium_glide": EquilibriumGlide(limit=0.0),
    }


def planned(first=(FIRST, D0), last=(LAST, DF), distance=DISTANCE, of=None, **options):
    of = limits() if of is None else of
    angle = ScheduledAngleOfAttack()
    return plan_drag_profile(
        planet(), vehicle(), angle, of, first, last, distance, **options
    )


# Twelve lines of numpy: the paper's vehicle and schedule, by their printed numbers.
def alpha(v):
    return 40.0 - np.where(v < 4570.0, 26.0 * ((v - 4570.0) / 3810.0) ** 2, 0.0)


def coefficients(v):
    a = alpha(v)
    lift = -0.041065 + 0.016292 * a + 0.00026024 * a**2
    return lift, 0.080505 - 0.03026 * lift + 0.86495 * lift**2


def drag_of(r, v):
    density = 1.225 * np.exp(-(r - RADIUS) / 6600.0)
    return density * 391.22 * v**2 * coefficients(v)[1] / (2.0 * 104305.0)
