"""X-33: drag that is planned in a corridor and tracked by Legendre collocation."""

from .mission import MISSION as MISSION
