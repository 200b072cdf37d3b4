"""Floor 10: the command `jentry`."""

from typing import NoReturn

from .ending import as_process, leaving_at_once


with leaving_at_once():
    from .entry import main as main


def process() -> NoReturn:
    """Run the command as a process of its own."""
    as_process(main)
