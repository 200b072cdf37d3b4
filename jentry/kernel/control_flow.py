"""Loops, branches and solved systems of a traced flight: `Walk` goes through them.

A loop stays a loop, and carries what varies; what each iteration returns as it was given
stays outside. A branch stays a branch if its index varies.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

from . import places
from .elements import NotInKernel, as_elements, is_constant, is_known, objects


if TYPE_CHECKING:
    from .walk import Walk


SHORT = 400
"""A loop of a known number of iterations, without a loop inside, is written out if it has
at most so many operations then: the stages of a Runge-Kutta step stay a loop"""

MOST_WRITTEN_OUT = 64
"""Largest number of iterations of a loop that has to be written out, since it stacks"""

_CALLED = "jaxpr", "call_jaxpr", "fun_jaxpr", "call"
"""Parameters under which an operation that only calls a function has this function"""

_CALLS = {
    *("jit", "pjit", "closed_call", "core_call", "remat2", "checkpoint"),
    *("custom_jvp_call", "custom_vjp_call", "custom_vjp_call_jaxpr"),
    *("custom_vmap_call", "custom_lin"),
}
"""Operations that only call a function, with a rule for derivatives or batches"""


def called(equation: JaxprEqn) -> ClosedJaxpr | None:
    """The function that an operation only calls; None for other operations."""
    if equation.primitive.name not in _CALLS:
        return None
    for name in _CALLED:
        inner = equation.params.get(name)
        if isinstance(inner, ClosedJaxpr):
            return inner
        if isinstance(inner, Jaxpr):
            return ClosedJaxpr(inner, ())
    return None


def while_loop(
    walk: "Walk", equation: JaxprEqn, given: list[np.ndarray]
) -> list[np.ndarray]:
    params = equation.params
    of_condition, of_body = params["cond_nconsts"], params["body_nconsts"]
    condition_consts = given[:of_condition]
    body_consts = given[of_condition : of_condition + of_body]
    carry = _Carry(params["body_jaxpr"].jaxpr, given[of_condition + of_body :], of_body)

    def going(flat: list[Any]) -> Any:
        arrays = [*condition_consts, *carry.arrays(flat)]
        return walk(params["cond_jaxpr"], arrays)[0].ravel()[0]

    def body(flat: list[Any]) -> list[Any]:
        return carry.flat(
            walk(params["body_jaxpr"], [*body_consts, *carry.arrays(flat)])
        )

    return carry.arrays(lax.while_loop(going, body, carry.flat(carry.start)))


def scan(walk: "Walk", equation: JaxprEqn, given: list[np.ndarray]) -> list[np.ndarray]:
    params = equation.params
    consts, carries = _consts_and_carries(equation)
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
        return _written_out(walk, body, fixed, start, rows, order)
    carry = _Carry(body.jaxpr, start, consts)

    def one(loop: tuple[Any, list[Any]]) -> tuple[Any, list[Any]]:
        count, flat = loop
        index = lax.sub(np.int32(length - 1), count) if params["reverse"] else count
        row = [_row(walk, x, index) for x in rows]
        after = walk(body, [*fixed, *carry.arrays(flat), *row])
        return lax.add(count, np.int32(1)), carry.flat(after)

    def going(loop: tuple[Any, list[Any]]) -> Any:
        return lax.lt(loop[0], np.int32(length))

    return carry.arrays(lax.while_loop(going, one, (np.int32(0), carry.flat(start)))[1])


def _consts_and_carries(equation: JaxprEqn) -> tuple[int, int]:
    """How many inputs of a loop are constants, and how many it carries."""
    params = equation.params
    if "num_consts" in params:  # JAX before 0.11
        return params["num_consts"], params["num_carry"]
    consts, carries, _ = params["ft_in"].update(equation.invars).unpack()
    return len(list(consts)), len(list(carries))


def _row(walk: "Walk", array: np.ndarray, index: Any) -> np.ndarray:
    """The row of a known array at an index that counts in the kernel."""
    inner = array.shape[1:]
    rows = (
        places.element_at(walk.tables, array, [index, *map(places.whole, at)])
        for at in np.ndindex(inner)
    )
    return objects(rows, inner)


def _written_out(
    walk: "Walk", body: ClosedJaxpr, fixed, carry, rows, order: range
) -> list[np.ndarray]:
    carries = len(carry)
    stacked: dict[int, list[np.ndarray]] = {}
    for index in order:
        row = [x[index : index + 1].reshape(x.shape[1:]) for x in rows]
        out = walk(body, [*fixed, *carry, *row])
        carry, stacked[index] = out[:carries], out[carries:]
    stacks = []
    for place, variable in enumerate(body.jaxpr.outvars[carries:]):
        column = [stacked[index][place] for index in range(len(order))]
        if all(map(is_known, column)):
            stacks.append(np.stack(column))
            continue
        flat = [e for array in column for e in as_elements(array).ravel()]
        stacks.append(objects(flat, (len(order), *_shape(variable))))
    return [*carry, *stacks]


def cond(walk: "Walk", equation: JaxprEqn, given: list[np.ndarray]) -> list[np.ndarray]:
    branches = equation.params["branches"]
    index, rest = given[0].ravel()[0], given[1:]
    if is_constant(index):
        return walk(branches[min(max(int(index), 0), len(branches) - 1)], rest)

    def branch(closed: ClosedJaxpr):
        return lambda: [_strong(x) for x in walk(closed, rest)]

    index = lax.convert_element_type(index, np.int32)
    out = lax.switch(index, [branch(b) for b in branches])
    shapes = map(_shape, branches[0].jaxpr.outvars)
    return [objects(x, shape) for x, shape in zip(out, shapes, strict=True)]


def linear_solve(
    walk: "Walk", equation: JaxprEqn, given: list[np.ndarray]
) -> list[np.ndarray]:
    system, count = equation.params["system"], equation.params["count"]
    shapes = [jax.ShapeDtypeStruct(_shape(x), _dtype(x)) for x in equation.invars]
    solve = lambda *x: system.solve(list(x[:count]), list(x[count:]))
    return walk(jax.make_jaxpr(solve)(*shapes), given)


def custom_linear_solve(
    walk: "Walk", equation: JaxprEqn, given: list[np.ndarray]
) -> list[np.ndarray]:
    lengths = equation.params["const_lengths"]
    first = lengths.matvec + lengths.vecmat
    consts = given[first : first + lengths.solve]
    right = given[sum(lengths) :]
    return walk(equation.params["jaxprs"].solve, [*consts, *right])


class _Carry:
    """What a loop carries: its arrays, and the elements that vary."""

    def __init__(self, body: Jaxpr, start: Sequence[np.ndarray], consts: int):
        self.start = start
        stays = _unchanged(body, consts)
        self._known = [
            kept and is_known(x)
            for kept, x in zip(stays[: len(start)], start, strict=True)
        ]
        self._dtypes = [
            x.dtype if is_known(x) or not x.size else np.dtype(x.ravel()[0].dtype)
            for x in start
        ]

    def flat(self, arrays: Sequence[np.ndarray]) -> list[Any]:
        """The elements of all arrays that vary, in one list."""
        parts = zip(arrays, self._known, self._dtypes, strict=True)
        return [
            lax.convert_element_type(e, dtype)
            for array, known, dtype in parts
            if not known
            for e in _strong(array)
        ]

    def arrays(self, flat: Sequence[Any]) -> list[np.ndarray]:
        following, out = iter(flat), []
        for before, known in zip(self.start, self._known, strict=True):
            if known:
                out.append(before)
            else:
                elements = (next(following) for _ in range(before.size))
                out.append(objects(elements, before.shape))
        return out


def _strong(array: np.ndarray) -> list[Any]:
    """The elements of an array: a weak type of a number becomes a strong one."""
    return [lax.convert_element_type(e, e.dtype) for e in as_elements(array).ravel()]


def _shape(variable: Any) -> tuple[int, ...]:
    return variable.aval.shape


def _dtype(variable: Any) -> Any:
    return variable.aval.dtype


def _unchanged(jaxpr: Jaxpr, consts: int) -> list[bool]:
    """Whether the function returns each input after its constants as it is."""
    return [origin == place + consts for place, origin in enumerate(_origins(jaxpr))]


def _origins(jaxpr: Jaxpr) -> list[int | None]:
    """The index of the input that each output is, or None."""
    found: dict[Any, int] = {v: i for i, v in enumerate(jaxpr.invars)}
    for equation in jaxpr.eqns:
        for variable, origin in _passed(equation):
            source = equation.invars[origin]
            if not isinstance(source, Literal) and source in found:
                found[variable] = found[source]
    return [None if isinstance(v, Literal) else found.get(v) for v in jaxpr.outvars]


def _passed(equation: JaxprEqn) -> Iterator[tuple[Any, int]]:
    """The outputs of an operation that are one of its inputs, with the index of it."""
    if equation.primitive.name == "side_by_side":
        yield from zip(equation.outvars, range(len(equation.outvars)), strict=True)
    elif (inner := called(equation)) is not None:
        for variable, origin in zip(
            equation.outvars, _origins(inner.jaxpr), strict=True
        ):
            if origin is not None:
                yield variable, origin


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
