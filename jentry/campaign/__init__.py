"""Floor 6: dispersions, Monte Carlo campaigns and their storage."""

from .campaign import Campaign as Campaign, monte_carlo as monte_carlo
from .cluster import Cluster as Cluster
from .correlations import correlated_normals as correlated_normals
from .dispersions import (
    Dispersion as Dispersion,
    add as add,
    disperse as disperse,
    draw as draw,
    multiply as multiply,
    replace as replace,
)
from .distributions import (
    AbstractDistribution as AbstractDistribution,
    Constant as Constant,
    CorrelatedNormal as CorrelatedNormal,
    Discrete as Discrete,
    LogNormal as LogNormal,
    Normal as Normal,
    OneOfSeveral as OneOfSeveral,
    TruncatedNormal as TruncatedNormal,
    Uniform as Uniform,
)
from .errors import CampaignError as CampaignError, ClusterError as ClusterError
from .merging import merge_campaigns as merge_campaigns
from .results import dataset as dataset
from .samplers import (
    AbstractSampler as AbstractSampler,
    LatinHypercube as LatinHypercube,
    Sobol as Sobol,
)
from .store import open_campaign as open_campaign, run_campaign as run_campaign
from .trajectory_files import (
    write_trajectories as write_trajectories,
    write_trajectory as write_trajectory,
)
