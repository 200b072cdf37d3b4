"""What a compiled program is made of, in words: by these it is found again.

Its function and the structure of what it is given, with all that is no number in there;
and the ground it stands on: jentry's files and what has become of them in memory, the
versions of what it uses, the settings of JAX and the number of devices. Of a function or
a class the name tells all where it belongs to one of these. Of the user's own it does not.
"""

import enum
import functools
import hashlib
import importlib.metadata
import os
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

_AT_HOME = (
    _KNOWN
    | (sys.stdlib_module_names - {"unittest"})
    | {"jaxtyping", "optax", "scipy", "beartype", "pint", "xarray", "rich", "typer"}
)
"""Packages whose functions have a place in jentry's modules"""

_PLAIN = bool, int, float, complex, str, bytes
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


def settings() -> str:
    """The settings of JAX now, its devices, and what Equinox does about errors."""
    devices = f"{jax.default_backend()} {len(jax.devices())}"
    return f"{devices} {os.environ.get('EQX_ON_ERROR')} {settings_of_jax()}"


def settings_of_jax() -> dict[str, Any]:
    """Those that change a compiled program, by name; with those of context managers."""
    return {
        name: getattr(jax.config, name, value)
        for name, value in sorted(jax.config.values.items())
        if not any(word in name for word in _OF_NO_PROGRAM)
    }


def provenance(made: str) -> str:
    """A digest of what a program is made of and of what it stands on.

    **Raises:** `Untold` where jentry is no longer what its files say.
    """
    told = [made, settings(), code_of_jentry(), *_in_memory(), _versions()]
    return _digest("\n".join(told).encode())


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
        case functools.partial() if type(x) is functools.partial:
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


def code_of_jentry() -> str:
    """Digest of the files of jentry.

    **Raises:** `Untold` where one has changed since it was imported.
    """
    kinds = "py", "npz"
    files = sorted(file for kind in kinds for file in _HERE.rglob(f"*.{kind}"))
    for status in (file.stat() for file in files):
        if max(status.st_mtime, status.st_ctime) > _IMPORTED:
            raise Untold
    return _digest_of_files(tuple(files))


@functools.cache
def _digest_of_files(files: tuple[Path, ...]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.relative_to(_HERE)}\n".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


Seen = dict[int, tuple[int, Any]]
"""Number and object by identity, which is the object's only as long as it is there"""


def _in_memory() -> Iterator[str]:
    """The constants, functions and classes of jentry as they are now.

    **Raises:** `Untold` where something of somebody else's has taken a place.
    """
    seen: Seen = {}
    loaded = sys.modules.copy()  # in one go: other threads import meanwhile
    for name, module in sorted(loaded.items()):
        package, *inside = name.split(".")
        if package != _OURS or inside[:1] in (["cli"], ["plots"], ["_provenance"]):
            continue
        for own, x in sorted(vars(module).items()):
            if not own.startswith("__"):
                yield f"{name}.{own}"
                yield from _living(x, seen)


def _living(x: Any, seen: Seen) -> Iterator[str]:
    """Of what has a name in a module, with all that it is made of."""
    if isinstance(x, np.ndarray | np.generic | jax.Array):
        values = np.asarray(x)
        yield f"{values.dtype} {values.shape} {_digest(values.tobytes())}"
        return
    if x is None or type(x) in _PLAIN:
        yield f"{type(x).__name__} {x!r}"
        return
    kind = type(x)
    yield f"{kind.__module__}.{kind.__qualname__}"
    if isinstance(x, types.ModuleType):
        yield x.__name__
    elif id(x) in seen:
        yield f"again {seen[id(x)][0]}"
    elif isinstance(x, dict | list | tuple | set | frozenset):
        seen[id(x)] = len(seen), x
        members = x.items() if isinstance(x, dict) else x
        told = ["\n".join(_living(member, seen)) for member in members]
        yield from sorted(told) if isinstance(x, set | frozenset) else told
    elif isinstance(x, types.FunctionType):
        seen[id(x)] = len(seen), x
        yield from _function(x, seen)
    elif isinstance(x, type):
        seen[id(x)] = len(seen), x
        yield _of_home(x.__module__, x.__qualname__)
        if x.__module__.split(".")[0] == _OURS:
            for name, member in vars(x).items():
                if callable(member) or not name.startswith("__"):
                    yield name
                    yield from _living(member, seen)
    else:
        seen[id(x)] = len(seen), x
        _of_home(kind.__module__, kind.__qualname__)
        known = kind.__module__.split(".")[0] in _KNOWN
        whole = sorted(getattr(x, "__dict__", ())) if known else ()
        for name in _INSIDE.get(kind.__qualname__, whole):
            yield name
            yield from _living(getattr(x, name, None), seen)
        if isinstance(wrapped := getattr(x, "__wrapped__", None), types.FunctionType):
            yield from _living(wrapped, seen)


_INSIDE = {
    "property": ("fget", "fset", "fdel"),
    "classmethod": ("__func__",),
    "staticmethod": ("__func__",),
    "method": ("__func__", "__self__"),
    "partial": ("func", "args", "keywords"),
    "cached_property": ("func",),
    "Kept": ("_function", "_options"),
}
"""What these are made of, of which their `__dict__` says too little or too much"""


def _function(x: types.FunctionType, seen: Seen) -> Iterator[str]:
    # Where it was written: `functools.wraps` copies all names but this one.
    home = x.__globals__.get("__name__", "")
    yield _of_home(home, x.__qualname__)
    if home.split(".")[0] != _OURS:
        return
    yield digest_of_code(x.__code__)
    cells = [cell.cell_contents for cell in x.__closure__ or () if is_filled(cell)]
    for part in (x.__defaults__, x.__kwdefaults__, *cells, vars(x)):
        yield from _living(part, seen)


def is_filled(cell: types.CellType) -> bool:
    """Whether a variable of a function around has a value yet."""
    return cell != types.CellType()  # two without a value are equal


def _of_home(module: str, name: str) -> str:
    if module.split(".")[0] not in _AT_HOME and not module.startswith("namedtuple_"):
        raise Untold
    return f"{module}:{name}"


def digest_of_code(code: types.CodeType) -> str:
    """Of what a function does: its instructions, with names and numbers in them."""
    told = [code.co_code.hex(), repr((code.co_names, code.co_varnames, code.co_flags))]
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            told.append(digest_of_code(constant))
        elif isinstance(constant, frozenset):
            told.append(repr(sorted(map(repr, constant))))
        else:
            told.append(repr(constant))
    return _digest("\n".join(told).encode())


def _digest(contents: bytes) -> str:
    return hashlib.sha256(contents).hexdigest()


@functools.cache
def _versions() -> str:
    """Of Python and the packages below, installed and in memory.

    **Raises:** `Untold` where one is installed to be edited: its version says too little.
    """
    told = [sys.version]
    for name in _INSTALLED:
        distribution = importlib.metadata.distribution(name)
        if '"editable"' in (distribution.read_text("direct_url.json") or ""):
            raise Untold
        there = getattr(sys.modules.get(name), "__version__", None)
        told.append(f"{name} {distribution.version} {there}")
    return " ".join(told)
