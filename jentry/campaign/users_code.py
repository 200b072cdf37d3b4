"""The user's own code in a campaign, by digests: with other code it is another campaign.

What jentry and other packages are is told by their versions. A law in a script, or beside
it, has none.
"""

import dataclasses
import functools
import hashlib
import sys
import sysconfig
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from .._provenance import digest_of_code, is_filled
from .carried import MAIN


_OURS = __name__.split(".")[0]
_PACKAGES = "site-packages", "dist-packages"
"""Folders of what is installed"""

_PLAIN = bool, int, float, complex, str, bytes, type(None)


def own_code(*trees: Any) -> dict[str, str]:
    """Digests of all classes and functions in some trees that are not installed, by name.

    Of the code as it runs here, with what it uses in turn: functions, classes, numbers and
    arrays of its module, and of others that are not installed. Comments do not count.
    """
    found: dict[str, list[str]] = {}
    seen: dict[int, Any] = {}
    # Arrays are told elsewhere, by their addresses.
    todo = [("", eqx.filter(tree, eqx.is_array, inverse=True)) for tree in trees]
    while todo:
        name, thing = todo.pop()
        if isinstance(thing, types.FunctionType):
            name = f"{_home(thing)}.{thing.__qualname__}"
        told = _told(thing)
        if told is not None and name:
            found.setdefault(name, []).append(told)
        if id(thing) not in seen:
            seen[id(thing)] = thing  # kept, so that nothing else gets its place
            todo += _inside(name, thing)
    return {
        name: hashlib.sha256("\n".join(sorted(digests)).encode()).hexdigest()
        for name, digests in sorted(found.items())
    }


def _told(thing: Any) -> str | None:
    """In words, what is no container of other things; None for all else."""
    match thing:
        case np.ndarray() | jax.Array() if not isinstance(thing, Tracer):
            if jnp.issubdtype(thing.dtype, jax.dtypes.prng_key):
                thing = jax.random.key_data(thing)
            values = np.asarray(thing)
            if values.dtype != object:
                digest = hashlib.sha256(values.tobytes()).hexdigest()
                return f"{values.dtype} {values.shape} {digest}"
        case types.FunctionType() if _is_own(_home(thing)):
            return digest_of_code(thing.__code__)
        case _ if isinstance(thing, _PLAIN):
            return repr(thing)
    return None


def _inside(name: str, thing: Any) -> Iterator[tuple[str, Any]]:
    """What a thing holds or uses, with the names that these have."""
    match thing:
        case Mapping():
            for key, value in thing.items():
                yield f"{name}.{key}" if name else "", value
        case list() | tuple() | set() | frozenset():
            yield from ((name, value) for value in thing)
        case functools.partial():
            yield from ((name, x) for x in (thing.func, thing.args, thing.keywords))
        case property():
            yield from ((name, x) for x in (thing.fget,))
        case types.MethodType():
            yield from ((name, x) for x in (thing.__func__, thing.__self__))
        case types.FunctionType():
            yield from _used(thing)
            if hasattr(thing, "__wrapped__"):
                yield name, thing.__wrapped__
        case type():
            if _is_own(thing.__module__):
                yield from _of_class(thing)
        case _ if dataclasses.is_dataclass(thing):
            yield "", type(thing)
            for field in dataclasses.fields(thing):
                value = getattr(thing, field.name, None)
                # Without a name it is of the trees, whose plain values are told elsewhere.
                if name:
                    yield f"{name}.{field.name}", value
                elif isinstance(value, np.ndarray):
                    yield f"{_name(type(thing))}.{field.name}", value
                else:
                    yield "", value
        case _ if hasattr(thing, "__wrapped__"):
            yield name, thing.__wrapped__


def _of_class(kind: type) -> Iterator[tuple[str, Any]]:
    for base in kind.__mro__[1:]:
        yield "", base
    name = _name(kind)
    for attribute, value in vars(kind).items():
        hidden = attribute.startswith("__") and not callable(value)
        if not hidden and not attribute.startswith("_abc_"):
            yield f"{name}.{attribute}", getattr(kind, attribute, None)


def _used(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """What the code of a function uses: of its module, of those around it, its defaults.

    Of a function of a package what it has been given, which may be the user's own.
    """
    home, code = _home(function), function.__code__
    own = _is_own(home)
    name = f"{home}.{function.__qualname__}" if own else ""
    yield name, function.__defaults__
    yield name, function.__kwdefaults__
    cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
    for variable, cell in cells:
        if is_filled(cell):
            yield f"{name}.{variable}" if own else "", cell.cell_contents
    if not own:
        return
    names = set(_names(code))
    for used in sorted(names & function.__globals__.keys()):
        value = function.__globals__[used]
        if not isinstance(value, types.ModuleType):
            yield f"{home}.{used}", value
        elif _is_own(value.__name__):
            for inner in sorted(names & vars(value).keys()):
                yield f"{value.__name__}.{inner}", vars(value)[inner]


def _home(function: types.FunctionType) -> str:
    """The module where it was written: `functools.wraps` copies all names but this one."""
    return function.__globals__.get("__name__", "")


def _names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def _name(thing: Any) -> str:
    return f"{thing.__module__}.{thing.__qualname__}"


@functools.cache
def _is_own(module: str | None) -> bool:
    """Whether a module is no part of Python, of an installed package or of jentry."""
    if module == MAIN:
        return True
    file = getattr(sys.modules.get(module or ""), "__file__", None)
    if file is None or (module or "").split(".")[0] == _OURS:
        return False
    path = Path(file)
    ours = {sysconfig.get_path(kind) for kind in ("stdlib", "platstdlib")}
    if any(path.is_relative_to(folder) for folder in ours):
        return False
    return not any(part in _PACKAGES for part in path.parts)
