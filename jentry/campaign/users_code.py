"""Digests of the user's own code in a campaign: other code makes another campaign.

The versions of jentry and of other packages identify their code. A law in a script, or in
a module beside it, has no version.
"""

import dataclasses
import types
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import numpy as np

from .._provenance.modules import Owner, home_of, owner_of
from .._provenance.parts import (
    digest,
    digest_of_code,
    given_to,
    held_by,
    members_of,
    text_of,
)


def own_code(*trees: Any) -> dict[str, str]:
    """Digests of the user's own classes and functions in some pytrees, by name.

    A function or class counts with all that it uses: functions, classes, numbers and arrays
    of its own module and of other modules of the user. The digests are of the code in
    memory. Comments do not count.
    """
    found: dict[str, list[str]] = {}
    seen: dict[int, Any] = {}
    # The description of a campaign has the arrays of the pytrees by their addresses.
    todo = [("", eqx.filter(tree, eqx.is_array, inverse=True)) for tree in trees]
    while todo:
        name, thing = todo.pop()
        if isinstance(thing, types.FunctionType):
            name = f"{home_of(thing)}.{thing.__qualname__}"
        text = _text(thing)
        if text is not None and name:
            found.setdefault(name, []).append(text)
        if id(thing) not in seen:
            seen[id(thing)] = thing  # stored, so that no other object gets its identity
            todo += _parts(name, thing)
    return {
        name: digest("\n".join(sorted(texts)).encode())
        for name, texts in sorted(found.items())
    }


def _text(thing: Any) -> str | None:
    """Text that identifies a function of the user, a plain value or an array, or None."""
    if isinstance(thing, types.FunctionType) and _is_own(home_of(thing)):
        return digest_of_code(thing.__code__)
    return text_of(thing)


def _parts(name: str, thing: Any) -> Iterator[tuple[str, Any]]:
    """What an object holds or uses, with full names. Parts without a name do not count."""
    match thing:
        case types.FunctionType():
            own = _is_own(home_of(thing))
            for label, part in given_to(thing):
                # A function of a package may hold functions of the user. Its numbers are
                # known from the version of the package.
                yield _joined(name if own else "", label), part
            if own:
                yield from _globals_used(thing)
            yield from ((name, part) for _, part in held_by(thing))
        case type():
            if _is_own(thing.__module__):
                for label, part in members_of(thing):
                    yield _joined(_full_name(thing), label), part
        case _ if dataclasses.is_dataclass(thing):
            yield "", type(thing)
            for field in dataclasses.fields(thing):
                value = getattr(thing, field.name, None)
                holder = name
                # An object without a name is part of the pytrees. The description of a
                # campaign has its fields, except for static arrays of numpy.
                if not name and isinstance(value, np.ndarray):
                    holder = _full_name(type(thing))
                yield _joined(holder, field.name), value
        case _:
            for label, part in held_by(thing):
                yield _joined(name, label), part


def _globals_used(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """What the code of a function uses of its module and of other modules of the user."""
    names = set(_names(function.__code__))
    for used in sorted(names & function.__globals__.keys()):
        value = function.__globals__[used]
        if not isinstance(value, types.ModuleType):
            yield f"{home_of(function)}.{used}", value
        elif _is_own(value.__name__):
            for inner in sorted(names & vars(value).keys()):
                yield f"{value.__name__}.{inner}", vars(value)[inner]


def _names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def _is_own(module: str) -> bool:
    return owner_of(module) is Owner.USER


def _full_name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _joined(name: str, label: str | None) -> str:
    return f"{name}.{label}" if name and label is not None else name
