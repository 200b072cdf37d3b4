"""The CAV-H glider: scenario, dispersions, networks and how they are trained."""

from .scenario import MISSION as MISSION
