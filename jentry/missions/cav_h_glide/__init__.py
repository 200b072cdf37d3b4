"""CAV-H as a glider to a point: the common application of predictor-corrector guidance."""

from .mission import MISSION as MISSION
