"""Space Shuttle: the largest crossrange of a re-entry, with and without heating limit."""

from .mission import MISSION as MISSION
