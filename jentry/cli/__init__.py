"""Floor 8: the command `jentry`."""

from .ending import leaving_at_once


with leaving_at_once():
    from .main import main as main
