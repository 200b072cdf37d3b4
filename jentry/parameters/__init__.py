"""Floor 7: the parameters of a search, which are leaves, and maps that bound them."""

from .maps import Bounds as Bounds, Scale as Scale
