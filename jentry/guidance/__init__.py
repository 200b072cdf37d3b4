"""Floor 4: guidance laws."""

from .aerocapture import (
    AerocaptureGuidance as AerocaptureGuidance,
    CaptureDecision as CaptureDecision,
)
from .aim import (
    Aim as Aim,
    OrbitOfScenario as OrbitOfScenario,
    TargetOfScenario as TargetOfScenario,
)
from .angle_of_attack import (
    AngleOfAttackProfile as AngleOfAttackProfile,
    TrimAngleOfAttack as TrimAngleOfAttack,
)
from .angle_of_attack_modulation import (
    AttitudeLag as AttitudeLag,
    DynamicalModulation as DynamicalModulation,
    ModulationGains as ModulationGains,
    ObserverStates as ObserverStates,
)
from .apollo import (
    ApolloEntry as ApolloEntry,
    ConstantDrag as ConstantDrag,
    DecelerationLimit as DecelerationLimit,
    HeldPhase as HeldPhase,
    InitialRoll as InitialRoll,
    SkipPlan as SkipPlan,
    SkipPrediction as SkipPrediction,
    SkipRange as SkipRange,
    UpControl as UpControl,
)
from .bank_shapes import (
    AbstractBankShape as AbstractBankShape,
    ConstantBankShape as ConstantBankShape,
    LinearBankShape as LinearBankShape,
    PrescribedBankShape as PrescribedBankShape,
    TwoEndedBankShape as TwoEndedBankShape,
)
from .bezier import (
    AbstractAnchoring as AbstractAnchoring,
    AbstractVelocityControl as AbstractVelocityControl,
    AbstractVelocityPredictor as AbstractVelocityPredictor,
    Arrival as Arrival,
    BezierGuidance as BezierGuidance,
    BezierParameters as BezierParameters,
    BezierPath as BezierPath,
    Epochs as Epochs,
    FlightLimits as FlightLimits,
    FlownModel as FlownModel,
    InnerPoints as InnerPoints,
    NetworkPredictor as NetworkPredictor,
    NewtonAdjustment as NewtonAdjustment,
    NoVelocityControl as NoVelocityControl,
    PathPoint as PathPoint,
    PolynomialAdjustment as PolynomialAdjustment,
    StoredParameters as StoredParameters,
    Subdivision as Subdivision,
    bezier_parameters as bezier_parameters,
    inner_points as inner_points,
    tangents_meet as tangents_meet,
)
from .composition import BankLimits as BankLimits, compose as compose
from .cycle import (
    AbstractCycle as AbstractCycle,
    AbstractTimedDecision as AbstractTimedDecision,
    FixedCycle as FixedCycle,
    ShorteningCycle as ShorteningCycle,
)
from .drag_tracking import (
    ErrorGains as ErrorGains,
    ObserverDragTracking as ObserverDragTracking,
    ObserverGains as ObserverGains,
    StateFeedbackDragTracking as StateFeedbackDragTracking,
)
from .feedback_linearization import (
    AbstractForceKnowledge as AbstractForceKnowledge,
    AbstractLinearization as AbstractLinearization,
    AbstractTrackAngles as AbstractTrackAngles,
    AttitudeBand as AttitudeBand,
    EarthFixedAngles as EarthFixedAngles,
    FullLinearization as FullLinearization,
    GroundTrackModel as GroundTrackModel,
    GroundTrackTracking as GroundTrackTracking,
    MeasuredForces as MeasuredForces,
    ModelledForces as ModelledForces,
    OutputDynamics as OutputDynamics,
    ReferencePlaneAngles as ReferencePlaneAngles,
    SmallAngleLinearization as SmallAngleLinearization,
    TrackErrors as TrackErrors,
)
from .gated import Gated as Gated
from .glide_damping import GlideDamping as GlideDamping
from .guided_end import GuidedEnd as GuidedEnd
from .inclination import (
    InclinationCorridor as InclinationCorridor,
    OrbitPlane as OrbitPlane,
)
from .lateral import (
    AbstractLateralLogic as AbstractLateralLogic,
    CrossrangeCorridor as CrossrangeCorridor,
    Destination as Destination,
    FixedSide as FixedSide,
    HeadingCorridor as HeadingCorridor,
    PredictedCrossrange as PredictedCrossrange,
    VelocityReversals as VelocityReversals,
)
from .law import (
    AbstractBankLaw as AbstractBankLaw,
    AbstractContinuousLaw as AbstractContinuousLaw,
    AbstractLaw as AbstractLaw,
    AbstractSampledLaw as AbstractSampledLaw,
    AngleOfAttackCommand as AngleOfAttackCommand,
    Sampled as Sampled,
    Tracked as Tracked,
)
from .lift_tradeoff import (
    AbstractTradeoff as AbstractTradeoff,
    EqualTradeoff as EqualTradeoff,
    Lift as Lift,
    LiftBounds as LiftBounds,
    WeightedTradeoff as WeightedTradeoff,
)
from .neural_law import (
    AngleOfAttackLimits as AngleOfAttackLimits,
    NeuralDecision as NeuralDecision,
    NeuralLaw as NeuralLaw,
)
from .open_loop import BankProfile as BankProfile, ControlProfiles as ControlProfiles
from .path_limits import BankBounds as BankBounds, PathLimits as PathLimits
from .predictor_corrector import (
    Corrected as Corrected,
    PredictorCorrector as PredictorCorrector,
)
from .pseudospectral_tracking import (
    ControlPlan as ControlPlan,
    DeviationWeights as DeviationWeights,
    GainSchedule as GainSchedule,
    PseudospectralTracking as PseudospectralTracking,
    Regulator as Regulator,
    StoredGainTracking as StoredGainTracking,
    plan_gains as plan_gains,
)
from .range_tracking import (
    RangeTracking as RangeTracking,
    ScaleLimits as ScaleLimits,
)
from .replanning import (
    AdjustedProfile as AdjustedProfile,
    Adjustment as Adjustment,
    OnboardReference as OnboardReference,
    Replanned as Replanned,
    ReplannedTracking as ReplannedTracking,
)
from .shuttle import (
    BankGains as BankGains,
    Gate as Gate,
    ShuttleBank as ShuttleBank,
    ShuttleModulation as ShuttleModulation,
)
from .switching import (
    AbstractSwitching as AbstractSwitching,
    Sharp as Sharp,
    Smooth as Smooth,
    SmoothReversals as SmoothReversals,
)
from .terminal_point import (
    EarlyEnd as EarlyEnd,
    HeadingAlignment as HeadingAlignment,
    HeldBank as HeldBank,
    TerminalPoint as TerminalPoint,
)
from .tracking_gains import (
    AbstractTrackingGains as AbstractTrackingGains,
    ScheduledEigenvalues as ScheduledEigenvalues,
    TrackingGains as TrackingGains,
)
