"""One atmosphere, aerodynamics, wind and gravity of each kind."""

import functools

import jax.numpy as jnp
from helpers import over

from jentry.onboard import (
    EstimatedWind,
    PolynomialProfile,
    ScheduledAerodynamics,
    WindEstimate,
    WindPrior,
)
from jentry.onboard.profile_estimation import Learnt
from jentry.units import degree
from jentry.world import (
    ConstantAerodynamics,
    ConstantGravity,
    ConstantWind,
    DensityWave,
    Ellipsoid,
    EnsembleAtmosphere,
    EnsembleWind,
    ExponentialAerodynamics,
    ExponentialAtmosphere,
    GeodeticAtmosphere,
    GeodeticWind,
    GroundWave,
    InverseSquareGravity,
    PerturbedAtmosphere,
    PolynomialAerodynamics,
    RandomAerodynamics,
    RandomAltitudeProfile,
    RandomAtmosphere,
    RandomMachProfile,
    RandomWind,
    ScaledWind,
    StillAir,
    TabulatedAerodynamics,
    TabulatedAtmosphere,
    TabulatedWind,
    USStandardAtmosphere1976,
    ZonalGravity,
    smoothed,
)


def tabulated_atmosphere(**numbers) -> TabulatedAtmosphere:
    """The standard to 120 km as a table."""
    altitudes = jnp.linspace(0.0, 120e3, 61)
    source = USStandardAtmosphere1976()
    density, temperature = over(source.density), over(source.temperature)
    return TabulatedAtmosphere(
        altitudes, density(altitudes), temperature(altitudes), **numbers
    )


WGS_84 = Ellipsoid(6378137.0, 1 / 298.257223563)
"""Defining constants of NIMA TR8350.2, table 3.1"""

all_atmospheres = {
    "exponential": lambda: ExponentialAtmosphere(1.225, 7200.0),
    "standard": USStandardAtmosphere1976,
    "table": tabulated_atmosphere,
    "perturbed": lambda: PerturbedAtmosphere(
        ExponentialAtmosphere(1.225, 7200.0),
        (DensityWave(0.05, 25e3, 0.3), DensityWave(0.02, 8e3)),
        trend=1.2,
        share_low=0.03,
        share_high=0.08,
        ground_waves=(GroundWave(0.02, 800e3, 6371e3, 1.0),),
    ),
    "random": lambda: RandomAtmosphere(
        ExponentialAtmosphere(1.225, 7200.0),
        RandomAltitudeProfile(12e3, seed=0.3, nodes=21),
        0.1,
    ),
    "ensemble": lambda: EnsembleAtmosphere(
        jnp.linspace(0.0, 120e3, 61),
        jnp.stack([f * tabulated_atmosphere().densities for f in (0.9, 1.1)]),
        jnp.stack([f * tabulated_atmosphere().temperatures for f in (1.1, 1.0)]),
        profile=1.0,
    ),
    "over an ellipsoid": lambda: GeodeticAtmosphere(
        ExponentialAtmosphere(1.225, 7200.0), WGS_84, 6371e3, 0.3
    ),
    "smoothed": functools.cache(lambda: smoothed(ExponentialAtmosphere(1.225, 7200.0))),
}


ANGLES = jnp.asarray([0.0, 5.0, 12.0, 20.0, 30.0, 45.0]) * degree
MACHS = jnp.asarray([0.4, 0.9, 1.1, 2.0, 5.0, 12.0, 25.0])
"""The grid of `tabulated_aerodynamics`"""


def lift_of_table(angle, mach):
    return jnp.sin(2.0 * angle) * (0.7 + 0.3 * jnp.exp(-mach))


def drag_of_table(angle, mach):
    return 0.1 + jnp.sin(angle) ** 2 * (1.0 + 1.0 / (1.0 + mach))


def on_grid(f):
    return over(lambda a: over(lambda m: f(a, m))(MACHS))(ANGLES)


def tabulated_aerodynamics() -> TabulatedAerodynamics:
    lift, drag = on_grid(lift_of_table), on_grid(drag_of_table)
    return TabulatedAerodynamics(ANGLES, MACHS, lift, drag)


all_aerodynamics = {
    "constant": lambda: ConstantAerodynamics(0.4, 1.2),
    "polynomial": lambda: PolynomialAerodynamics([-0.04, 0.8], [0.05, -0.1, 0.9]),
    "exponential": lambda: ExponentialAerodynamics(
        2.9, 0.3, 3.4e-4, -0.24, 2.4, 0.4, 1.1e-3, 0.023, 10 * degree
    ),
    "table": tabulated_aerodynamics,
    "random": lambda: RandomAerodynamics(
        ConstantAerodynamics(0.4, 1.2),
        RandomMachProfile(5.0, seed=0.6, nodes=13),
        RandomMachProfile(5.0, seed=0.7, nodes=13),
        0.1,
        0.05,
    ),
    "scheduled": lambda: ScheduledAerodynamics(
        PolynomialAerodynamics([-0.04, 0.8], [0.05, -0.1, 0.9]),
        PolynomialProfile([0.5, 1e-5]),
    ),
}


WIND_ALTITUDES = jnp.asarray([0.0, 1e3, 5e3, 12e3, 13e3, 30e3, 60e3])
EAST_WIND = jnp.asarray([2.0, 5.0, 20.0, 45.0, 44.0, -10.0, -30.0])
NORTH_WIND = jnp.asarray([0.0, -3.0, -3.0, 8.0, 6.0, 0.0, 5.0])

all_winds = {
    "still": StillAir,
    "constant": lambda: ConstantWind(10.0, -4.0, 0.5),
    "table": lambda: TabulatedWind(WIND_ALTITUDES, EAST_WIND, NORTH_WIND),
    "scaled": lambda: ScaledWind(
        TabulatedWind(WIND_ALTITUDES, EAST_WIND, NORTH_WIND), -1.5
    ),
    "ensemble": lambda: EnsembleWind(
        WIND_ALTITUDES,
        jnp.stack([NORTH_WIND, EAST_WIND]),
        jnp.stack([EAST_WIND, NORTH_WIND]),
        1.0,
    ),
    "random": lambda: RandomWind(
        ConstantWind(10.0, -4.0, 0.5),
        RandomAltitudeProfile(8e3, -1.3e3, seed=0.1, nodes=21),
        RandomAltitudeProfile(8e3, -1.3e3, seed=0.9, nodes=21),
        15.0,
    ),
    "over an ellipsoid": lambda: GeodeticWind(
        ConstantWind(10.0, -4.0, 0.5), WGS_84, 6371e3, 0.3
    ),
    "estimated": lambda: EstimatedWind(
        ConstantWind(10.0, -4.0, 0.5),
        WindPrior(20.0, 30e3),
        WindEstimate(jnp.asarray(120e3), Learnt(jnp.array([-7.0, 12.0]), jnp.eye(2))),
    ),
}


all_gravities = {
    "inverse square": lambda: InverseSquareGravity(4.28283e13),
    "constant": lambda: ConstantGravity(3.7),
    "zonal": lambda: ZonalGravity(4.28283e13, 3396e3, {"j2": 1.9566e-3, "j3": 3.1e-5}),
}
