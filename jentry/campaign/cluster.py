"""A cluster of Dask: parts of campaigns and of gradients, as tasks of its workers.

Workers need jentry, of the same code and versions, and no common folder. Each part is
flown by a whole worker, on as many cores as it has threads, with the numbers of one
machine to the last bit.
"""

import contextlib
import itertools
import json
import logging
import os
import pickle
import queue
import re
import signal
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxtyping import PyTree

from .._setup import available_cores
from .batch import AbstractMachines, flying_on
from .carried import loaded
from .errors import ClusterError
from .worker import Flown, Structures, am_worker, kind_of_processor, task, terms


if TYPE_CHECKING:
    import distributed


_LOCAL = re.compile(r"local:(\d+)")
_AHEAD = 2
"""Tasks for each worker, of which it flies one: it need not wait for the next"""
_LOOK = 1.0
"""s, between two looks at the cluster while nothing is done"""
_ANSWER = 10.0
"""s, within which a scheduler answers"""


class Cluster:
    """Workers of Dask that fly in place of this process, between `with` and its end.

        with Cluster("tcp://10.0.0.1:8786"):
            monte_carlo(scenario, dispersions, key, 100_000)

    Every batch of flights goes there: `monte_carlo`, `run_campaign`, the gradients of
    `tune`. A worker that is lost costs the parts that it had, which others fly again. Needs
    `python -m pip install 'jentry[cluster]'`, here and there.

    **Arguments:**

    - `where`: address of a scheduler, "tcp://10.0.0.1:8786"; a scheduler file, a path that
      ends in .json; or "local:2" for two processes on this machine, which share its cores.
      (A script of your own then begins with `if __name__ == "__main__":`, as all that
      start processes in Python.)
    - `patience`: how long to wait (s) for a worker while there is none.

    **Raises:** `ValueError` for a local one with more processes than cores; `ClusterError`
    where there is no such cluster or it has no workers, where the scheduler is lost, and
    where a worker has other code or packages than this process.
    """

    def __init__(self, where: str, patience: float = 60.0):
        if (
            where.startswith("local")
            and not 1 <= _processes(where) <= available_cores()
        ):
            raise ValueError(
                f"the cluster is {where!r}: one on this machine is local:1 to "
                f"local:{available_cores()}, for so many processes on its cores"
            )
        self.where = where
        self.patience = patience
        self._ending = contextlib.ExitStack()

    def __enter__(self) -> "Cluster":
        if am_worker():
            raise ClusterError(
                "a worker runs the script of who asks, for what that defines: let all "
                'else in the script be below if __name__ == "__main__":'
            )
        with contextlib.ExitStack() as ending:
            client = ending.enter_context(_connected(self.where))
            machines = _Workers(client, self.where, self.patience)
            ending.enter_context(flying_on(machines))
            self._ending = ending.pop_all()
        return self

    def __exit__(self, *reason: Any) -> None:
        self._ending.__exit__(*reason)


@contextlib.contextmanager
def _connected(where: str) -> Iterator["distributed.Client"]:
    try:
        import distributed
    except ImportError as error:
        raise ClusterError(
            "a cluster needs Dask: python -m pip install 'jentry[cluster]'"
        ) from error
    with contextlib.ExitStack() as ending:
        ending.enter_context(_without_a_word("distributed"))
        if where.startswith("local"):
            with _no_interrupts():
                address = ending.enter_context(_local(_processes(where)))
        elif where.endswith(".json"):
            address = _address_in(Path(where))
        else:
            address = where
        try:
            client = distributed.Client(
                address, timeout=_ANSWER, set_as_default=False, name="jentry"
            )
        except (OSError, ValueError, TypeError) as error:
            raise ClusterError(f"there is no scheduler at {where}: {error}") from error
        yield ending.enter_context(client)


def _address_in(file: Path) -> str:
    try:
        return str(json.loads(file.read_text())["address"])
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise ClusterError(
            f"{file} is no scheduler file, as dask scheduler --scheduler-file writes it: "
            f"{error}"
        ) from error


@contextlib.contextmanager
def _without_a_word(logger: str) -> Iterator[None]:
    """What it has to say of a scheduler that is lost, `ClusterError` says in one line."""
    log = logging.getLogger(logger)
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(before)


def _processes(where: str) -> int:
    """How many a local cluster has; 0 where that is no number."""
    match = _LOCAL.fullmatch(where)
    return int(match[1]) if match else 0


def _local(workers: int) -> "distributed.LocalCluster":
    import distributed

    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=available_cores() // workers,
        processes=True,
        memory_limit=None,
        dashboard_address="127.0.0.1:0",  # with none it would take the usual port
        scheduler_kwargs={"dashboard": False},
        silence_logs=logging.CRITICAL,
    )


@contextlib.contextmanager
def _no_interrupts() -> Iterator[None]:
    """Threads that begin within it, and their processes, do not hear of Ctrl-C: of that
    each would print a traceback, while it is the one who has begun them who ends them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # whose beginning would lift it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Workers(AbstractMachines):
    """The workers of a scheduler, as those who fly."""

    def __init__(self, client: "distributed.Client", where: str, patience: float):
        self._client = client
        self._where = where
        self._patience = patience
        self._structures = Structures()
        self._processors = {kind_of_processor()}
        self._alone_since: float | None = None
        try:
            client.wait_for_workers(1, timeout=patience)
        except TimeoutError:
            raise ClusterError(
                f"the scheduler at {where} has no workers after {patience:g} s: start "
                "some, by dask worker with its address"
            ) from None

    @property
    def count(self) -> int:
        return max(1, len(self._threads()))

    @property
    def cores(self) -> int:
        return max(self._threads(), default=1)

    def _threads(self) -> list[int]:
        """Of each worker that is there now."""
        if self._client.status != "running":  # it would wait for the scheduler
            raise self._lost()
        try:
            threads: Any = self._client.nthreads()
            return list(threads.values())
        except OSError as error:
            raise self._lost() from error

    def each(
        self, work: Callable[[Any, Any], Any], shared: PyTree, parts: Iterable[PyTree]
    ) -> Iterator[tuple[int, Any]]:
        known, packed = terms(), self._structures.packed((work, shared))
        coming = enumerate(parts)
        flying: dict[distributed.Future, int] = {}
        ended: queue.SimpleQueue[distributed.Future] = queue.SimpleQueue()
        try:
            while True:
                room = max(0, _AHEAD * self.count - len(flying))
                for place, part in itertools.islice(coming, room):
                    future = self._client.submit(
                        pickle.loads,
                        task(known, packed, part),
                        key=f"jentry-{place}-{os.urandom(8).hex()}",
                        pure=False,
                    )
                    flying[future] = place
                    future.add_done_callback(ended.put)
                if not flying:
                    return
                future = self._next(ended)
                yield flying.pop(future), self._value(future)
        finally:
            if self._client.status == "running":
                self._client.cancel(list(flying), force=True)

    def _next(
        self, ended: "queue.SimpleQueue[distributed.Future]"
    ) -> "distributed.Future":
        """The next task that ends, in whatever way."""
        while True:
            with contextlib.suppress(queue.Empty):
                return ended.get(timeout=_LOOK)
            self._look()

    def _look(self) -> None:
        """Give up where there has been no worker for long."""
        now = time.monotonic()
        if self._threads():
            self._alone_since = None
            return
        self._alone_since = self._alone_since or now
        if now - self._alone_since > self._patience:
            raise ClusterError(
                f"the scheduler at {self._where} has lost all of its workers, and there "
                f"was none for {self._patience:g} s"
            )

    def _value(self, future: "distributed.Future") -> Any:
        from distributed import KilledWorker

        while True:
            try:
                flown: Flown = future.result(timeout=self._patience)
                break
            except KilledWorker as error:
                raise ClusterError(
                    f"{error.allowed_failures + 1} workers of {self._where} were lost "
                    "with the same part, as when it is too much for their memory: see "
                    "their logs"
                ) from None
            except ModuleNotFoundError as error:
                raise ClusterError(
                    f"a worker of {self._where} has no {error.name}: install there what "
                    "is installed here"
                ) from error
            except TimeoutError:  # its worker was lost with the value, or that is large
                if future.status == "error":
                    raise
                self._look()
            except Exception as error:
                if future.status == "error":  # of the flights themselves
                    raise
                raise self._lost() from error
        self._say_if_other(flown)
        return loaded(flown.value)

    def _say_if_other(self, flown: Flown) -> None:
        """Warn of a worker whose processor may round otherwise."""
        if flown.processor not in self._processors:
            self._processors.add(flown.processor)
            warnings.warn(
                f"the worker {flown.worker} has another processor than this machine: its "
                "numbers may differ from those of one machine by rounding",
                stacklevel=4,
            )

    def _lost(self) -> ClusterError:
        return ClusterError(f"the scheduler at {self._where} is lost")
