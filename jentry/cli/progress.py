"""Progress of a campaign: a bar on a terminal, or lines in a file."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)


_SECONDS = 10.0
"""Least time between two lines in a file"""


class _Rate(ProgressColumn):
    """Runs per second since the start of this process."""

    def render(self, task: Task) -> str:
        speed = task.finished_speed or task.speed
        return "" if speed is None else f"{speed:.0f} runs/s"


@contextlib.contextmanager
def reported(runs: int, quiet: bool = False) -> Iterator[Callable[[int], None]]:
    """Context that shows progress: a bar on a terminal, a line every ten seconds in a file.

    It yields a function that takes the number of stored runs.
    """
    console = Console(stderr=True)
    if quiet:
        yield lambda stored: None
    elif console.is_terminal:
        yield from _bar(console, runs)
    else:
        yield _Lines(runs)


class _Lines:
    """Prints a line of progress, at most one every ten seconds."""

    def __init__(self, runs: int):
        self._runs = runs
        self._last = time.monotonic()
        self._begun: tuple[float, int] | None = None
        """Time of the first report, and its number of runs, which were stored earlier"""

    def __call__(self, stored: int) -> None:
        now = time.monotonic()
        if self._begun is None:
            self._begun = now, stored
        if now - self._last < _SECONDS:
            return
        self._last = now
        line = f"{stored} of {self._runs} runs"
        since, before = self._begun
        if now > since and stored > before:
            rate = (stored - before) / (now - since)
            left = (self._runs - stored) / rate
            line += f", {rate:.0f} runs/s, {left:.0f} s left"
        print(line, file=sys.stderr, flush=True)


def _bar(console: Console, runs: int) -> Iterator[Callable[[int], None]]:
    bar = Progress(
        TextColumn("runs"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
        console=console,
    )
    with bar:
        task = bar.add_task("runs", total=runs)

        def report(stored: int) -> None:
            bar.update(task, completed=stored)

        yield report
