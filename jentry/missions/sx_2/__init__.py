"""The SX-2 vehicle: its scenario, reference controls, cases and dispersions."""

from .mission import MISSION as MISSION
