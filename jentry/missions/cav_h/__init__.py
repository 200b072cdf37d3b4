"""The CAV-H glider: scenario, dispersions, networks and their training."""

from .mission import MISSION as MISSION
