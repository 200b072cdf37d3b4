"""A scheduler of Dask and its workers, each a process of its own, for tests."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import distributed


ROOT = Path(__file__).parents[1]
_LIMIT = 120.0
"""s, after which what is waited for does not come"""


def wait_for(condition: Callable[[], object], what: str, pause: float = 0.02) -> None:
    limit = time.monotonic() + _LIMIT
    while not condition():
        assert time.monotonic() < limit, f"{what} does not come"
        time.sleep(pause)


class DaskCluster:
    """Started within `with`, and killed at its end with all that it has started.

    What is beside folder and cache is more of the environment of its scheduler.
    """

    def __init__(self, folder: Path, cache: Path, **environment: str):
        self.file = folder / "scheduler.json"
        self._folder = folder
        self._of_scheduler = environment
        # The same jentry as here; what the tests have of their own goes along.
        ours = {"JENTRY_CACHE": str(cache), "PYTHONPATH": str(ROOT)}
        self._environment = {**os.environ, **ours}
        self._processes: list[subprocess.Popen] = []

    def __enter__(self):
        words = "--host", "127.0.0.1", "--port", "0", "--scheduler-file", self.file
        words += "--no-dashboard", "--dashboard-address", "127.0.0.1:0"
        with contextlib.ExitStack() as ending:
            ending.callback(self._end)
            self.scheduler = self._started("scheduler", *words, **self._of_scheduler)
            wait_for(self._is_told, "the scheduler")
            self.address = json.loads(self.file.read_text())["address"]
            self._ending = ending.pop_all()
        return self

    def __exit__(self, *reason):
        self._ending.close()

    def _is_told(self) -> bool:
        """Whether the whole of its file is there."""
        return self.file.exists() and self.file.read_text().endswith("}")

    def _end(self) -> None:
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()

    def worker(self, threads: int = 1, **environment: str) -> subprocess.Popen:
        """One more, that is there when this returns."""
        words = self.address, "--nthreads", threads, "--no-nanny", "--no-dashboard"
        with self._client() as client:  # which takes much longer than to ask it
            before = len(client.nthreads())
            process = self._started("worker", *words, **environment)
            there = lambda: len(client.nthreads()) > before
            wait_for(there, "the worker", pause=0.1)  # to ask takes a while as well
        return process

    def workers(self) -> int:
        """How many there are."""
        with self._client() as client:
            return len(client.nthreads())

    def kill_workers(self) -> None:
        """Kill all workers, and wait until the scheduler knows."""
        for process in self._processes[1:]:
            kill(process)
        with self._client() as client:
            wait_for(lambda: not client.nthreads(), "the loss of the workers")

    def _client(self) -> distributed.Client:
        return distributed.Client(self.address, set_as_default=False)

    def _started(self, what: str, *words, **environment: str) -> subprocess.Popen:
        log = self._folder / f"{len(self._processes)}-{what}.txt"
        with log.open("w") as output:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", what, *map(str, words)],
                stdout=output,
                stderr=output,
                cwd=self._folder,
                env={**self._environment, **environment},
            )
        self._processes.append(process)
        return process


def kill(process: subprocess.Popen) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()


def that_kills(shared, run):
    """A flight that kills its worker, which need not import the tests for it."""
    os.kill(os.getpid(), signal.SIGKILL)
