"""Floor 8: trains networks on simulated flights, and laws through them."""

from .imitation import imitated as imitated
from .law_seeds import (
    SeedsOfLaw as SeedsOfLaw,
    train_law_of_seeds as train_law_of_seeds,
)
from .law_training import LawTraining as LawTraining, train_law as train_law
from .neural_law import (
    TrainedLaw as TrainedLaw,
    robust_mean as robust_mean,
    tail_mean as tail_mean,
    train_neural_law as train_neural_law,
)
from .recorded_law import Recording as Recording, record_inputs as record_inputs
from .segment_value import Segments as Segments
from .training_record import Judged as Judged
from .velocity_network import train_predictor as train_predictor
from .velocity_samples import fly_samples as fly_samples
from .weight_steps import (
    AdamSteps as AdamSteps,
    GaussNewtonSteps as GaussNewtonSteps,
)
