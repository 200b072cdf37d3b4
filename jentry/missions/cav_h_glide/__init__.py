"""CAV-H as a glider to a point: the common case of predictor-corrector guidance."""

from .mission import MISSION as MISSION
