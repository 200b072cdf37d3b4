"""How far a campaign is: a bar on a terminal, a line now and then in a file."""

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
"""Between two lines of a file"""


class _Rate(ProgressColumn):
    """Runs per second since the start of this process."""

    def render(self, task: Task) -> str:
        speed = task.finished_speed or task.speed
        return "" if speed is None else f"{speed:.0f} runs/s"


@contextlib.contextmanager
def reported(runs: int, quiet: bool = False) -> Iterator[Callable[[int], None]]:
    """A bar with rate and time left on a terminal; in a file a line every ten seconds.

    Gives the function to report the number of stored runs to.
    """
    console = Console(stderr=True)
    if quiet:
        yield lambda stored: None
    elif console.is_terminal:
        yield from _bar(console, runs)
    else:
        yield _Lines(runs)


class _Lines:
    """A line of progress, but none within ten seconds of the last."""

    def __init__(self, runs: int):
        self._runs = runs
        self._last = time.monotonic()
        self._begun: tuple[float, int] | None = None
        """When it was first told of runs, and of how many: those had been stored before"""

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
