"""Space Shuttle: the largest cross-range of a re-entry, with and without heating limit."""

from .mission import MISSION as MISSION
