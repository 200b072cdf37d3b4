"""X-33: drag planned in a corridor, and tracking by Legendre collocation."""

from .mission import MISSION as MISSION
