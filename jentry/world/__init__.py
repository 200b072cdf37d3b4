"""Floor 1: planet, atmosphere, wind, aerodynamics, vehicle."""

from .aerodynamics import AbstractAerodynamics as AbstractAerodynamics
from .aerodynamics import ConstantAerodynamics as ConstantAerodynamics
from .aerodynamics import PolynomialAerodynamics as PolynomialAerodynamics
from .aerodynamics import TabulatedAerodynamics as TabulatedAerodynamics
from .atmosphere import AbstractAtmosphere as AbstractAtmosphere
from .atmosphere import ExponentialAtmosphere as ExponentialAtmosphere
from .gravity import AbstractGravity as AbstractGravity
from .gravity import ConstantGravity as ConstantGravity
from .gravity import InverseSquareGravity as InverseSquareGravity
from .planet import Planet as Planet
from .tabulated_atmosphere import TabulatedAtmosphere as TabulatedAtmosphere
from .us_standard_atmosphere import USStandardAtmosphere1976 as USStandardAtmosphere1976
from .vehicle import Vehicle as Vehicle
from .wind import AbstractWind as AbstractWind
from .wind import ConstantWind as ConstantWind
from .wind import StillAir as StillAir
from .wind import TabulatedWind as TabulatedWind
