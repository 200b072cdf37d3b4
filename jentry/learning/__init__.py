"""Floor 8: networks that learn from flights of the simulator."""

from .velocity_network import train_predictor as train_predictor
from .velocity_samples import fly_samples as fly_samples
