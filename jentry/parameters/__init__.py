"""Floor 7: numbers that a search moves: leaves, and what keeps them where they may be."""

from .maps import Bounds as Bounds, Scale as Scale
