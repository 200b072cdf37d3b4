"""Floor 1: planet, atmosphere, wind, aerodynamics, vehicle."""

from .aerodynamics import (
    AbstractAerodynamics as AbstractAerodynamics,
    AbstractInvertibleAerodynamics as AbstractInvertibleAerodynamics,
    ConstantAerodynamics as ConstantAerodynamics,
    ExponentialAerodynamics as ExponentialAerodynamics,
    PolynomialAerodynamics as PolynomialAerodynamics,
    RandomAerodynamics as RandomAerodynamics,
    TabulatedAerodynamics as TabulatedAerodynamics,
)
from .atmosphere import (
    AbstractAtmosphere as AbstractAtmosphere,
    ExponentialAtmosphere as ExponentialAtmosphere,
)
from .ensemble import (
    EnsembleAtmosphere as EnsembleAtmosphere,
    EnsembleWind as EnsembleWind,
)
from .ensemble_files import Ensemble as Ensemble, read_ensemble as read_ensemble
from .gravity import (
    AbstractGravity as AbstractGravity,
    ConstantGravity as ConstantGravity,
    InverseSquareGravity as InverseSquareGravity,
    ZonalGravity as ZonalGravity,
)
from .perturbed_atmosphere import (
    DensityWave as DensityWave,
    GroundWave as GroundWave,
    PerturbedAtmosphere as PerturbedAtmosphere,
    without_zero_perturbations as without_zero_perturbations,
)
from .planet import Planet as Planet
from .random_air import RandomAtmosphere as RandomAtmosphere, RandomWind as RandomWind
from .random_profile import (
    RandomAltitudeProfile as RandomAltitudeProfile,
    RandomMachProfile as RandomMachProfile,
)
from .shape import (
    Ellipsoid as Ellipsoid,
    GeodeticAtmosphere as GeodeticAtmosphere,
    GeodeticWind as GeodeticWind,
    Sphere as Sphere,
)
from .smoothed_atmosphere import (
    SmoothedAtmosphere as SmoothedAtmosphere,
    smoothed as smoothed,
)
from .tabulated import AbstractTabulated as AbstractTabulated
from .tabulated_atmosphere import TabulatedAtmosphere as TabulatedAtmosphere
from .us_standard_atmosphere import USStandardAtmosphere1976 as USStandardAtmosphere1976
from .vehicle import Vehicle as Vehicle
from .wind import (
    AbstractWind as AbstractWind,
    ConstantWind as ConstantWind,
    ScaledWind as ScaledWind,
    StillAir as StillAir,
    TabulatedWind as TabulatedWind,
)
