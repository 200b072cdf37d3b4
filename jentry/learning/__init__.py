"""Floor 8: trains networks on simulated flights."""

from .velocity_network import train_predictor as train_predictor
from .velocity_samples import fly_samples as fly_samples
