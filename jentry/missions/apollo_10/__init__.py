"""Apollo 10: a capsule with little lift that returns from the Moon."""

from .mission import MISSION as MISSION
