"""What `jentry` offers at its top, all of it imported."""

from ._setup import setup as setup
from ._warnings import ResultWarning as ResultWarning
from .analysis import linear_covariance as linear_covariance, sensitivity as sensitivity
from .campaign import (
    Campaign as Campaign,
    CampaignError as CampaignError,
    Dispersion as Dispersion,
    Normal as Normal,
    TruncatedNormal as TruncatedNormal,
    Uniform as Uniform,
    monte_carlo as monte_carlo,
    open_campaign as open_campaign,
    run_campaign as run_campaign,
)
from .flight import (
    Adaptive as Adaptive,
    FixedStep as FixedStep,
    Flight as Flight,
    Outcome as Outcome,
    Scenario as Scenario,
    Target as Target,
    Termination as Termination,
    fly as fly,
    misses as misses,
)
from .missions import find_mission as find_mission
from .tuning import tune as tune
