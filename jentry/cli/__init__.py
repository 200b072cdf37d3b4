"""Floor 8: the command `jentry`."""

from .main import main as main
