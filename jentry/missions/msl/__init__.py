"""Mars Science Laboratory: the first guided entry at Mars, in 2012."""

from .mission import MISSION as MISSION
