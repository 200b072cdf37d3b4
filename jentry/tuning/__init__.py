"""Floor 8: tunes numbers of a scenario with gradients of its Monte Carlo flights."""

from ..parameters import Bounds as Bounds, Scale as Scale
from .course import Budget as Budget
from .draws import Draws as Draws
from .gradients import (
    AutomaticDifferentiation as AutomaticDifferentiation,
    CentralDifferences as CentralDifferences,
)
from .judgement import Judgement as Judgement
from .losses import (
    MeanSquare as MeanSquare,
    bank_turns as bank_turns,
    conditional_value_at_risk as conditional_value_at_risk,
    control_effort as control_effort,
    excess as excess,
    mean_square as mean_square,
    power_mean as power_mean,
    probability_outside as probability_outside,
    smooth_maximum as smooth_maximum,
)
from .penalties import DampingBelow as DampingBelow
from .record import Record as Record
from .smoothing import (
    smooth_reversals as smooth_reversals,
    smooth_switching as smooth_switching,
)
from .tuning import Tuned as Tuned, tune as tune
