"""Floor 5: scenario, end conditions, solvers, and `fly`."""

from .flight import Flight as Flight, History as History, fly as fly
from .lane import Instant as Instant
from .miss import (
    Misses as Misses,
    believed_misses as believed_misses,
    misses as misses,
    navigation_errors as navigation_errors,
)
from .over_index import IndexedEnd as IndexedEnd, fly_over as fly_over
from .scenario import Scenario as Scenario, Target as Target
from .scenario_checks import check as check
from .solver import Adaptive as Adaptive, FixedStep as FixedStep
from .termination import (
    AbstractEndCondition as AbstractEndCondition,
    AltitudeAbove as AltitudeAbove,
    AltitudeBelow as AltitudeBelow,
    Apoapsis as Apoapsis,
    CapturedAbove as CapturedAbove,
    Crossing as Crossing,
    EnergyBelow as EnergyBelow,
    EscapedAbove as EscapedAbove,
    Outcome as Outcome,
    Periapsis as Periapsis,
    RangeToGoBelow as RangeToGoBelow,
    TargetPassed as TargetPassed,
    Termination as Termination,
    VelocityAbove as VelocityAbove,
    VelocityBelow as VelocityBelow,
    has_end as has_end,
)
