"""Floor 10: the command `jentry`."""

from .ending import leaving_at_once


with leaving_at_once():
    from .entry import main as main
