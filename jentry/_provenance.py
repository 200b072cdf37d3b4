"""What a compiled program is made of, in words: by these it is found again.

Its function and the structure of what it is given, with all that is no number in there;
and the ground it stands on: jentry's files and what has become of them in memory, the
versions of what it uses, the settings of JAX and the number of devices. Of a function or
a class the name tells all where it belongs to one of these. Of the user's own it does not.
"""

import contextlib
import enum
import functools
import hashlib
import importlib.metadata
import inspect
import sys
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np


_HERE = Path(__file__).parent
_OURS = __name__.split(".")[0]
_IMPORTED = time.time()

_INSTALLED = "jax", "jaxlib", "numpy", "equinox", "diffrax", "optimistix", "lineax"
"""Known by their versions"""

_KNOWN = frozenset({_OURS, *_INSTALLED, "builtins", "functools", "math", "operator"})
"""Packages whose functions and classes are what their names say"""

_AT_HOME = _KNOWN | sys.stdlib_module_names | {"jaxtyping", "optax", "scipy"}
"""Packages whose functions have a place in jentry's modules"""

_PLAIN = bool, int, float, complex, str, bytes, tuple, list, dict, frozenset
"""Types of constants"""

_OF_NO_PROGRAM = "cache", "dump", "log", "traceback", "explain"
"""In the names of JAX's settings that change no compiled program"""


class Untold(Exception):
    """What a program is made of cannot be told."""


def made_of(function: Callable, leaves: list[Any], structure: Any) -> str:
    """What a program is made of besides the ground it stands on.

    **Arguments:**

    - `function`: what is traced.
    - `leaves`, `structure`: of what it is given. Arrays are what varies; all else is part
      of the program.

    **Raises:** `Untold` where something has no name that tells all of it.
    """
    return "\n".join(_parts(function, leaves, structure))


def provenance(made: str) -> str:
    """A digest of what a program is made of and of what it stands on.

    **Raises:** `Untold` where jentry is no longer what its files say.
    """
    settings = {
        name: getattr(jax.config, name, value)
        for name, value in sorted(jax.config.values.items())
        if not any(word in name for word in _OF_NO_PROGRAM)
    }
    devices = f"{jax.default_backend()} {len(jax.devices())}"
    told = [made, _source(), *_in_memory(), _versions(), devices, str(settings)]
    return hashlib.sha256("\n".join(told).encode()).hexdigest()


def _parts(function: Callable, leaves: list[Any], structure: Any) -> Iterator[str]:
    yield _name(function)
    yield from _form(structure)
    for leaf in leaves:
        if not isinstance(leaf, jax.Array):
            yield from _constant(leaf)
        elif leaf.committed:
            raise Untold
        else:
            yield f"{leaf.aval.str_short()} {leaf.aval.weak_type}"


def _form(structure: Any) -> Iterator[str]:
    """Of a pytree without its leaves."""
    node = structure.node_data()
    if node is None:
        yield "*"
        return
    kind, static = node
    yield "None" if kind is types.NoneType else _name(kind)
    yield from _constant(static)
    yield "("
    for child in structure.children():
        yield from _form(child)
    yield ")"


def _constant(x: Any) -> Iterator[str]:
    """Of what is part of a program: all of it, with its type."""
    match x:
        case enum.Enum():
            yield f"{_name(type(x))}.{x.name}"
        case None | bool() | int() | float() | complex() | str() | bytes():
            if type(x).__module__ != "builtins":
                raise Untold
            yield repr(x)
        case tuple() | list() | dict() | frozenset():
            if type(x).__module__ != "builtins":
                raise Untold
            members = x.items() if isinstance(x, dict) else x
            told = ["\n".join(_constant(member)) for member in members]
            yield type(x).__name__ + "("
            yield from sorted(told) if isinstance(x, frozenset) else told
            yield ")"
        case functools.partial():
            yield "partial"
            yield from _constant((x.func, x.args, x.keywords))
        case _:
            leaves, structure = jax.tree.flatten(x)
            if structure.node_data() is None:
                yield _name(x)
                return
            yield from _form(structure)
            for leaf in leaves:
                yield from _constant(leaf)


def _name(x: Any) -> str:
    """The name under which a function or a class is found, if it is."""
    module = getattr(x, "__module__", None)
    name = getattr(x, "__qualname__", None)
    if not isinstance(module, str) or not isinstance(name, str):
        raise Untold
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    whole = found is x or getattr(found, "__wrapped__", None) is x
    if not whole or module.split(".")[0] not in _KNOWN:
        raise Untold
    return f"{module}:{name}"


def _source() -> str:
    """Digest of the files of jentry.

    **Raises:** `Untold` where one has changed since it was imported.
    """
    kinds = "py", "npz"
    files = sorted(file for kind in kinds for file in _HERE.rglob(f"*.{kind}"))
    if any(file.stat().st_mtime > _IMPORTED for file in files):
        raise Untold
    return _digest_of_files(tuple(files))


@functools.cache
def _digest_of_files(files: tuple[Path, ...]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.relative_to(_HERE)}\n".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def _in_memory() -> Iterator[str]:
    """The constants, functions and classes of jentry as they are now.

    **Raises:** `Untold` where a function of somebody else's has taken a place.
    """
    for name, module in sorted(sys.modules.items()):
        package, *inside = name.split(".")
        if package != _OURS or inside[:1] in (["cli"], ["plots"], ["_provenance"]):
            continue
        for own, x in sorted(vars(module).items()):
            if not own.startswith("__"):
                yield f"{name}.{own} {_in_place(x)}"
            if isinstance(x, type) and x.__module__ == name:
                for of_class, member in vars(x).items():
                    if callable(member) or not of_class.startswith("__"):
                        yield f"{name}.{own}.{of_class} {_in_place(member)}"


def _in_place(x: Any) -> str:
    """Of what has a name in a module or a class."""
    if isinstance(x, np.ndarray | jax.Array):
        return hashlib.sha256(np.asarray(x).tobytes()).hexdigest()
    if isinstance(x, _PLAIN):
        with contextlib.suppress(Untold):
            return " ".join(_constant(x))
        return type(x).__name__
    if not isinstance(x, type):
        # Out of a property, a classmethod, a method of a module, a partial.
        for inside in ("fget", "__func__", "method", "func"):
            x = getattr(x, inside, x)
    if not callable(x):
        return type(x).__name__
    x = inspect.unwrap(x)
    module = getattr(x, "__module__", None) or "builtins"
    if module.split(".")[0] not in _AT_HOME and not module.startswith("namedtuple_"):
        raise Untold
    return f"{module}:{getattr(x, '__qualname__', type(x).__name__)}"


@functools.cache
def _versions() -> str:
    packages = [f"{name} {importlib.metadata.version(name)}" for name in _INSTALLED]
    return " ".join([sys.version, *packages])
