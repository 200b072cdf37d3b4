"""Floor 8: what a flight is sensitive to, how far it spreads, what no law can beat."""

from .clairvoyant import clairvoyant_floor as clairvoyant_floor
from .covariance import (
    LinearCovariance as LinearCovariance,
    linear_covariance as linear_covariance,
)
from .sensitivities import Sensitivity as Sensitivity, sensitivity as sensitivity
