"""Cached programs: functions that are traced once, for later processes as well.

JAX's own cache saves the time of the compiler, but it finds a program only after tracing,
which takes seconds of Python for a guided flight. This cache stores traced programs, as
`jax.export` writes them, and finds them by what they depend on (`_provenance`).
"""

import contextlib
import functools
import hashlib
import os
import pickle
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import export
from jax._src.core import trace_state_clean  # jax.core has it no longer
from jax.core import Tracer
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from ._devices import cores
from ._files import write_whole
from ._provenance.program_keys import Unknown, description_of, key_of, settings
from ._setup import programs_directory


P = ParamSpec("P")
R = TypeVar("R")

_INSPECTED = "jax_disable_jit", "jax_debug_nans", "jax_debug_infs"
"""Settings of JAX with which `jit` does more than run a program"""

_ENVIRONMENT = jax.make_user_context(None)
"""Part of the key under which JAX finds its own traces"""

_ONE_THREAD = threading.RLock()
"""One thread at a time traces: the filters of warnings belong to the whole process"""

_UNUSED = 60 * 86400.0
"""s, after which a program that was not used is removed"""


def cached(function: Callable[P, R], **options: Any) -> "Cached[P, R]":
    """Compile a function as `eqx.filter_jit` does, and cache its traced programs.

    A program is cached if it contains nothing of the user's own code. The cache is the
    folder that `jentry.setup` chooses. Programs are run from there, so only the user may
    have write access to it.
    """
    return Cached(function, options)


class Cached(Generic[P, R]):
    """A compiled function whose programs are cached, see `cached`."""

    IN_KEYS = "_function", "_options"
    """Attributes that are part of the keys of programs. The others are state."""

    def __init__(self, function: Callable[P, R], options: dict[str, Any]):
        functools.update_wrapper(self, function)
        self._function = function
        self._options = options
        self._traced = eqx.filter_jit(function, **options)
        self._programs: dict[tuple[str, str], _Program | None] = {}

    def __call__(self, *given: P.args, **named: P.kwargs) -> R:
        leaves, structure = jax.tree.flatten((given, named))
        program = self._program(leaves, structure)
        return program(leaves) if program else self._traced(*given, **named)

    def _program(self, leaves: list[Any], structure: Any) -> "_Program | None":
        """The program for these arguments, or None if it is not cached."""
        folder = programs_directory()
        if folder is None or _is_inspected(leaves):
            return None
        try:
            description = description_of(self._function, leaves, structure)
            known = description, settings()
            with _ONE_THREAD:
                if known not in self._programs:
                    key = key_of(description)
                    self._programs[known] = self._load(folder, key, leaves, structure)
                return self._programs[known]
        except Unknown:
            return None

    def _load(
        self, folder: Path, key: str, leaves: list[Any], structure: Any
    ) -> "_Program | None":
        file = folder / f"{self._function.__name__.strip('_')}-{key}"
        contents = _read(file)
        if contents is None:
            # JAX may hold traces of functions of jentry that were replaced in memory.
            with _ENVIRONMENT(key):
                contents = _traced(self._function, leaves, structure)
            if contents is None:
                return None
            _write(file, contents)
        return _Program(contents, self._options)


def is_tracing() -> bool:
    """Whether JAX traces what is computed here."""
    return not trace_state_clean()


def _is_inspected(leaves: list[Any]) -> bool:
    """Whether JAX traces or checks the operations of the function itself."""
    if is_tracing() or any(isinstance(leaf, Tracer) for leaf in leaves):
        return True
    return any(getattr(jax.config, name) for name in _INSPECTED)


class _Place:
    """Placeholder for an array in the results of a program."""

    def __init__(self, index: int):
        self.index = index


class _Program:
    """A program with the structure of its results."""

    def __init__(self, contents: bytes, options: dict[str, Any]):
        written, self._form = pickle.loads(contents)
        exported = export.deserialize(bytearray(written))
        if (count := exported.nr_devices) > 1:
            mesh = jax.make_mesh(
                (count,),
                ("devices",),
                axis_types=(AxisType.Auto,),
                devices=cores()[:count],
            )
            options = {**options, "in_shardings": NamedSharding(mesh, PartitionSpec())}
        self._run = jax.jit(exported.call, **options)

    def __call__(self, leaves: list[Any]) -> Any:
        numbers = self._run(*filter(eqx.is_array, leaves))
        # An exported program commits its results to its devices.
        numbers = [
            jnp.asarray(x.item() if x.weak_type else np.asarray(x)) for x in numbers
        ]
        return jax.tree.map(
            lambda x: numbers[x.index] if isinstance(x, _Place) else x, self._form
        )


def _is_restored(x: Any) -> bool:
    """Whether an array has the same type after its conversion to numpy and back."""
    is_key = jnp.issubdtype(x.dtype, jax.dtypes.extended)
    return not is_key and (x.ndim == 0 or not x.weak_type)


def _traced(function: Callable, leaves: list[Any], structure: Any) -> bytes | None:
    """The bytes of a program, or None if it cannot be exported or warns when traced.

    Leaves that are arrays are its arguments. All other leaves are part of it.
    """
    forms = []

    def of_arrays(*arrays):
        following = iter(arrays)
        inside = [next(following) if eqx.is_array(x) else x for x in leaves]
        given, named = jax.tree.unflatten(structure, inside)
        out = function(*given, **named)
        numbers = [x for x in jax.tree.leaves(out) if eqx.is_array(x)]
        if any(not _is_restored(x) for x in numbers):
            raise TypeError
        places = map(_Place, range(len(numbers)))
        forms.append(
            jax.tree.map(lambda x: next(places) if eqx.is_array(x) else x, out)
        )
        return numbers

    of_arrays.__name__ = of_arrays.__qualname__ = function.__name__
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            exported = export.export(jax.jit(of_arrays), platforms=["cpu"])(
                *filter(eqx.is_array, leaves)
            )
            contents = pickle.dumps((bytes(exported.serialize()), forms[-1]))
        except Exception:  # the function itself raises it with a better traceback
            contents = None
    for warning in caught:  # later processes would not show it
        contents = None
        warnings.warn_explicit(
            warning.message, warning.category, warning.filename, warning.lineno
        )
    return contents


def _read(file: Path) -> bytes | None:
    """The program in a file, or None if there is none or it is damaged."""
    try:
        contents = file.read_bytes()
        os.utime(file)
    except OSError:
        return None
    digest, program = contents[:32], contents[32:]
    return program if hashlib.sha256(program).digest() == digest else None


def _write(file: Path, program: bytes) -> None:
    """Store a program, and remove those that were not used for `_UNUSED`."""
    with contextlib.suppress(OSError):  # a full disk, or no write access
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(file, hashlib.sha256(program).digest() + program)
        for other in filter(Path.is_file, file.parent.iterdir()):
            if time.time() - other.stat().st_mtime > _UNUSED:
                other.unlink(missing_ok=True)
