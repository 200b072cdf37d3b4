"""Floor 10: the command `jentry`."""

from typing import NoReturn

from .ending import as_process, leaving_at_once


with leaving_at_once():
    from .entry import main as main


def process() -> NoReturn:
    """The process of the command."""
    as_process(main)
