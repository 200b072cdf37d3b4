"""Programs that have been traced once, for the processes to come as well.

JAX's compilation cache spares the compiler. Before it can be asked a program must be
traced, which for a guided flight takes seconds of Python. A program kept here is found by
what it is made of instead (`_provenance.py`), as `jax.export` has written it down.
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

from ._files import write_whole
from ._provenance import Untold, made_of, provenance, settings
from ._setup import programs_directory


P = ParamSpec("P")
R = TypeVar("R")

_LOOKED_AT = "jax_disable_jit", "jax_debug_nans", "jax_debug_infs"
"""Settings of JAX with which `jit` does more than to run a program"""

_GROUND = jax.make_user_context(None)
"""Part of what JAX finds its traces by"""

_ONE_AT_A_TIME = threading.RLock()
"""Of the threads: warnings are of the whole process"""

_UNUSED = 60 * 86400.0
"""s, after which a program that nobody has asked for is removed"""


def kept(function: Callable[P, R], **options: Any) -> "Kept[P, R]":
    """Compile a function as `eqx.filter_jit` does, and keep what was traced.

    Kept are programs with nothing in them of the user's own, in the folder that
    `jentry.setup` settles. What lies there is run: nobody else must be able to write there.
    """
    return Kept(function, options)


class Kept(Generic[P, R]):
    """A compiled function whose programs are kept, see `kept`."""

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
        """The program for what is given; none where it is not kept."""
        folder = programs_directory()
        if folder is None or _looked_at(leaves):
            return None
        try:
            made = made_of(self._function, leaves, structure)
            known = made, settings()
            with _ONE_AT_A_TIME:
                if known not in self._programs:
                    key = provenance(made)
                    self._programs[known] = self._found(folder, key, leaves, structure)
                return self._programs[known]
        except Untold:
            return None

    def _found(
        self, folder: Path, key: str, leaves: list[Any], structure: Any
    ) -> "_Program | None":
        file = folder / f"{self._function.__name__.strip('_')}-{key}"
        contents = _read(file)
        if contents is None:
            # What JAX has traced before, in a jentry that was another, does not count.
            with _GROUND(key):
                contents = _traced(self._function, leaves, structure)
            if contents is None:
                return None
            _write(file, contents)
        return _Program(contents, self._options)


def is_tracing() -> bool:
    """Whether JAX traces what is computed here."""
    return not trace_state_clean()


def _looked_at(leaves: list[Any]) -> bool:
    """Whether somebody follows what happens in the function: JAX itself, or its checks."""
    if is_tracing() or any(isinstance(leaf, Tracer) for leaf in leaves):
        return True
    return any(getattr(jax.config, name) for name in _LOOKED_AT)


class _Place:
    """Where in the results of a program an array is."""

    def __init__(self, index: int):
        self.index = index


class _Program:
    """A program with the form of what it returns."""

    def __init__(self, contents: bytes, options: dict[str, Any]):
        written, self._form = pickle.loads(contents)
        exported = export.deserialize(bytearray(written))
        if (count := exported.nr_devices) > 1:
            mesh = jax.make_mesh(
                (count,),
                ("devices",),
                axis_types=(AxisType.Auto,),
                devices=jax.devices()[:count],
            )
            options = {**options, "in_shardings": NamedSharding(mesh, PartitionSpec())}
        self._run = jax.jit(exported.call, **options)

    def __call__(self, leaves: list[Any]) -> Any:
        numbers = self._run(*filter(eqx.is_array, leaves))
        # An exported program ties what it returns to its devices.
        numbers = [
            jnp.asarray(x.item() if x.weak_type else np.asarray(x)) for x in numbers
        ]
        return jax.tree.map(
            lambda x: numbers[x.index] if isinstance(x, _Place) else x, self._form
        )


def _comes_back(x: Any) -> bool:
    """Whether a result can be given its type again, after its way through numpy."""
    is_key = jnp.issubdtype(x.dtype, jax.dtypes.extended)
    return not is_key and (x.ndim == 0 or not x.weak_type)


def _traced(function: Callable, leaves: list[Any], structure: Any) -> bytes | None:
    """A program as it is written; none where it cannot be, or warns when it is traced.

    Of the leaves the arrays are what varies.
    """
    forms = []

    def of_arrays(*arrays):
        following = iter(arrays)
        inside = [next(following) if eqx.is_array(x) else x for x in leaves]
        given, named = jax.tree.unflatten(structure, inside)
        out = function(*given, **named)
        numbers = [x for x in jax.tree.leaves(out) if eqx.is_array(x)]
        if any(not _comes_back(x) for x in numbers):
            raise TypeError
        places = map(_Place, range(len(numbers)))
        forms.append(
            jax.tree.map(lambda x: next(places) if eqx.is_array(x) else x, out)
        )
        return numbers

    of_arrays.__name__ = of_arrays.__qualname__ = function.__name__
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            exported = export.export(jax.jit(of_arrays))(*filter(eqx.is_array, leaves))
            contents = pickle.dumps((bytes(exported.serialize()), forms[-1]))
        except Exception:  # whatever it was, the function itself says it better
            contents = None
    for warning in said:  # it would be said once, and never again
        contents = None
        warnings.warn_explicit(
            warning.message, warning.category, warning.filename, warning.lineno
        )
    return contents


def _read(file: Path) -> bytes | None:
    """What has been kept; none if there is nothing, or not what was written."""
    try:
        contents = file.read_bytes()
        os.utime(file)
    except OSError:
        return None
    digest, program = contents[:32], contents[32:]
    return program if hashlib.sha256(program).digest() == digest else None


def _write(file: Path, program: bytes) -> None:
    """Keep a program, and remove those that nobody has asked for in months."""
    with contextlib.suppress(OSError):  # a folder that is full, or not to be written in
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(file, hashlib.sha256(program).digest() + program)
        for other in filter(Path.is_file, file.parent.iterdir()):
            if time.time() - other.stat().st_mtime > _UNUSED:
                other.unlink(missing_ok=True)
