"""Floor 8: sensitivities, linearized loops, covariances and the clairvoyant floor."""

from .clairvoyant import clairvoyant_floor as clairvoyant_floor
from .covariance import (
    LinearCovariance as LinearCovariance,
    linear_covariance as linear_covariance,
)
from .damping import Damping as Damping
from .frozen_loop import FrozenLoop as FrozenLoop, linearize as linearize
from .sensitivities import Sensitivity as Sensitivity, sensitivity as sensitivity
from .zeros import transmission_zeros as transmission_zeros
