"""Floor 3: profiles, references, what the vehicle measures and believes."""

from .estimation import (
    Estimate as Estimate,
    FactorEstimator as FactorEstimator,
    Factors as Factors,
)
from .model import OnboardModel as OnboardModel, WorldModel as WorldModel
from .navigation import (
    AbstractAccelerometers as AbstractAccelerometers,
    Accelerometers as Accelerometers,
    Measurement as Measurement,
    PerfectAccelerometers as PerfectAccelerometers,
    measure as measure,
)
from .network import (
    Network as Network,
    load_network as load_network,
    save_network as save_network,
)
from .profiles import (
    AbstractProfile as AbstractProfile,
    PolynomialProfile as PolynomialProfile,
    QuinticProfile as QuinticProfile,
    quintic_profile as quintic_profile,
)
from .propagation import (
    NO_END as NO_END,
    Prediction as Prediction,
    propagate as propagate,
    propagate_over as propagate_over,
)
from .reference import (
    AbstractIndex as AbstractIndex,
    DragReference as DragReference,
    EnergyIndex as EnergyIndex,
    TimeIndex as TimeIndex,
    VelocityIndex as VelocityIndex,
)
from .track import Track as Track, TrackPosition as TrackPosition
