"""What objects of Python are made of, and the digests of code and arrays.

A part has a label, its name within the object. The label is None where the part has no name
of its own, as the function of a `functools.partial`.
"""

import enum
import functools
import hashlib
import types
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


Parts = Iterator[tuple[str | None, Any]]

_PLAIN = bool, int, float, complex, str, bytes, types.NoneType
"""Types whose `repr` is all of a value"""


def text_of(x: Any) -> str | None:
    """Text that identifies a plain value or an array, or None for any other object."""
    if isinstance(x, _PLAIN):
        return repr(x)
    if not isinstance(x, np.ndarray | np.generic | jax.Array) or isinstance(x, Tracer):
        return None
    if isinstance(x, jax.Array) and jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
        x = jax.random.key_data(x)
    values = np.asarray(x)
    if values.dtype == object:
        return None
    return f"{values.dtype} {values.shape} {digest(values.tobytes())}"


def held_by(x: Any) -> Parts:
    """What a container holds, or what a wrapper wraps; nothing for other objects."""
    match x:
        case Mapping():
            yield from ((f"{key}", value) for key, value in x.items())
        case list() | tuple() | set() | frozenset():
            yield from ((None, member) for member in x)
        case enum.Enum():
            yield None, x.value
        case functools.partial():
            yield from ((None, part) for part in (x.func, x.args, x.keywords))
        case property():
            yield None, x.fget
        case functools.cached_property():
            yield None, x.func
        case types.MethodType():
            yield from ((None, part) for part in (x.__func__, x.__self__))
        case _ if hasattr(x, "__wrapped__"):
            yield None, x.__wrapped__


def given_to(function: types.FunctionType) -> Parts:
    """The defaults of a function and the variables of the functions around it."""
    yield None, function.__defaults__
    yield None, function.__kwdefaults__
    cells = function.__closure__ or ()
    for variable, cell in zip(function.__code__.co_freevars, cells, strict=True):
        if cell != types.CellType():  # two cells without a value are equal
            yield variable, cell.cell_contents


def members_of(kind: type) -> Parts:
    """The bases and the members of a class, without what Python itself writes there."""
    yield from ((None, base) for base in kind.__mro__[1:])
    for name, value in vars(kind).items():
        hidden = name.startswith("__") and not callable(value)
        if not hidden and not name.startswith("_abc_"):
            yield name, getattr(kind, name, None)


def digest_of_code(code: types.CodeType) -> str:
    """Digest of the instructions of a function, with their names and constants.

    Comments, line numbers and the name of the file do not change it.
    """
    lines = [code.co_code.hex(), repr((code.co_names, code.co_varnames, code.co_flags))]
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            lines.append(digest_of_code(constant))
        elif isinstance(constant, frozenset):
            lines.append(repr(sorted(map(repr, constant))))
        else:
            lines.append(repr(constant))
    return digest("\n".join(lines).encode())


def digest(contents: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(contents).hexdigest()
