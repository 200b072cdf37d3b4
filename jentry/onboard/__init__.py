"""Floor 3: profiles, references, what the vehicle measures and believes."""

from .model import OnboardModel as OnboardModel
from .navigation import Measurement as Measurement, measure as measure
from .profiles import (
    AbstractProfile as AbstractProfile,
    PolynomialProfile as PolynomialProfile,
    QuinticProfile as QuinticProfile,
    quintic_profile as quintic_profile,
)
from .reference import (
    AbstractIndex as AbstractIndex,
    DragReference as DragReference,
    EnergyIndex as EnergyIndex,
    TimeIndex as TimeIndex,
    VelocityIndex as VelocityIndex,
)
