"""Numbers of the flights of a block, one by one.

An array of a flight is a NumPy array. If it is known when the kernel is made, the NumPy
array has its numbers. Otherwise it is of objects, its *elements*. An element is a number
that is known, a scalar that the flights of a block share, or an array of shape (block,).
"""

from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer


class NotInKernel(ValueError):
    """What a flight does that a kernel cannot do: the message goes on after "a flight"."""

    located = False
    """Whether the message has the line of the operation"""


def is_known(array: np.ndarray) -> bool:
    """Whether the numbers of an array are known when the kernel is made."""
    return array.dtype != object


def is_constant(element: Any) -> bool:
    """Whether an element is a number that is known when the kernel is made."""
    return not isinstance(element, Tracer | jax.Array)


def objects(elements: Iterable[Any], shape: Sequence[int]) -> np.ndarray:
    """An array of elements; NumPy would look into those that are arrays themselves."""
    listed = list(elements)
    array = np.empty(len(listed), object)
    for place, element in enumerate(listed):
        array[place] = element
    return array.reshape(shape)


def as_elements(array: np.ndarray) -> np.ndarray:
    """An array of elements, each of the type of the array."""
    return array if not is_known(array) else objects(array.flat, array.shape)


def type_of(element: Any) -> np.dtype:
    return np.dtype(element.dtype)


def spread(element: Any, block: int) -> Any:
    """An element as an array of shape (block,)."""
    return lax.broadcast(element, (block,)) if np.ndim(element) == 0 else element


def alike(elements: Sequence[Any]) -> list[Any]:
    """Elements of one shape, that of the largest."""
    size = max((np.shape(e) for e in elements), key=len)
    return [lax.broadcast(e, size) if np.shape(e) != size else e for e in elements]


def evaluated(primitive: Any, given: Sequence[Any], params: dict[str, Any]) -> Any:
    """Numpy arrays of the values of an operation on known numbers."""
    with jax.ensure_compile_time_eval():
        out = primitive.bind(*map(jnp.asarray, given), **params)
    if primitive.multiple_results:
        return [np.asarray(x) for x in out]
    return np.asarray(out)


_EXACT = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.invert,
}
"""Operations on known numbers that NumPy rounds as XLA does, without compiling anything"""


def of_known(equation: Any, given: Sequence[np.ndarray]) -> np.ndarray:
    """The array that an operation, number by number, makes of known arrays."""
    name = equation.primitive.name
    if name in _EXACT:
        with np.errstate(all="ignore"):
            return np.asarray(_EXACT[name](*given))
    if name == "div" and np.issubdtype(given[0].dtype, np.floating):
        with np.errstate(all="ignore"):
            return np.asarray(np.divide(*given))
    return evaluated(equation.primitive, given, equation.params)


def _is(element: Any, value: float) -> bool:
    return is_constant(element) and bool(element == value)


def apply(equation: Any, given: Sequence[Any]) -> Any:
    """The element that an operation makes of elements, of which one is not known."""
    name = equation.primitive.name
    if name == "mul":
        # Literals of one are many; a zero is kept, since zero times NaN is NaN.
        for one, other in (given, given[::-1]):
            if _is(one, 1.0):
                return other
    if name in _REWRITTEN:
        return _REWRITTEN[name](*given, **equation.params)
    return equation.primitive.bind(*alike(given), **equation.params)


PASSED = "copy", "copy_p", "reduce_precision", "stop_gradient", "xla_metadata_value"
"""Operations that return the number that they are given"""


def _passed(x: Any, **_: Any) -> Any:
    return x


def _square(x: Any) -> Any:
    return lax.mul(x, x)


def _rounded(x: Any, *, rounding_method: Any) -> Any:
    """The nearest whole number; of two, the even one or the one away from zero."""
    size = lax.abs(x)
    down = lax.floor(size)
    off = lax.sub(size, down)
    at_half = off == 0.5
    if lax.RoundingMethod(rounding_method) is lax.RoundingMethod.TO_NEAREST_EVEN:
        half = lax.mul(down, lax.full_like(down, 0.5))
        at_half = lax.bitwise_and(at_half, lax.ne(half, lax.floor(half)))
    up = lax.bitwise_or(off > 0.5, at_half)
    whole = lax.select_n(up, down, lax.add(down, lax.full_like(down, 1.0)))
    return lax.mul(lax.sign(x), whole)


def _less_in_order(x: Any, y: Any) -> Any:
    """Whether x comes before y in sorted order, in which NaN comes last."""
    to_nan = lax.bitwise_and(lax.ne(y, y), lax.eq(x, x))
    return lax.bitwise_or(lax.lt(x, y), to_nan)


def _not_above_in_order(x: Any, y: Any) -> Any:
    """Whether x comes before y in sorted order or equals it; NaN comes last."""
    return lax.bitwise_or(lax.le(x, y), lax.ne(y, y))


_REWRITTEN = {
    **dict.fromkeys(PASSED, _passed),
    "square": _square,
    "round": _rounded,
    "lt_to": _less_in_order,
    "le_to": _not_above_in_order,
}
"""Operations that Pallas lowers with other ones only, or not at all"""
