"""The CAV-H glider: scenario, dispersions, networks and how they are trained."""

from .mission import MISSION as MISSION
