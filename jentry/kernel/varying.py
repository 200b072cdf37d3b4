"""What varies from flight to flight: an analysis of a traced function.

A number of a traced flight is known when the kernel is made, or the flights of a block
share it, or each flight has its own. The analysis is of whole arrays, and does not
overlook that one varies.
"""

import enum
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal


class Varies(enum.IntEnum):
    """How an array of a traced flight varies. The largest of several holds for all."""

    KNOWN = 0
    """Known when the kernel is made"""
    SHARED = 1
    """Computed in the kernel, the same for all flights of a block"""
    EACH = 2
    """Computed in the kernel, with a value for each flight"""


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


def asks_all_flights(equation: JaxprEqn) -> bool:
    """Whether an operation is `any_lane`: one answer for all flights of a block."""
    return equation.primitive.name == "any_lane"


class Analysis:
    """Finds how the outputs of traced functions vary, and remembers it."""

    def __init__(self) -> None:
        self._found: dict[Any, list[Varies]] = {}
        self._loops: dict[Any, tuple[list[Varies], Varies]] = {}
        self._kept: list[Any] = []

    def outputs(self, jaxpr: Jaxpr, inputs: Sequence[Varies]) -> list[Varies]:
        """How each output varies, from how each input does."""
        key = id(jaxpr), tuple(inputs)
        if key not in self._found:
            self._kept.append(jaxpr)  # so that its id is not given to another
            self._found[key] = self._outputs(jaxpr, inputs)
        return self._found[key]

    def _outputs(self, jaxpr: Jaxpr, inputs: Sequence[Varies]) -> list[Varies]:
        found = dict(zip(jaxpr.invars, inputs, strict=True))

        def of(variable: Any) -> Varies:
            if isinstance(variable, Literal):
                return Varies.KNOWN
            return found.get(variable, Varies.KNOWN)

        for equation in jaxpr.eqns:
            given = [of(v) for v in equation.invars]
            most = max(given, default=Varies.KNOWN)
            if most is not Varies.KNOWN:
                outputs = self._of_equation(equation, given)
                found.update(zip(equation.outvars, outputs, strict=True))
        return [of(v) for v in jaxpr.outvars]

    def _of_equation(
        self, equation: JaxprEqn, given: Sequence[Varies]
    ) -> Sequence[Varies]:
        name, most = equation.primitive.name, max(given)
        if asks_all_flights(equation):
            return [Varies.SHARED]
        if (inner := called(equation)) is not None:
            return self.outputs(inner.jaxpr, given)
        if name == "cond":
            return self._of_branches(equation, given)
        if name == "while":
            return self.of_while(equation, given)[0]
        if name == "scan":
            return self.of_scan(equation, given)
        return [most] * len(equation.outvars)

    def _of_branches(
        self, equation: JaxprEqn, given: Sequence[Varies]
    ) -> Sequence[Varies]:
        index, *rest = given
        if index is not Varies.KNOWN:
            # A branch may return what is known to it, which is then that of each flight.
            return [Varies.EACH] * len(equation.outvars)
        every = [self.outputs(b.jaxpr, rest) for b in equation.params["branches"]]
        return [max(each) for each in zip(*every, strict=True)]

    def of_while(
        self, equation: JaxprEqn, given: Sequence[Varies]
    ) -> tuple[list[Varies], Varies]:
        """How the carry and the condition of a loop vary."""
        key = id(equation), tuple(given)
        if key in self._loops:
            return self._loops[key]
        self._kept.append(equation)
        body, condition = equation.params["body_jaxpr"], equation.params["cond_jaxpr"]
        of_condition = equation.params["cond_nconsts"]
        consts = of_condition + equation.params["body_nconsts"]
        same = _unchanged(body.jaxpr, consts - of_condition)
        asked = Varies.KNOWN

        def stepped(carry: list[Varies]) -> list[Varies]:
            nonlocal asked
            asked = self.outputs(condition.jaxpr, [*given[:of_condition], *carry])[0]
            out = self.outputs(body.jaxpr, [*given[of_condition:consts], *carry])
            return [max(x, asked) for x in out]

        carry = _settled(stepped, list(given[consts:]), same)
        self._loops[key] = carry, asked
        return self._loops[key]

    def of_scan(self, equation: JaxprEqn, given: Sequence[Varies]) -> list[Varies]:
        """How the carry and the stacked outputs of a loop of known length vary."""
        body = equation.params["jaxpr"].jaxpr
        consts, carries = equation.params["num_consts"], equation.params["num_carry"]
        fixed, start = list(given[:consts]), list(given[consts : consts + carries])
        # The element is that of an iteration, which is not known.
        rows = [max(x, Varies.SHARED) for x in given[consts + carries :]]
        same = _unchanged(body, consts)[:carries]
        stacked: list[Varies] = []

        def stepped(carry: list[Varies]) -> list[Varies]:
            nonlocal stacked
            out = self.outputs(body, [*fixed, *carry, *rows])
            stacked = out[carries:]
            return out[:carries]

        return _settled(stepped, start, same) + stacked


def _settled(
    stepped: Callable[[list[Varies]], list[Varies]],
    carry: list[Varies],
    same: Sequence[bool],
) -> list[Varies]:
    """How a carry varies, once another iteration changes nothing more."""
    while True:
        out = stepped(carry)
        # What each iteration returns as known is stored as that of each flight, since a
        # kernel has no loop that returns a constant.
        after = [Varies.EACH if x is Varies.KNOWN else x for x in out]
        wider = [
            x if kept else max(x, y)
            for x, y, kept in zip(carry, after, same, strict=True)
        ]
        if wider == carry:
            return carry
        carry = wider


def _unchanged(jaxpr: Jaxpr, consts: int) -> list[bool]:
    """Whether the function returns each input after its constants as it is."""
    origins = _origins(jaxpr)
    return [
        place < len(jaxpr.invars) - consts and origin == place + consts
        for place, origin in enumerate(origins)
    ]


def _origins(jaxpr: Jaxpr) -> list[int | None]:
    """The index of the input that each output is, or None."""
    places: dict[Any, int] = {v: i for i, v in enumerate(jaxpr.invars)}
    for equation in jaxpr.eqns:
        for variable, origin in _passed(equation):
            source = equation.invars[origin]
            if not isinstance(source, Literal) and source in places:
                places[variable] = places[source]
    return [
        None if isinstance(v, Literal) else places.get(v, None) for v in jaxpr.outvars
    ]


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
