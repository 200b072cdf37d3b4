"""A traced flight, carried out number by number.

`Walk` goes through the operations of a traced function. What depends on no flight is
computed at once, with the numbers that are known. For the rest it calls the same operations
of `lax` again, on scalars. Loops stay loops and branches stay branches. So the result is a
program of scalars and of the tables that it reads, which one thread of a GPU can run.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax._src import source_info_util
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

from . import control_flow, linear, places, random_bits
from .control_flow import called
from .elements import (
    PASSED,
    NotInKernel,
    apply,
    as_elements,
    evaluated,
    is_constant,
    is_known,
    located,
    objects,
    of_known,
)
from .places import AbstractTables
from .structure import MOVES, SUMS, chosen


ELEMENTWISE = {
    *("add", "sub", "mul", "div", "rem", "neg", "sign", "abs", "max", "min", "pow"),
    *("eq", "ne", "lt", "le", "gt", "ge", "and", "or", "xor", "not", "add_any"),
    *("floor", "ceil", "round", "is_finite", "nextafter", "clamp", "select_n"),
    *("exp", "exp2", "expm1", "log", "log1p", "logistic", "sqrt", "rsqrt", "cbrt"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "square", "integer_pow"),
    "one_minus_square",
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf_inv"),
    *("shift_left", "shift_right_logical", "shift_right_arithmetic"),
    *("convert_element_type", "bitcast_convert_type"),
    *("lt_to", "le_to", *PASSED),
}
"""Operations that act on each number by itself"""

_KEYS = "random_wrap", "random_unwrap", "random_fold_in", "random_bits", "random_seed"


class Walk:
    """Carries out traced functions for a flight."""

    def __init__(self, tables: AbstractTables):
        self.tables = tables
        """Reads what is known at places that are not"""
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
                # What is traced here has the line of what it is made from.
                with source_info_util.user_context(equation.source_info.traceback):
                    out = self._outputs(equation, inputs)
            except NotInKernel as error:
                raise located(error, equation) from None
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
        if name in _KEYS:
            out = _RULES[name](self, equation, given)
        elif name in ELEMENTWISE:
            out = [of_known(equation, given)]
        else:
            out = evaluated(equation.primitive, given, params)
            out = out if isinstance(out, list) else [out]
        if key is not None:
            self._computed[key] = out
        return out


def _dynamic_slice(walk: Walk, equation: JaxprEqn, given: list[np.ndarray]):
    array, *starts = given
    begins = [s.ravel()[0] for s in starts]
    return [
        places.dynamic_slice(walk.tables, array, begins, equation.params["slice_sizes"])
    ]


def _dynamic_update_slice(walk: Walk, equation: JaxprEqn, given: list[np.ndarray]):
    array, update, *starts = given
    return [places.dynamic_update_slice(array, update, [s.ravel()[0] for s in starts])]


def _gather(walk: Walk, equation: JaxprEqn, given: list[np.ndarray]):
    out_type = _type(equation.outvars[0])
    return [places.gather(walk.tables, *given, **equation.params, out_type=out_type)]


def _scatter(walk: Walk, equation: JaxprEqn, given: list[np.ndarray]):
    return [places.scatter(equation.primitive.name, *given, **equation.params)]


def _same(walk: Walk, equation: JaxprEqn, given: list[np.ndarray]):
    return given


_RULES: dict[str, Callable[..., Sequence[np.ndarray]]] = {
    # A thread of a GPU answers for its own flight: nothing waits for that of others.
    "any_lane": _same,
    "while": control_flow.while_loop,
    "scan": control_flow.scan,
    "cond": control_flow.cond,
    "linear_solve": control_flow.linear_solve,
    "custom_linear_solve": control_flow.custom_linear_solve,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    **dict.fromkeys(places.WRITES, _scatter),
    "lu": lambda walk, equation, given: linear.lu(given[0]),
    "triangular_solve": lambda walk, equation, given: [
        linear.triangular_solve(*given, **equation.params)
    ],
    "random_seed": lambda walk, equation, given: random_bits.seed(equation, given),
    "random_wrap": _same,
    "random_unwrap": _same,
    "random_fold_in": lambda walk, *given: random_bits.fold_in(*given),
    "random_bits": lambda walk, *given: random_bits.bits(*given),
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
        here = lax.eq(which, np.asarray(number, which.dtype)[()])
        found = chosen(here, case, found)
    return found


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


def _last_uses(jaxpr: Jaxpr) -> dict[int, list[Any]]:
    seen = {v for v in jaxpr.outvars if not isinstance(v, Literal)}
    last: dict[int, list[Any]] = {}
    for place in reversed(range(len(jaxpr.eqns))):
        for variable in jaxpr.eqns[place].invars:
            if not isinstance(variable, Literal) and variable not in seen:
                seen.add(variable)
                last.setdefault(place, []).append(variable)
    return last
