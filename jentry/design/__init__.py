"""Floor 7: planning of references, tuning of laws, sensitivity of flights."""

from .clairvoyant import clairvoyant_floor as clairvoyant_floor
from .judgement import Judgement as Judgement
from .linear_covariance import (
    LinearCovariance as LinearCovariance,
    linear_covariance as linear_covariance,
)
from .losses import (
    MeanSquare as MeanSquare,
    conditional_value_at_risk as conditional_value_at_risk,
    control_effort as control_effort,
    excess as excess,
    mean_square as mean_square,
    probability_outside as probability_outside,
    smooth_maximum as smooth_maximum,
)
from .network_samples import fly_samples as fly_samples
from .network_training import train_predictor as train_predictor
from .planning import (
    ReferenceFlight as ReferenceFlight,
    open_loop as open_loop,
    plan_bank_profile as plan_bank_profile,
    plan_drag_reference as plan_drag_reference,
)
from .sensitivity import Sensitivity as Sensitivity, sensitivity as sensitivity
from .surrogate import (
    smooth_reversals as smooth_reversals,
    smooth_switching as smooth_switching,
)
from .tuning import Tuned as Tuned, tune as tune
from .velocity_planning import (
    k2_polynomial as k2_polynomial,
    k2_polynomials as k2_polynomials,
    plan_parameters as plan_parameters,
    velocity_map as velocity_map,
)
