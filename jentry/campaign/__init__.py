"""Floor 6: dispersions, Monte Carlo, storage."""

from .campaign import Campaign as Campaign, monte_carlo as monte_carlo
from .dispersions import (
    AbstractDistribution as AbstractDistribution,
    Constant as Constant,
    Dispersion as Dispersion,
    Normal as Normal,
    OneOfSeveral as OneOfSeveral,
    TruncatedNormal as TruncatedNormal,
    Uniform as Uniform,
    add as add,
    disperse as disperse,
    draw as draw,
    multiply as multiply,
    replace as replace,
)
from .errors import CampaignError as CampaignError
from .merging import merge_campaigns as merge_campaigns
from .results import dataset as dataset
from .store import open_campaign as open_campaign, run_campaign as run_campaign
