"""Guidance along a Bézier curve by inverse dynamics: the law and its components."""

from .allocation import FlightLimits as FlightLimits
from .anchoring import (
    AbstractAnchoring as AbstractAnchoring,
    StoredParameters as StoredParameters,
    Subdivision as Subdivision,
)
from .curve import (
    BezierParameters as BezierParameters,
    BezierPath as BezierPath,
    InnerPoints as InnerPoints,
    PathPoint as PathPoint,
    bezier_parameters as bezier_parameters,
    inner_points as inner_points,
    tangents_meet as tangents_meet,
)
from .law import Arrival as Arrival, BezierGuidance as BezierGuidance
from .prediction import (
    AbstractVelocityPredictor as AbstractVelocityPredictor,
    FlownModel as FlownModel,
    NetworkPredictor as NetworkPredictor,
)
from .velocity_control import (
    AbstractVelocityControl as AbstractVelocityControl,
    Epochs as Epochs,
    NewtonAdjustment as NewtonAdjustment,
    NoVelocityControl as NoVelocityControl,
    PolynomialAdjustment as PolynomialAdjustment,
)
