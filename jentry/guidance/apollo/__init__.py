"""The entry guidance of Apollo, with its range prediction and its phases."""

from .law import ApolloEntry as ApolloEntry, HeldPhase as HeldPhase
from .phases import (
    ConstantDrag as ConstantDrag,
    DecelerationLimit as DecelerationLimit,
    InitialRoll as InitialRoll,
    UpControl as UpControl,
)
from .skip import (
    SkipPlan as SkipPlan,
    SkipPrediction as SkipPrediction,
    SkipRange as SkipRange,
)
