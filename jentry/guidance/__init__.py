"""Floor 4: guidance laws."""

from .anchoring import (
    AbstractAnchoring as AbstractAnchoring,
    StoredParameters as StoredParameters,
    Subdivision as Subdivision,
)
from .attitude import FlightLimits as FlightLimits
from .bezier import (
    Arrival as Arrival,
    BezierGuidance as BezierGuidance,
)
from .cycle import (
    AbstractCycle as AbstractCycle,
    AbstractTimedDecision as AbstractTimedDecision,
    FixedCycle as FixedCycle,
    ShorteningCycle as ShorteningCycle,
)
from .drag_tracking import (
    ErrorGains as ErrorGains,
    ObserverDragTracking as ObserverDragTracking,
    ObserverGains as ObserverGains,
    StateFeedbackDragTracking as StateFeedbackDragTracking,
)
from .lateral import LateralCorridor as LateralCorridor
from .law import (
    AbstractContinuousLaw as AbstractContinuousLaw,
    AbstractLaw as AbstractLaw,
    AbstractSampledLaw as AbstractSampledLaw,
    Sampled as Sampled,
)
from .open_loop import BankProfile as BankProfile
from .range_tracking import (
    Aim as Aim,
    RangeTracking as RangeTracking,
    ScaleLimits as ScaleLimits,
)
from .switching import (
    AbstractSwitching as AbstractSwitching,
    Sharp as Sharp,
    Smooth as Smooth,
    SmoothReversals as SmoothReversals,
)
from .velocity_control import (
    AbstractVelocityControl as AbstractVelocityControl,
    Epochs as Epochs,
    NewtonAdjustment as NewtonAdjustment,
    NoVelocityControl as NoVelocityControl,
    PolynomialAdjustment as PolynomialAdjustment,
)
from .velocity_prediction import (
    AbstractVelocityPredictor as AbstractVelocityPredictor,
    FlownModel as FlownModel,
    NetworkPredictor as NetworkPredictor,
)
