"""Floor 8: what campaigns say, sensitivities, loops linearized, what no law can beat."""

from .acceptance import (
    Decision as Decision,
    Requirement as Requirement,
    Verdict as Verdict,
    judged as judged,
)
from .clairvoyant import clairvoyant_floor as clairvoyant_floor
from .comparison import Comparison as Comparison, compared as compared
from .covariance import (
    LinearCovariance as LinearCovariance,
    linear_covariance as linear_covariance,
)
from .damping import Damping as Damping
from .frozen_loop import FrozenLoop as FrozenLoop, linearize as linearize
from .ranking import rank_correlations as rank_correlations, worst_runs as worst_runs
from .sensitivities import Sensitivity as Sensitivity, sensitivity as sensitivity
from .summary import Summary as Summary, summarize as summarize
from .zeros import transmission_zeros as transmission_zeros
