"""A cluster of Dask: parts of campaigns and of gradients, as tasks of its workers.

What is flown goes to the workers and comes back as it is: they need jentry, of the same
code and versions, and no common folder. Each part is flown by a whole worker, on as many
cores as it has threads, with the numbers of one machine to the last bit.
"""

import contextlib
import functools
import hashlib
import importlib.metadata
import itertools
import logging
import os
import platform
import queue
import re
import sys
import threading
import time
import warnings
from collections.abc import Callable, Hashable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from .._provenance import code_of_jentry, settings_of_jax
from .._setup import available_cores, fast_options_are_on, processor, setup
from .._warnings import ResultWarning
from .batch import AbstractMachines, flying_on
from .description import first_difference
from .errors import ClusterError


if TYPE_CHECKING:
    import distributed


_LOCAL = re.compile(r"local:(\d+)")
_AHEAD = 2
"""Tasks for each worker, of which it flies one: it need not wait for the next"""
_LOOK = 1.0
"""s, between two looks at the cluster while nothing is done"""
_WORKERS_OWN = "jax_num_cpu_devices", "jax_platforms", "jax_platform_name"
"""Settings of JAX that change no number, and are of each process by itself"""
_VERSIONS = "jax", "jaxlib", "numpy", "equinox", "diffrax", "optimistix", "lineax", "scipy"


class Cluster:
    """Workers of Dask that fly in place of this process, between `with` and its end.

        with Cluster("tcp://10.0.0.1:8786"):
            monte_carlo(scenario, dispersions, key, 100_000)

    Every batch of flights goes there: `monte_carlo`, `run_campaign`, the gradients of
    `tune`. A worker that is lost costs the part that it was flying, which another one
    flies again. Needs `python -m pip install 'jentry[cluster]'`, here and there.

    **Arguments:**

    - `where`: address of a scheduler, "tcp://10.0.0.1:8786"; a scheduler file, a path that
      ends in .json; or "local:2" for two processes on this machine, which share its cores.
      (A script of your own then begins with `if __name__ == "__main__":`, as all that
      start processes in Python.)
    - `patience`: how long to wait (s) for a worker while there is none.

    **Raises:** `ClusterError` where there is no such cluster or it has no workers, where
    the scheduler is lost, and where a worker has another code than this process.
    """

    def __init__(self, where: str, patience: float = 60.0):
        self.where = where
        self.patience = patience
        self._ending = contextlib.ExitStack()

    def __enter__(self) -> "Cluster":
        with contextlib.ExitStack() as ending:
            client = ending.enter_context(_connected(self.where, self.patience))
            machines = _Workers(client, self.where, self.patience)
            ending.enter_context(flying_on(machines))
            self._ending = ending.pop_all()
        return self

    def __exit__(self, *reason: Any) -> None:
        self._ending.__exit__(*reason)


@contextlib.contextmanager
def _connected(where: str, patience: float) -> Iterator["distributed.Client"]:
    try:
        import distributed
    except ImportError as error:
        raise ClusterError(
            "a cluster needs Dask: python -m pip install 'jentry[cluster]'"
        ) from error
    with contextlib.ExitStack() as ending:
        local = _LOCAL.fullmatch(where)
        if local is None and where.startswith("local"):
            raise ClusterError(
                f"the cluster is {where!r}: a local one is local:2 for two processes"
            )
        ending.enter_context(_without_a_word("distributed.client"))
        given: dict[str, Any]
        if local is not None:
            given = {"address": ending.enter_context(_local(int(local[1])))}
        elif where.endswith(".json"):
            if not Path(where).is_file():
                raise ClusterError(f"there is no scheduler file {where}")
            given = {"scheduler_file": where}
        else:
            given = {"address": where}
        try:
            client = distributed.Client(
                **given, timeout=patience, set_as_default=False, name="jentry"
            )
        except (OSError, ValueError, TypeError) as error:
            raise ClusterError(f"there is no scheduler at {where}: {error}") from error
        yield ending.enter_context(client)


@contextlib.contextmanager
def _without_a_word(logger: str) -> Iterator[None]:
    """What it has to say of a scheduler that is lost, `ClusterError` says in one line."""
    log = logging.getLogger(logger)
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)


def _local(workers: int) -> "distributed.LocalCluster":
    import distributed

    if not 1 <= workers <= available_cores():
        raise ClusterError(
            f"the cluster is local:{workers}: this machine has {available_cores()} cores"
        )
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=available_cores() // workers,
        processes=True,
        memory_limit=None,
        dashboard_address=None,
        silence_logs=logging.CRITICAL,
    )


class _Workers(AbstractMachines):
    """The workers of a scheduler, as those who fly."""

    def __init__(self, client: "distributed.Client", where: str, patience: float):
        self._client = client
        self._where = where
        self._patience = patience
        self._packed: dict[Hashable, tuple[str, bytes]] = {}
        self._processors: set[str] = {processor()}
        try:
            client.wait_for_workers(1, timeout=patience)
        except TimeoutError:
            raise ClusterError(
                f"the scheduler at {where} has no workers after {patience:g} s: start "
                f"some, dask worker {where}"
            ) from None

    @property
    def count(self) -> int:
        return max(1, len(self._threads()))

    @property
    def cores(self) -> int:
        return max(self._threads(), default=1)

    def _threads(self) -> list[int]:
        if self._client.status != "running":  # it would wait for the scheduler
            raise self._lost()
        known = self._client.scheduler_info().get("workers", {})
        return [worker["nthreads"] for worker in known.values()]

    def each(
        self, work: Callable[[Any, Any], Any], shared: PyTree, parts: Iterable[PyTree]
    ) -> Iterator[tuple[int, Any]]:
        digest, structure, numbers = self._pack((work, shared))
        known = terms()
        coming = enumerate(parts)
        flying: dict[distributed.Future, int] = {}
        ended: queue.SimpleQueue[distributed.Future] = queue.SimpleQueue()
        try:
            while True:
                room = max(0, _AHEAD * self.count - len(flying))
                for place, part in itertools.islice(coming, room):
                    task = self._client.submit(
                        fly_here,
                        known,
                        digest,
                        structure,
                        numbers,
                        _dumped(part),
                        key=f"jentry-{place}-{os.urandom(8).hex()}",
                        pure=False,
                    )
                    flying[task] = place
                    task.add_done_callback(ended.put)
                if not flying:
                    return
                task = self._next(ended)
                yield flying.pop(task), self._value(task)
        finally:
            if self._client.status == "running":
                self._client.cancel(list(flying), force=True)

    def _next(
        self, ended: "queue.SimpleQueue[distributed.Future]"
    ) -> "distributed.Future":
        """The next task that ends, in whatever way."""
        alone = None
        while True:
            with contextlib.suppress(queue.Empty):
                return ended.get(timeout=_LOOK)
            now = time.monotonic()
            alone = None if self._threads() else alone or now
            if alone is not None and now - alone > self._patience:
                raise ClusterError(
                    f"the scheduler at {self._where} has lost all of its workers, and "
                    f"there was none for {self._patience:g} s"
                )

    def _value(self, task: "distributed.Future") -> Any:
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        try:
            value, where, kind = task.result()
        except KilledWorker as error:
            raise ClusterError(
                f"{error.allowed_failures + 1} workers of {self._where} were lost with "
                "the same part, as when it is too much for their memory: see their logs"
            ) from None
        except (FutureCancelledError, OSError) as error:
            raise self._lost() from error
        if kind not in self._processors:
            self._processors.add(kind)
            warnings.warn(
                f"the worker {where} has another processor than this machine: its "
                "numbers may differ from those of one machine by rounding",
                ResultWarning,
                stacklevel=2,
            )
        return _loads(value)

    def _lost(self) -> ClusterError:
        return ClusterError(f"the scheduler at {self._where} is lost")

    def _pack(self, given: PyTree) -> tuple[str, bytes, bytes]:
        """Digest and bytes of the structure, and bytes of the numbers.

        The same structure is packed once, so that workers know it again: with functions
        that have come anew, they would compile anew.
        """
        numbers, structure = eqx.partition(given, eqx.is_array)
        leaves, form = jax.tree.flatten(structure)
        known = form, tuple(leaves)
        if known not in self._packed:
            contents = _dumped(structure)
            self._packed[known] = hashlib.sha256(contents).hexdigest(), contents
        return *self._packed[known], _dumped(numbers)


def terms() -> dict[str, Any]:
    """What has to be the same in two processes for their numbers to be the same."""
    flags = [flag for flag in os.environ.get("XLA_FLAGS", "").split() if _counts(flag)]
    settings = settings_of_jax()
    return {
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in _VERSIONS},
        "code of jentry": code_of_jentry(),
        "XLA_FLAGS": sorted(flags),
        "setting of JAX": {
            name: repr(value)
            for name, value in settings.items()
            if name not in _WORKERS_OWN
        },
    }


def _counts(flag: str) -> bool:
    return "device_count" not in flag and "dump" not in flag


_ALONE = threading.Lock()
"""Of the threads of a worker: each part is flown on all of them"""

_UNPACKED: dict[str, Any] = {}
_MOST_UNPACKED = 16


def fly_here(
    known: dict[str, Any], digest: str, structure: bytes, numbers: bytes, part: bytes
) -> tuple[bytes, str, str]:
    """Fly a part, in a worker: its value in bytes, the worker, and its processor."""
    from distributed import get_worker

    worker = get_worker()
    with _ALONE:
        _get_ready(worker.state.nthreads, known, worker.address)
        if digest not in _UNPACKED:
            if len(_UNPACKED) >= _MOST_UNPACKED:
                _UNPACKED.clear()
            _UNPACKED[digest] = _loads(structure)
        work, shared = eqx.combine(_loads(numbers), _UNPACKED[digest])
        value = work(shared, _loads(part))
        return _dumped(value), worker.address, processor()


_READY: set[str] = set()


def _get_ready(threads: int, known: dict[str, Any], address: str) -> None:
    """Set this process up as the one that asks. Refuses where it cannot be had."""
    asked = repr(known)
    if asked in _READY:
        return
    fast = any("multi_output_fusion" in flag for flag in known["XLA_FLAGS"])
    setup(threads, fast=fast)
    different = first_difference(terms(), known)
    if different is not None:
        raise ClusterError(
            f"the worker {address} cannot give the numbers of this machine: {different}. "
            "Start it anew, with the same jentry, packages and environment"
        )
    _READY.add(asked)


def _dumped(tree: PyTree) -> bytes:
    """Bytes of anything; what no worker can import goes along by its value."""
    import cloudpickle

    for name in _not_installed(frozenset(sys.modules)):
        if (module := sys.modules.get(name)) is not None:
            cloudpickle.register_pickle_by_value(module)
    return cloudpickle.dumps(tree)


def _loads(contents: bytes) -> Any:
    import cloudpickle

    return cloudpickle.loads(contents)


@functools.lru_cache(maxsize=1)
def _not_installed(modules: frozenset[str]) -> list[str]:
    """Names of modules that are no part of Python, of a package or of jentry."""
    installed = importlib.metadata.packages_distributions()
    known = sys.stdlib_module_names | installed.keys() | {__name__.split(".")[0]}
    return sorted(
        name
        for name in modules - {"__main__", "__mp_main__"}
        if name.split(".")[0] not in known
        and str(getattr(sys.modules.get(name), "__file__", None)).endswith(".py")
    )
