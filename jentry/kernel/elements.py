"""Numbers of a flight, one by one.

An array of a flight is a NumPy array. If it is known when the kernel is made, the NumPy
array has its numbers. Otherwise it is of objects, its *elements*. An element is a number
that is known, or a traced scalar.
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


def located(error: NotInKernel, equation: Any) -> NotInKernel:
    """The error with the line of the innermost operation that caused it."""
    if error.located:
        return error
    from jax._src import source_info_util

    frame = source_info_util.user_frame(equation.source_info.traceback)
    if frame is None:
        return error
    with_line = NotInKernel(f"{error} ({frame.file_name}:{frame.start_line})")
    with_line.located = True
    return with_line


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
    return equation.primitive.bind(*given, **equation.params)


PASSED = "copy", "copy_p", "reduce_precision", "stop_gradient", "xla_metadata_value"
"""Operations that return the number that they are given"""


def _passed(x: Any, **_: Any) -> Any:
    return x


def _square(x: Any) -> Any:
    return lax.mul(x, x)


def _one_minus_square(x: Any) -> Any:
    one = lax.full_like(x, 1)
    return lax.mul(lax.add(one, x), lax.sub(one, x))


def _integer_power(x: Any, *, y: int) -> Any:
    """By squaring; a negative power is the inverse of the positive one."""
    if y == 0:
        return lax.full_like(x, 1)
    power, left = x, abs(y)
    found: Any = None
    while left:
        if left & 1:
            found = power if found is None else lax.mul(found, power)
        left >>= 1
        if left:
            power = lax.mul(power, power)
    return found if y > 0 else lax.div(lax.full_like(found, 1), found)


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
    "one_minus_square": _one_minus_square,
    "integer_pow": _integer_power,
    "lt_to": _less_in_order,
    "le_to": _not_above_in_order,
}
"""Operations that are made of others"""
