"""Floor 5: scenario, end conditions, solvers, and `fly`."""

from .fly import Flight as Flight, History as History, fly as fly
from .misses import Misses as Misses, misses as misses
from .scenario import Scenario as Scenario, Target as Target, check as check
from .solver import Adaptive as Adaptive, FixedStep as FixedStep
from .termination import (
    AltitudeAbove as AltitudeAbove,
    AltitudeBelow as AltitudeBelow,
    Outcome as Outcome,
    TargetPassed as TargetPassed,
    Termination as Termination,
    VelocityBelow as VelocityBelow,
)
