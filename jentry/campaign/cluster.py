"""A cluster of Dask, whose workers fly parts of campaigns and of gradients.

Workers need jentry with the same code and versions, but no common folder. One worker flies
each part, on as many cores as it has threads. The numbers are those of one machine to the
last bit.
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
"""Tasks per worker. It flies one of them, and need not wait for the next."""
_LOOK = 1.0
"""Interval between checks of the cluster while no task ends, s"""
_ANSWER = 10.0
"""Time within which a scheduler must answer, s"""


class Cluster:
    """Workers of Dask that fly instead of this process, within a `with` block.

        with Cluster("tcp://10.0.0.1:8786"):
            monte_carlo(scenario, dispersions, key, 100_000)

    The workers fly all batches of flights: of `monte_carlo`, of `run_campaign` and of the
    gradients of `tune`. If a worker is lost, others fly its parts again. The cluster needs
    `python -m pip install 'jentry[cluster]'`, on this machine and on those of the workers.

    **Arguments:**

    - `where`: address of a scheduler, "tcp://10.0.0.1:8786", or a scheduler file, a path
      that ends in .json, or "local:2" for two processes on this machine, which share its
      cores. (A script that uses a local cluster needs `if __name__ == "__main__":`, as
      every Python script that starts processes.)
    - `patience`: how long to wait (s) for a worker while there is none.

    **Raises:** `ValueError` for a local cluster with more processes than cores.
    `ClusterError` if there is no such cluster, it has no workers, the scheduler is lost, or
    a worker has other code or packages than this process.
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
                "a worker runs this script to import what it defines: put all other code "
                'of the script below if __name__ == "__main__":'
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
    """Context in which a logger is silent: `ClusterError` reports a lost scheduler."""
    log = logging.getLogger(logger)
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(before)


def _processes(where: str) -> int:
    """Number of processes of a local cluster, or 0 if the text has no number."""
    match = _LOCAL.fullmatch(where)
    return int(match[1]) if match else 0


def _local(workers: int) -> "distributed.LocalCluster":
    import distributed

    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=available_cores() // workers,
        processes=True,
        memory_limit=None,
        dashboard_address="127.0.0.1:0",  # None would mean the usual port
        scheduler_kwargs={"dashboard": False},
        silence_logs=logging.CRITICAL,
    )


@contextlib.contextmanager
def _no_interrupts() -> Iterator[None]:
    """Context in which new threads, and the processes that they start, ignore Ctrl-C.

    Otherwise each would print a traceback. The process that has started them ends them.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # its start would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Workers(AbstractMachines):
    """The workers of a scheduler, as the machines of the batch runner."""

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
        """Number of threads of each present worker."""
        if self._client.status != "running":  # else it waits for the scheduler
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
        """The next task that ends, with a value or an error."""
        while True:
            with contextlib.suppress(queue.Empty):
                return ended.get(timeout=_LOOK)
            self._look()

    def _look(self) -> None:
        """Raise an error if there has been no worker for too long."""
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
            except TimeoutError:  # the value is large, or was lost with its worker
                if future.status == "error":
                    raise
                self._look()
            except Exception as error:
                if future.status == "error":  # an error of the flights themselves
                    raise
                raise self._lost() from error
        self._say_if_other(flown)
        return loaded(flown.value)

    def _say_if_other(self, flown: Flown) -> None:
        """Warn of a worker whose processor may round differently."""
        if flown.processor not in self._processors:
            self._processors.add(flown.processor)
            warnings.warn(
                f"the worker {flown.worker} has another processor than this machine: its "
                "numbers may differ from those of one machine by rounding",
                stacklevel=4,
            )

    def _lost(self) -> ClusterError:
        return ClusterError(f"the scheduler at {self._where} is lost")
