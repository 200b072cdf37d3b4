"""Neptune aerocapture: an orbiter that the air brakes from a hyperbola to an ellipse."""

from .mission import MISSION as MISSION
