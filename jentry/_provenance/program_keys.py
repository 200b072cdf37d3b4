"""Keys of compiled programs: texts and digests of all that a program depends on.

A program depends on its function, on the structure of its arguments and on the values in
them that are no arrays. It also depends on its environment: jentry's files and what has
become of them in memory, the versions of other packages, the settings of JAX and the number
of devices. The name of a function or class identifies it if it belongs to the environment.
The user's own code has no such name.
"""

import enum
import functools
import importlib.metadata
import os
import sys
import time
import types
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax

from .._devices import cores
from .modules import Owner, find, home_of, owner_of, package_of
from .parts import (
    digest,
    digest_of_code,
    given_to,
    held_by,
    members_of,
    text_of,
)


_HERE = Path(__file__).parent.parent
_IMPORTED = time.time()

COMPUTING = "jax", "jaxlib", "numpy", "equinox", "diffrax", "optimistix", "lineax"
"""Packages that compute the numbers of a flight. Their versions are part of each key."""

_HARMLESS = "jaxtyping", "optax", "scipy", "beartype", "pint", "xarray", "rich", "typer"
"""Other packages whose functions and classes modules of jentry hold"""

_OF_NO_PROGRAM = "cache", "dump", "log", "traceback", "explain"
"""In the names of JAX's settings that change no compiled program"""


class Unknown(Exception):
    """Something that a program depends on cannot be identified."""


def description_of(function: Callable, leaves: list[Any], structure: Any) -> str:
    """Text that identifies a program in a fixed environment.

    **Arguments:**

    - `function`: the traced function.
    - `leaves`, `structure`: the arguments, flattened. Of an array only shape and type are
      part of the program, of all else the value.

    **Raises:** `Unknown` if anything has no name or value that identifies it.
    """
    return "\n".join(_call(function, leaves, structure))


def settings() -> str:
    """The present settings of JAX, its devices, and what Equinox does on errors."""
    devices = f"cpu {len(cores())}"
    return f"{devices} {os.environ.get('EQX_ON_ERROR')} {settings_of_jax()}"


def settings_of_jax() -> dict[str, Any]:
    """Settings that change a compiled program, by name, with those of context managers."""
    return {
        name: getattr(jax.config, name, value)
        for name, value in sorted(jax.config.values.items())
        if not any(word in name for word in _OF_NO_PROGRAM)
    }


def key_of(description: str) -> str:
    """Digest of the description of a program and of its environment.

    **Raises:** `Unknown` if files of jentry have changed since their import, or if objects
    of others have replaced jentry's own in memory.
    """
    lines = [description, settings(), code_of_jentry(), *_in_memory(), _versions()]
    return digest("\n".join(lines).encode())


def _call(function: Callable, leaves: list[Any], structure: Any) -> Iterator[str]:
    yield _name_of(function)
    yield from _nodes(structure)
    for leaf in leaves:
        if not isinstance(leaf, jax.Array):
            yield from _value(leaf)
        elif leaf.committed:
            raise Unknown
        else:
            yield f"{leaf.aval.str_short()} {leaf.aval.weak_type}"


def _nodes(structure: Any) -> Iterator[str]:
    """The nodes of a pytree, without its leaves."""
    node = structure.node_data()
    if node is None:
        yield "*"
        return
    kind, static = node
    yield "None" if kind is types.NoneType else _name_of(kind)
    yield from _value(static)
    yield "("
    for child in structure.children():
        yield from _nodes(child)
    yield ")"


def _value(x: Any) -> Iterator[str]:
    """A value that is part of a program: all of it, with its type.

    Here what is not identified is refused. `_contents` reports changes of objects that the
    files of jentry identify, and may be less strict.
    """
    match x:
        case enum.Enum():
            yield f"{_name_of(type(x))}.{x.name}"
        case None | bool() | int() | float() | complex() | str() | bytes():
            if type(x).__module__ != "builtins":
                raise Unknown
            yield repr(x)
        case tuple() | list() | dict() | frozenset():
            if type(x).__module__ != "builtins":
                raise Unknown
            members = x.items() if isinstance(x, dict) else x
            lines = ["\n".join(_value(member)) for member in members]
            yield type(x).__name__ + "("
            yield from sorted(lines) if isinstance(x, frozenset) else lines
            yield ")"
        case functools.partial() if type(x) is functools.partial:
            yield "partial"
            yield from _value((x.func, x.args, x.keywords))
        case _:
            leaves, structure = jax.tree.flatten(x)
            if structure.node_data() is None:
                yield _name_of(x)
                return
            yield from _nodes(structure)
            for leaf in leaves:
                yield from _value(leaf)


def _name_of(x: Any) -> str:
    """The name of a function or class, if it is found by its name and identified by it."""
    module = getattr(x, "__module__", None)
    name = getattr(x, "__qualname__", None)
    if not isinstance(module, str) or not isinstance(name, str):
        raise Unknown
    found = find(module, name)
    whole = found is x or getattr(found, "__wrapped__", None) is x
    if not whole or not (_is_computing(module) or _is_python(module)):
        raise Unknown
    return f"{module}:{name}"


def _is_computing(module: str) -> bool:
    """Whether a module belongs to jentry or to a package whose version is in the key."""
    return owner_of(module) is Owner.JENTRY or package_of(module) in COMPUTING


def _is_python(module: str) -> bool:
    """Whether a module belongs to Python. The mocks of `unittest` replace anything."""
    return owner_of(module) is Owner.PYTHON and package_of(module) != "unittest"


def code_of_jentry() -> str:
    """Digest of the files of jentry.

    **Raises:** `Unknown` if a file has changed since it was imported.
    """
    kinds = "py", "npz"
    files = sorted(file for kind in kinds for file in _HERE.rglob(f"*.{kind}"))
    for status in (file.stat() for file in files):
        if max(status.st_mtime, status.st_ctime) > _IMPORTED:
            raise Unknown
    return _digest_of_files(tuple(files))


@functools.cache
def _digest_of_files(files: tuple[Path, ...]) -> str:
    lines = (f"{file.relative_to(_HERE)} {digest(file.read_bytes())}" for file in files)
    return digest("\n".join(lines).encode())


Seen = dict[int, tuple[int, Any]]
"""Number and object by identity. Holding the object keeps its identity from reuse."""


def _in_memory() -> Iterator[str]:
    """The present constants, functions and classes of jentry.

    **Raises:** `Unknown` if an object of others has replaced one of jentry's.
    """
    seen: Seen = {}
    loaded = sys.modules.copy()  # in one go: other threads import meanwhile
    for name, module in sorted(loaded.items()):
        inside = name.split(".")[1:]
        if owner_of(name) is not Owner.JENTRY:
            continue
        if inside[:1] in (["cli"], ["plots"], ["_provenance"]):
            continue
        for own, x in sorted(vars(module).items()):
            if not own.startswith("__"):
                yield f"{name}.{own}"
                yield from _contents(x, seen)


def _contents(x: Any, seen: Seen) -> Iterator[str]:
    """An object that has a name in a module of jentry, with all that it is made of."""
    if (text := text_of(x)) is not None:
        yield text
        return
    kind = type(x)
    yield f"{kind.__module__}.{kind.__qualname__}"
    if isinstance(x, types.ModuleType):
        yield x.__name__
        return
    if id(x) in seen:
        yield f"again {seen[id(x)][0]}"
        return
    seen[id(x)] = len(seen), x
    if isinstance(x, set | frozenset):
        yield from sorted("\n".join(_contents(member, seen)) for member in x)
        return
    for label, part in _parts(x):
        if label is not None:
            yield label
        yield from _contents(part, seen)


def _parts(x: Any) -> Iterator[tuple[str | None, Any]]:
    """What an object is made of. Functions and classes of others are known by their names.

    **Raises:** `Unknown` if the object is of others that jentry does not use.
    """
    match x:
        case types.FunctionType():
            home = home_of(x)
            yield "name", _of_environment(home, x.__qualname__)
            if owner_of(home) is Owner.JENTRY:
                yield "code", digest_of_code(x.__code__)
                yield from given_to(x)
                yield "attributes", vars(x)
        case type():
            yield "name", _of_environment(x.__module__, x.__qualname__)
            if owner_of(x.__module__) is Owner.JENTRY:
                yield from members_of(x)
        case Mapping():
            # Keys may be functions, and their labels would differ between processes.
            yield from ((None, item) for item in x.items())
        case _:
            kind = type(x)
            _of_environment(kind.__module__, kind.__qualname__)
            yield from held_by(x)
            # Objects of Python hold caches that differ between processes.
            if _is_computing(kind.__module__):
                names = getattr(kind, "IN_KEYS", None) or getattr(x, "__dict__", ())
                yield from ((name, getattr(x, name, None)) for name in sorted(names))


def _of_environment(module: str, name: str) -> str:
    """The name of an object of jentry, Python or a package that jentry uses."""
    known = _is_computing(module) or _is_python(module)
    # The functions of a named tuple are in a module that was never imported.
    named_tuple = module.startswith("namedtuple_")
    if not (known or named_tuple or package_of(module) in _HARMLESS):
        raise Unknown
    return f"{module}:{name}"


@functools.cache
def _versions() -> str:
    """Versions of Python and of the packages that compute, installed and in memory.

    **Raises:** `Unknown` if one is in editable mode: its version does not identify it.
    """
    versions = [sys.version]
    for name in COMPUTING:
        distribution = importlib.metadata.distribution(name)
        if '"editable"' in (distribution.read_text("direct_url.json") or ""):
            raise Unknown
        loaded = getattr(sys.modules.get(name), "__version__", None)
        versions.append(f"{name} {distribution.version} {loaded}")
    return " ".join(versions)
