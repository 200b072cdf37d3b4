"""Floor 4: guidance laws."""

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
)
