"""RLV: angle-of-attack modulation by a disturbance observer, and by the Shuttle's law."""

from .mission import MISSION as MISSION
