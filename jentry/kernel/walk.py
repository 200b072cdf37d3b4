"""A traced flight, carried out for a block of flights side by side, number by number.

`Walk` goes through the operations of a traced function. What depends on no flight is
computed at once, with the numbers that are known. For the rest it calls the same operations
of `lax` again, on scalars and on arrays of shape (block,). Loops stay loops and branches
stay branches. So the result is a program of the kind that Pallas makes a kernel of: it has
no arrays but those of the block, and the tables that it reads.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

from . import linear, places
from .elements import (
    PASSED,
    NotInKernel,
    apply,
    as_elements,
    evaluated,
    is_constant,
    is_known,
    objects,
    of_known,
    spread,
)
from .places import AbstractTables
from .random_bits import threefry
from .structure import MOVES, SUMS, chosen, on_elements
from .varying import Analysis, Varies, asks_all_flights, called


SHORT = 400
"""A loop of a known number of iterations, without a loop inside, is written out if it has
at most so many operations then. A kernel compiles in a time that grows with the square of
their number, so that the stages of a Runge-Kutta step stay a loop"""

MOST_WRITTEN_OUT = 64
"""Largest number of iterations of a loop that has to be written out, since it stacks"""

ELEMENTWISE = {
    *("add", "sub", "mul", "div", "rem", "neg", "sign", "abs", "max", "min", "pow"),
    *("eq", "ne", "lt", "le", "gt", "ge", "and", "or", "xor", "not", "add_any"),
    *("floor", "ceil", "round", "is_finite", "nextafter", "clamp", "select_n"),
    *("exp", "exp2", "expm1", "log", "log1p", "logistic", "sqrt", "rsqrt", "cbrt"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "square", "integer_pow"),
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf_inv"),
    *("shift_left", "shift_right_logical", "shift_right_arithmetic"),
    *("convert_element_type", "bitcast_convert_type", "population_count", "clz"),
    *("lt_to", "le_to", *PASSED),
}
"""Operations that act on each number by itself"""

_KEYS = "random_wrap", "random_unwrap", "random_fold_in", "random_bits", "random_seed"


class Walk:
    """Carries out traced functions for the flights of a block."""

    def __init__(self, tables: AbstractTables, block: int):
        self._tables = tables
        self._block = block
        self._analysis = Analysis()
        self._computed: dict[Any, Any] = {}
        self._uses: dict[int, tuple[Jaxpr, dict[int, list[Any]]]] = {}

    def __call__(
        self, closed: ClosedJaxpr, given: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        """The outputs of a traced function, from arrays that are known or of elements."""
        jaxpr = closed.jaxpr
        values: dict[Any, np.ndarray] = {}
        consts = [_numbers(c) for c in closed.consts]
        values.update(zip(jaxpr.constvars, consts, strict=True))
        values.update(zip(jaxpr.invars, given, strict=True))

        def of(variable: Any) -> np.ndarray:
            if isinstance(variable, Literal):
                return _numbers(variable.val, _type(variable).dtype)
            return values[variable]

        last = self._last_uses(jaxpr)
        for place, equation in enumerate(jaxpr.eqns):
            inputs = [of(v) for v in equation.invars]
            try:
                out = self._outputs(equation, inputs)
            except NotInKernel as error:
                raise _located(error, equation) from None
            values.update(zip(equation.outvars, out, strict=True))
            for variable in last.get(place, ()):
                values.pop(variable, None)
        return [of(v) for v in jaxpr.outvars]

    def _last_uses(self, jaxpr: Jaxpr) -> dict[int, list[Any]]:
        """Variables that no equation after a place needs, by this place."""
        if id(jaxpr) not in self._uses:
            self._uses[id(jaxpr)] = jaxpr, _last_uses(jaxpr)
        return self._uses[id(jaxpr)][1]

    def _outputs(
        self, equation: JaxprEqn, given: list[np.ndarray]
    ) -> Sequence[np.ndarray]:
        name, params = equation.primitive.name, equation.params
        if name in MOVES:
            out = MOVES[name](*given, **params)
            return out if isinstance(out, list) else [out]
        if (inner := called(equation)) is not None:
            return self(inner, given)
        if all(map(is_known, given)):
            return self._of_known(equation, given)
        if name in ELEMENTWISE:
            return [_each(equation, given)]
        if name in SUMS:
            return [SUMS[name](*map(as_elements, given), **params)]
        if asks_all_flights(equation):
            return [objects([self._any(x) for x in given[0].ravel()], given[0].shape)]
        rule = _RULES.get(name)
        if rule is None:
            raise NotInKernel(
                f"has the operation {name!r}, which a kernel does not know"
            )
        return rule(self, equation, given)

    def _of_known(self, equation: JaxprEqn, given: list[np.ndarray]):
        """Results of known numbers, each computed once: loops written out repeat them."""
        name, params = equation.primitive.name, equation.params
        key = None
        if name not in ("while", "scan", "cond"):
            key = (
                name,
                str(params),
                *((x.dtype.str, x.shape, x.tobytes()) for x in given),
            )
            if key in self._computed:
                return self._computed[key]
        if asks_all_flights(equation):
            out = given
        elif name in _KEYS:
            out = _RULES[name](self, equation, given)
        elif name in ELEMENTWISE:
            out = [of_known(equation, given)]
        else:
            out = evaluated(equation.primitive, given, params)
            out = out if isinstance(out, list) else [out]
        if key is not None:
            self._computed[key] = out
        return out

    def _any(self, condition: Any) -> Any:
        """Whether a condition holds for any flight of the block."""
        if np.ndim(condition) == 0:
            return condition
        return jnp.max(lax.convert_element_type(condition, np.int32)) > 0

    def _levels(self, arrays: Sequence[np.ndarray]) -> list[Varies]:
        return [_varies(x) for x in arrays]

    def _fits(self, array: np.ndarray, varies: Varies) -> list[Any]:
        """The elements of an array, in the shape that their kind has in a loop."""
        # The conversion leaves the number as it is, and makes a strong type of a weak one.
        elements = [
            lax.convert_element_type(e, e.dtype) for e in as_elements(array).ravel()
        ]
        if varies is Varies.EACH:
            return [spread(e, self._block) for e in elements]
        return elements

    def _while(self, equation: JaxprEqn, given: list[np.ndarray]):
        params = equation.params
        of_condition, of_body = params["cond_nconsts"], params["body_nconsts"]
        condition_consts = given[:of_condition]
        body_consts = given[of_condition : of_condition + of_body]
        start = given[of_condition + of_body :]
        levels, asked = self._analysis.of_while(equation, self._levels(given))
        carry = _Carry(self, start, levels)

        def asks(arrays: Sequence[np.ndarray]) -> Any:
            return self(params["cond_jaxpr"], [*condition_consts, *arrays])[0].ravel()[
                0
            ]

        def body(arrays: Sequence[np.ndarray]) -> list[np.ndarray]:
            return self(params["body_jaxpr"], [*body_consts, *arrays])

        if asked is not Varies.EACH:

            def shared(flat):
                return carry.flat(body(carry.arrays(flat)))

            out = lax.while_loop(
                lambda flat: asks(carry.arrays(flat)), shared, carry.flat(start)
            )
            return carry.arrays(out)

        def going(arrays: Sequence[np.ndarray]) -> Any:
            return spread(asks(arrays), self._block)

        def some(loop):
            goes, flat = loop
            after = carry.flat(body(carry.arrays(flat)))
            flat = [
                chosen(goes, new, old) for new, old in zip(after, flat, strict=True)
            ]
            return lax.bitwise_and(goes, going(carry.arrays(flat))), flat

        loop = going(start), carry.flat(start)
        _, out = lax.while_loop(lambda loop: self._any(loop[0]), some, loop)
        return carry.arrays(out)

    def _scan(self, equation: JaxprEqn, given: list[np.ndarray]):
        params = equation.params
        consts, carries = params["num_consts"], params["num_carry"]
        length, body = params["length"], params["jaxpr"]
        fixed, start = given[:consts], given[consts : consts + carries]
        rows = given[consts + carries :]
        order = range(length)[::-1] if params["reverse"] else range(length)
        stacks = len(body.jaxpr.outvars) > carries
        must = stacks or not all(map(is_known, rows))
        short = length * _size(body.jaxpr) <= SHORT and not _has_loop(body.jaxpr)
        if must or short:
            if must and length > MOST_WRITTEN_OUT:
                raise NotInKernel(
                    f"has a loop of {length} iterations with an array of a flight for "
                    f"each; a kernel takes {MOST_WRITTEN_OUT}"
                )
            return self._written_out(body, fixed, start, rows, order)
        levels = self._analysis.of_scan(equation, self._levels(given))[:carries]
        carry = _Carry(self, start, levels)

        def one(loop):
            count, flat = loop
            index = lax.sub(np.int32(length - 1), count) if params["reverse"] else count
            row = [self._row(x, index) for x in rows]
            after = self(body, [*fixed, *carry.arrays(flat), *row])
            return lax.add(count, np.int32(1)), carry.flat(after)

        loop = np.int32(0), carry.flat(start)
        _, out = lax.while_loop(
            lambda loop: lax.lt(loop[0], np.int32(length)), one, loop
        )
        return carry.arrays(out)

    def _row(self, array: np.ndarray, index: Any) -> np.ndarray:
        """The row of a known array at an index that counts in the kernel."""
        inner = array.shape[1:]
        rows = (
            places.element_at(self._tables, array, [index, *map(places.whole, at)])
            for at in np.ndindex(inner)
        )
        return objects(rows, inner)

    def _written_out(self, body: ClosedJaxpr, fixed, carry, rows, order: range):
        carries = len(carry)
        stacked: dict[int, list[np.ndarray]] = {}
        for index in order:
            row = [x[index : index + 1].reshape(x.shape[1:]) for x in rows]
            out = self(body, [*fixed, *carry, *row])
            carry, stacked[index] = out[:carries], out[carries:]
        stacks = []
        for place, variable in enumerate(body.jaxpr.outvars[carries:]):
            column = [stacked[index][place] for index in range(len(order))]
            if all(map(is_known, column)):
                stacks.append(np.stack(column))
                continue
            flat = [e for array in column for e in as_elements(array).ravel()]
            stacks.append(objects(flat, (len(order), *_type(variable).shape)))
        return [*carry, *stacks]

    def _cond(self, equation: JaxprEqn, given: list[np.ndarray]):
        branches = equation.params["branches"]
        index, rest = given[0].ravel()[0], given[1:]
        if is_constant(index):
            return self(branches[min(max(int(index), 0), len(branches) - 1)], rest)
        if np.ndim(index) > 0:
            return self._all_branches(branches, index, rest)
        shapes = [_type(v).shape for v in branches[0].jaxpr.outvars]

        def branch(closed: ClosedJaxpr):
            def act():
                out = self(closed, rest)
                return [self._fits(x, Varies.EACH) for x in out]

            return act

        index = lax.convert_element_type(index, np.int32)
        if len(branches) == 2:
            out = lax.cond(index == 0, branch(branches[0]), branch(branches[1]))
        else:
            out = lax.switch(index, [branch(b) for b in branches])
        return [objects(x, shape) for x, shape in zip(out, shapes, strict=True)]

    def _all_branches(self, branches, index: Any, rest):
        out = self(branches[0], rest)
        index = lax.convert_element_type(index, np.int32)
        for number, branch in enumerate(branches[1:], 1):
            here = on_elements(
                lax.ge if number == len(branches) - 1 else lax.eq,
                index,
                np.int32(number),
            )
            found = zip(self(branch, rest), out, strict=True)
            out = [_chosen(here, new, old) for new, old in found]
        return out

    def _linear_solve(self, equation: JaxprEqn, given: list[np.ndarray]):
        system, count = equation.params["system"], equation.params["count"]
        shapes = [
            jax.ShapeDtypeStruct(_type(v).shape, _type(v).dtype)
            for v in equation.invars
        ]
        solve = lambda *x: system.solve(list(x[:count]), list(x[count:]))
        return self(jax.make_jaxpr(solve)(*shapes), given)

    def _custom_linear_solve(self, equation: JaxprEqn, given: list[np.ndarray]):
        lengths = equation.params["const_lengths"]
        first = lengths.matvec + lengths.vecmat
        consts = given[first : first + lengths.solve]
        right = given[sum(lengths) :]
        return self(equation.params["jaxprs"].solve, [*consts, *right])

    def _dynamic_slice(self, equation: JaxprEqn, given: list[np.ndarray]):
        array, *starts = given
        begins = [s.ravel()[0] for s in starts]
        sizes = equation.params["slice_sizes"]
        return [places.dynamic_slice(self._tables, array, begins, sizes)]

    def _dynamic_update_slice(self, equation: JaxprEqn, given: list[np.ndarray]):
        array, update, *starts = given
        begins = [s.ravel()[0] for s in starts]
        return [places.dynamic_update_slice(array, update, begins)]

    def _gather(self, equation: JaxprEqn, given: list[np.ndarray]):
        out_type = equation.outvars[0].aval
        return [
            places.gather(self._tables, *given, **equation.params, out_type=out_type)
        ]

    def _scatter(self, equation: JaxprEqn, given: list[np.ndarray]):
        return [places.scatter(equation.primitive.name, *given, **equation.params)]

    def _lu(self, equation: JaxprEqn, given: list[np.ndarray]):
        return linear.lu(given[0])

    def _triangular_solve(self, equation: JaxprEqn, given: list[np.ndarray]):
        return [linear.triangular_solve(*given, **equation.params)]

    def _random_seed(self, equation: JaxprEqn, given: list[np.ndarray]):
        if not is_known(given[0]):
            raise NotInKernel("makes a random key of a number that varies: fold it in")
        with jax.ensure_compile_time_eval():
            key = equation.primitive.bind(jnp.asarray(given[0]), **equation.params)
            return [np.asarray(jax.random.key_data(key))]

    def _random_same(self, equation: JaxprEqn, given: list[np.ndarray]):
        return given

    def _random_fold_in(self, equation: JaxprEqn, given: list[np.ndarray]):
        _check_generator(_type(equation.invars[0]).dtype)
        keys, data = given
        data = _converted(data, np.uint32)
        words = [
            threefry(Words, _words(key), (np.uint32(0), datum))
            for key, datum in zip(keys.reshape(-1, 2), data.ravel(), strict=True)
        ]
        return [_from_words([w for pair in words for w in pair], keys.shape)]

    def _random_bits(self, equation: JaxprEqn, given: list[np.ndarray]):
        _check_generator(_type(equation.invars[0]).dtype)
        bits, shape = equation.params["bit_width"], equation.params["shape"]
        if bits not in (32, 64) or given[0].shape != (2,):
            raise NotInKernel(f"draws random numbers of {bits} bits")
        key, drawn = _words(given[0]), []
        for count in range(math.prod(shape)):
            high, low = threefry(Words, key, (np.uint32(0), np.uint32(count)))
            drawn.append(
                Words.xor(high, low) if bits == 32 else Words.joined(high, low)
            )
        return [_from_words(drawn, shape)]


class _Carry:
    """What a loop carries: its arrays, and the elements that JAX sees of them."""

    def __init__(
        self, walk: Walk, start: Sequence[np.ndarray], levels: Sequence[Varies]
    ):
        self._walk = walk
        self._start = start
        self._levels = levels
        self._dtypes = [
            x.dtype if is_known(x) or not x.size else np.dtype(x.ravel()[0].dtype)
            for x in start
        ]

    def flat(self, arrays: Sequence[np.ndarray]) -> list[Any]:
        flat = []
        for array, level, dtype in zip(arrays, self._levels, self._dtypes, strict=True):
            if level is not Varies.KNOWN:
                fitting = self._walk._fits(array, level)
                flat += [lax.convert_element_type(e, dtype) for e in fitting]
        return flat

    def arrays(self, flat: Sequence[Any]) -> list[np.ndarray]:
        following, out = iter(flat), []
        for before, level in zip(self._start, self._levels, strict=True):
            if level is Varies.KNOWN:
                out.append(before)
            else:
                elements = (next(following) for _ in range(before.size))
                out.append(objects(elements, before.shape))
        return out


class Words:
    """Operations on words of 32 bits, known or not."""

    @staticmethod
    def add(x: Any, y: Any) -> Any:
        if is_constant(x) and is_constant(y):
            return np.uint32((int(x) + int(y)) & 0xFFFFFFFF)
        return on_elements(lax.add, x, y)

    @staticmethod
    def xor(x: Any, y: Any) -> Any:
        if is_constant(x) and is_constant(y):
            return np.uint32(int(x) ^ int(y))
        return on_elements(lax.bitwise_xor, x, y)

    @staticmethod
    def left(x: Any, bits: int) -> Any:
        if is_constant(x):
            return np.uint32((int(x) << bits) & 0xFFFFFFFF)
        return on_elements(lax.shift_left, x, np.uint32(bits))

    @staticmethod
    def right(x: Any, bits: int) -> Any:
        if is_constant(x):
            return np.uint32(int(x) >> bits)
        return on_elements(lax.shift_right_logical, x, np.uint32(bits))

    @staticmethod
    def joined(high: Any, low: Any) -> Any:
        if is_constant(high) and is_constant(low):
            return np.uint64((int(high) << 32) | int(low))
        wide = [lax.convert_element_type(x, np.uint64) for x in (high, low)]
        up = on_elements(lax.shift_left, wide[0], np.uint64(32))
        return on_elements(lax.bitwise_or, up, wide[1])


def _words(key: np.ndarray) -> tuple[Any, Any]:
    first, second = as_elements(key).ravel()
    return first, second


def _from_words(words: list[Any], shape: Sequence[int]) -> np.ndarray:
    if all(map(is_constant, words)):
        return np.asarray(words).reshape(shape)
    return objects(words, shape)


def _converted(array: np.ndarray, dtype: Any) -> np.ndarray:
    if is_known(array):
        return as_elements(array.astype(dtype))
    flat = (lax.convert_element_type(e, dtype) for e in array.ravel())
    return objects(flat, array.shape)


def _check_generator(dtype: Any) -> None:
    if "fry" not in str(dtype):
        raise NotInKernel(f"draws random numbers with keys of type {dtype}")


_RULES: dict[str, Callable[..., Sequence[np.ndarray]]] = {
    "while": Walk._while,
    "scan": Walk._scan,
    "cond": Walk._cond,
    "linear_solve": Walk._linear_solve,
    "custom_linear_solve": Walk._custom_linear_solve,
    "dynamic_slice": Walk._dynamic_slice,
    "dynamic_update_slice": Walk._dynamic_update_slice,
    "gather": Walk._gather,
    **dict.fromkeys(places.WRITES, Walk._scatter),
    "lu": Walk._lu,
    "triangular_solve": Walk._triangular_solve,
    "random_seed": Walk._random_seed,
    "random_wrap": Walk._random_same,
    "random_unwrap": Walk._random_same,
    "random_fold_in": Walk._random_fold_in,
    "random_bits": Walk._random_bits,
}


def _each(equation: JaxprEqn, given: Sequence[np.ndarray]) -> np.ndarray:
    """An operation on each number of arrays, of which one is not known."""
    shape = _type(equation.outvars[0]).shape
    arrays = [np.broadcast_to(as_elements(x), shape).ravel() for x in given]
    return objects((_one(equation, row) for row in zip(*arrays, strict=True)), shape)


def _one(equation: JaxprEqn, row: tuple[Any, ...]) -> Any:
    if all(map(is_constant, row)):
        return of_known(equation, [np.asarray(x) for x in row])[()]
    if equation.primitive.name == "select_n":
        return _selected(row[0], row[1:])
    return apply(equation, row)


def _selected(which: Any, cases: Sequence[Any]) -> Any:
    if is_constant(which):
        return cases[int(which)]
    if len(cases) == 2:
        if cases[0] is cases[1]:
            return cases[0]
        if which.dtype == bool:
            return chosen(which, cases[1], cases[0])
    found = cases[0]
    for number, case in enumerate(cases[1:], 1):
        here = on_elements(lax.eq, which, np.asarray(number, which.dtype)[()])
        found = chosen(here, case, found)
    return found


def _chosen(here: Any, x: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    if is_known(x) and is_known(otherwise) and np.array_equal(x, otherwise):
        return x
    pairs = zip(as_elements(x).ravel(), as_elements(otherwise).ravel(), strict=True)
    return objects((a if a is b else chosen(here, a, b) for a, b in pairs), x.shape)


def _numbers(value: Any, dtype: Any = None) -> np.ndarray:
    """A constant of a traced function as an array of numbers."""
    if isinstance(value, jax.Array) and jnp.issubdtype(
        value.dtype, jax.dtypes.prng_key
    ):
        return np.asarray(jax.random.key_data(value))
    return np.asarray(value, dtype)


def _type(variable: Any) -> Any:
    """Shape and type of a variable of a traced function."""
    return variable.aval


def _varies(array: np.ndarray) -> Varies:
    if is_known(array):
        return Varies.KNOWN
    each = any(np.ndim(e) > 0 for e in array.ravel())
    return Varies.EACH if each else Varies.SHARED


def _has_loop(jaxpr: Jaxpr) -> bool:
    for equation in jaxpr.eqns:
        if equation.primitive.name in ("while", "scan"):
            return True
        if (inner := called(equation)) is not None and _has_loop(inner.jaxpr):
            return True
        if any(_has_loop(b.jaxpr) for b in equation.params.get("branches", ())):
            return True
    return False


def _size(jaxpr: Jaxpr) -> int:
    """Number of operations, with those of the functions that are called."""
    inner = (called(equation) for equation in jaxpr.eqns)
    return len(jaxpr.eqns) + sum(_size(x.jaxpr) for x in inner if x is not None)


def _last_uses(jaxpr: Jaxpr) -> dict[int, list[Any]]:
    seen = {v for v in jaxpr.outvars if not isinstance(v, Literal)}
    last: dict[int, list[Any]] = {}
    for place in reversed(range(len(jaxpr.eqns))):
        for variable in jaxpr.eqns[place].invars:
            if not isinstance(variable, Literal) and variable not in seen:
                seen.add(variable)
                last.setdefault(place, []).append(variable)
    return last


def _located(error: NotInKernel, equation: JaxprEqn) -> NotInKernel:
    """The error with the line of the innermost operation that caused it."""
    if error.located:
        return error
    from jax._src import source_info_util

    frame = source_info_util.user_frame(equation.source_info.traceback)
    if frame is None:
        return error
    located = NotInKernel(f"{error} ({frame.file_name}:{frame.start_line})")
    located.located = True
    return located
