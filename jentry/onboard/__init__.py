"""Floor 3: profiles, references, measurements and onboard models."""

from .estimation import (
    AbstractFactorEstimate as AbstractFactorEstimate,
    AbstractFactorEstimator as AbstractFactorEstimator,
    AbstractFactors as AbstractFactors,
    FactorEstimate as FactorEstimate,
    FactorEstimator as FactorEstimator,
    Factors as Factors,
)
from .flow import (
    BankedMotion as BankedMotion,
    SensedPoint as SensedPoint,
    sensed_flow as sensed_flow,
    twice_along as twice_along,
)
from .flow_sensing import AirVelocity as AirVelocity, FlowSensors as FlowSensors
from .inertial import (
    Actual as Actual,
    BodyAxes as BodyAxes,
    Gyroscopes as Gyroscopes,
    KnowledgeError as KnowledgeError,
    Navigated as Navigated,
    Sensed as Sensed,
    TrackError as TrackError,
)
from .longitudinal import (
    LongitudinalModel as LongitudinalModel,
    LongitudinalReference as LongitudinalReference,
    LongitudinalState as LongitudinalState,
)
from .measurement import (
    AbstractAccelerometers as AbstractAccelerometers,
    Accelerometers as Accelerometers,
    BodyAccelerometers as BodyAccelerometers,
    Measurement as Measurement,
    PerfectAccelerometers as PerfectAccelerometers,
    SpecificForce as SpecificForce,
    measure as measure,
)
from .model import OnboardModel as OnboardModel
from .navigation import (
    AbstractNavigation as AbstractNavigation,
    InertialNavigation as InertialNavigation,
    InertialNoise as InertialNoise,
    PerfectNavigation as PerfectNavigation,
)
from .navigation_filter import (
    Aiding as Aiding,
    Knowledge as Knowledge,
    NavigationFilter as NavigationFilter,
)
from .navigation_sensors import (
    AbstractNavigationSensor as AbstractNavigationSensor,
    Altimeter as Altimeter,
    Believed as Believed,
    DopplerVelocity as DopplerVelocity,
    DragAltitude as DragAltitude,
    FlowVelocity as FlowVelocity,
    TerrainPosition as TerrainPosition,
)
from .network import (
    Network as Network,
    load_network as load_network,
    save_network as save_network,
)
from .profile_estimation import (
    FactorPrior as FactorPrior,
    FactorProfile as FactorProfile,
    ProfileEstimate as ProfileEstimate,
    ProfileEstimator as ProfileEstimator,
)
from .profiles import (
    AbstractProfile as AbstractProfile,
    JoinedProfile as JoinedProfile,
    PolynomialProfile as PolynomialProfile,
    QuinticProfile as QuinticProfile,
    QuinticTable as QuinticTable,
    grid as grid,
    quintic_profile as quintic_profile,
    quintic_table as quintic_table,
)
from .propagation import (
    NO_END as NO_END,
    Prediction as Prediction,
    SampledCommand as SampledCommand,
    propagate as propagate,
    propagate_over as propagate_over,
)
from .recurrent_network import (
    RecurrentNetwork as RecurrentNetwork,
    load_recurrent_network as load_recurrent_network,
    save_recurrent_network as save_recurrent_network,
)
from .reference import (
    DragReference as DragReference,
    Reference as Reference,
    along as along,
    index_motion as index_motion,
)
from .scheduled_aerodynamics import ScheduledAerodynamics as ScheduledAerodynamics
from .spline import (
    BSpline as BSpline,
    CubicSpline as CubicSpline,
    cubic_spline as cubic_spline,
)
from .track import Track as Track, TrackPosition as TrackPosition
from .turning import BankTurning as BankTurning
from .velocity_domain import (
    Deviations as Deviations,
    GlidePoint as GlidePoint,
    VelocityDomain as VelocityDomain,
)
from .wind_estimation import (
    EstimatedWind as EstimatedWind,
    WindEstimate as WindEstimate,
    WindEstimator as WindEstimator,
    WindPrior as WindPrior,
)
