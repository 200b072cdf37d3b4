"""Random bits of the generator Threefry-2x32, from additions, rotations and exclusive ors.

A key is two words of 32 bits. The bits are those of `jax.random` with its default
generator.

Reference: Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3",
SC11, 2011, section 4.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import JaxprEqn

from .elements import NotInKernel, as_elements, is_constant, is_known, objects


_ROTATIONS = (13, 15, 26, 6), (17, 29, 16, 24)
_PARITY = np.uint32(0x1BD11BDA)

Word = Any
"""A word of 32 bits, known or not"""


def threefry(key: tuple[Word, Word], counter: tuple[Word, Word]) -> tuple[Word, Word]:
    """Two words from a key and a counter of two words each."""
    schedule = key[0], key[1], _xor(_xor(key[0], key[1]), _PARITY)
    x, y = _add(counter[0], schedule[0]), _add(counter[1], schedule[1])
    for group in range(5):
        for bits in _ROTATIONS[group % 2]:
            x = _add(x, y)
            y = _xor(x, _xor(_left(y, bits), _right(y, 32 - bits)))
        x = _add(x, schedule[(group + 1) % 3])
        y = _add(_add(y, schedule[(group + 2) % 3]), np.uint32(group + 1))
    return x, y


def seed(equation: JaxprEqn, given: list[np.ndarray]) -> list[np.ndarray]:
    """A key of a known number."""
    if not is_known(given[0]):
        raise NotInKernel("makes a random key of a number that varies: fold it in")
    with jax.ensure_compile_time_eval():
        key = equation.primitive.bind(jnp.asarray(given[0]), **equation.params)
        return [np.asarray(jax.random.key_data(key))]


def fold_in(equation: JaxprEqn, given: list[np.ndarray]) -> list[np.ndarray]:
    _check_generator(equation)
    keys, data = given
    if is_known(data):
        data = as_elements(data.astype(np.uint32))
    words = []
    for key, datum in zip(keys.reshape(-1, 2), data.ravel(), strict=True):
        if not is_constant(datum):
            datum = lax.convert_element_type(datum, np.uint32)
        words += threefry(_words(key), (np.uint32(0), datum))
    return [_array(words, keys.shape)]


def bits(equation: JaxprEqn, given: list[np.ndarray]) -> list[np.ndarray]:
    _check_generator(equation)
    width, shape = equation.params["bit_width"], equation.params["shape"]
    if width not in (32, 64) or given[0].shape != (2,):
        raise NotInKernel(f"draws random numbers of {width} bits")
    key, drawn = _words(given[0]), []
    for count in range(math.prod(shape)):
        high, low = threefry(key, (np.uint32(0), np.uint32(count)))
        drawn.append(_xor(high, low) if width == 32 else _joined(high, low))
    return [_array(drawn, shape)]


def _add(x: Word, y: Word) -> Word:
    if is_constant(x) and is_constant(y):
        return np.uint32((int(x) + int(y)) & 0xFFFFFFFF)
    return lax.add(x, y)


def _xor(x: Word, y: Word) -> Word:
    if is_constant(x) and is_constant(y):
        return np.uint32(int(x) ^ int(y))
    return lax.bitwise_xor(x, y)


def _left(x: Word, bits: int) -> Word:
    if is_constant(x):
        return np.uint32((int(x) << bits) & 0xFFFFFFFF)
    return lax.shift_left(x, np.uint32(bits))


def _right(x: Word, bits: int) -> Word:
    if is_constant(x):
        return np.uint32(int(x) >> bits)
    return lax.shift_right_logical(x, np.uint32(bits))


def _joined(high: Word, low: Word) -> Any:
    """The number of 64 bits of two words."""
    if is_constant(high) and is_constant(low):
        return np.uint64((int(high) << 32) | int(low))
    wide = [lax.convert_element_type(x, np.uint64) for x in (high, low)]
    return lax.bitwise_or(lax.shift_left(wide[0], np.uint64(32)), wide[1])


def _words(key: np.ndarray) -> tuple[Word, Word]:
    first, second = as_elements(key).ravel()
    return first, second


def _array(words: list[Any], shape: Sequence[int]) -> np.ndarray:
    if all(map(is_constant, words)):
        return np.asarray(words).reshape(shape)
    return objects(words, shape)


def _check_generator(equation: JaxprEqn) -> None:
    key: Any = equation.invars[0]
    dtype = key.aval.dtype
    if "fry" not in str(dtype):
        raise NotInKernel(f"draws random numbers with keys of type {dtype}")
