"""A worker of a cluster: it takes over the settings of the client, and flies parts.

The client is the process that uses the cluster.
"""

import functools
import hashlib
import importlib.metadata
import os
import pickle
import platform
import threading
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jaxtyping import PyTree

from .._provenance.modules import MAIN
from .._provenance.program_keys import (
    COMPUTING,
    Unknown,
    code_of_jentry,
    settings_of_jax,
)
from .._setup import fast_options_are_on, processor, setup
from .carried import SCRIPT, Carried, dumped, loaded, receive
from .description import first_difference
from .errors import ClusterError
from .users_code import own_code


_OF_EACH = "jax_num_cpu_devices", "jax_platform", "jax_default_device", "jax_pjrt"
"""Beginnings of the names of settings of JAX that may differ: they change no number"""

_NO_NUMBER = "device_count", "dump"
"""Words in the names of flags of XLA that change no number"""


def terms() -> dict[str, Any]:
    """Settings, versions and code that must agree for two processes to give equal numbers.

    **Raises:** `ClusterError` if files of jentry have changed since they were imported.
    """
    try:
        code = code_of_jentry()
    except Unknown:
        raise ClusterError(
            "files of jentry have changed since this process has imported them: start "
            "it again"
        ) from None
    flags = os.environ.get("XLA_FLAGS", "").split()
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        **_versions(),
        "code of jentry": code,
        "XLA_FLAGS": sorted(f for f in flags if not any(n in f for n in _NO_NUMBER)),
        "fast": fast_options_are_on(),
        "setting": {
            name: value
            for name, value in settings_of_jax().items()
            if not name.startswith(_OF_EACH)
        },
    }


@functools.cache
def _versions() -> dict[str, str]:
    return {name: importlib.metadata.version(name) for name in COMPUTING}


class Flown(NamedTuple):
    """A part that a worker has flown."""

    value: Carried
    worker: str
    processor: str
    """Digest of the kind of processor"""


class Work(NamedTuple):
    """What all parts of one call of the batch runner have in common."""

    digest: str
    structure: Carried
    numbers: Carried
    code: dict[str, str]
    """Digests of the user's own code in the structure, as it is in the client"""


class Structures:
    """Structures in bytes, each packed once.

    Workers find structures that they have received before by their digests, with the
    programs that were compiled for them. A function that is unpickled twice would be
    compiled twice.
    """

    def __init__(self):
        self._packed: dict[Hashable, tuple[Carried, dict[str, str]]] = {}

    def packed(self, tree: PyTree) -> Work:
        """Structure and numbers of a pytree."""
        numbers, structure = eqx.partition(tree, eqx.is_array)
        leaves, form = jax.tree.flatten(structure)
        # Equal values may differ: True is not 1, and -0.0 is not 0.0. Their texts differ.
        known = form, repr(form), tuple(leaves), repr(leaves)
        if known not in self._packed:
            self._packed[known] = dumped(structure), _code_of(structure)
        carried, code = self._packed[known]
        return Work(carried.digest, carried, dumped(numbers), code)


def _code_of(structure: PyTree) -> dict[str, str]:
    """Digests of the user's own code. The script has one name in client and worker."""
    return {
        name.replace(f"{SCRIPT}.", f"{MAIN}.", 1): digest
        for name, digest in own_code(structure).items()
    }


def _refuse_other_code(known: dict[str, str], structure: PyTree) -> None:
    """Refuse code that differs between its file, which workers run, and the client."""
    ours = _code_of(structure)
    for name in sorted(known.keys() | ours.keys()):
        if known.get(name) != ours.get(name):
            raise ClusterError(
                f"{name} is not what its file says, which is what workers fly: the file "
                "has changed since it was imported, or it was changed in memory. Start "
                "again, and give what varies as a field of the law"
            )


class _Call:
    """A call of a function, which is made when it is unpickled."""

    def __init__(self, function: Callable, *given: Any):
        self._made = function, given

    def __reduce__(self) -> tuple[Callable, tuple]:
        return self._made


def task(known: dict[str, Any], work: Work, part: PyTree) -> bytes:
    """Bytes of the task to fly a part. In a worker `pickle.loads` returns a `Flown`.

    (The scheduler of Dask unpickles the functions that workers call, and it need not have
    jentry.)
    """
    return pickle.dumps(_Call(fly_here, known, pickle.dumps((work, dumped(part)))))


_ALONE = threading.Lock()
"""Lock of the threads of a worker, since each part is flown on all of them"""

_UNPACKED: dict[str, Any] = {}
_MOST_UNPACKED = 16


def fly_here(known: dict[str, Any], given: bytes) -> Flown:
    """Fly a part in a worker, if its terms are those of the client."""
    from distributed import get_worker

    worker = get_worker()
    with _ALONE:
        _get_ready(worker.state.nthreads, known, worker.address)
        value = _value(*pickle.loads(given))
        return Flown(value, worker.address, kind_of_processor())


def am_worker() -> bool:
    """Whether this process is a worker that has flown."""
    return bool(_READY)


def _value(work: Work, part: Carried) -> Carried:
    digest, structure, numbers, code = work
    others = [receive(carried.sources) for carried in (structure, numbers, part)]
    if any(others) or len(_UNPACKED) >= _MOST_UNPACKED:
        _UNPACKED.clear()
    if digest not in _UNPACKED:
        unpacked = loaded(structure)
        _refuse_other_code(code, unpacked)
        _UNPACKED[digest] = unpacked
    function, shared = eqx.combine(loaded(numbers), _UNPACKED[digest])
    return dumped(function(shared, loaded(part)))


@functools.cache
def kind_of_processor() -> str:
    """Digest of the kind of processor of this machine."""
    return hashlib.sha256(processor().encode()).hexdigest()


_READY: dict[str, Any] = {}
"""The present terms of this worker"""


def _get_ready(threads: int, known: dict[str, Any], address: str) -> None:
    """Set this process up like the client. Refuses if that is not possible."""
    if known == _READY:
        return
    try:
        setup(threads, fast=known["fast"])
        different = _difference(known)
    except (ValueError, RuntimeError, AttributeError) as error:
        different = str(error)
    if different:
        raise ClusterError(
            f"the worker {address} cannot give the numbers of this machine: {different}. "
            "Start it again, with the same jentry, packages and environment"
        )
    _READY.clear()
    _READY.update(known)


def _difference(known: dict[str, Any]) -> str | None:
    """The first difference to the client, once this process has its settings."""
    ours = terms()
    for name, value in known["setting"].items():
        if ours["setting"].get(name) != value:
            jax.config.update(name, value)
    return first_difference(terms(), known)
