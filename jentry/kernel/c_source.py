"""A program of scalars as a function in C, for CUDA and for C99.

Each operation is one line, and each number a variable of its own. Loops are loops, and
branches are branches.
"""

import importlib.resources
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax import lax
from jax.core import ShapedArray
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Primitive

from .control_flow import called
from .elements import NotInKernel, located
from .places import AbstractTables


TYPES = {
    "bool": "bool",
    **{"float64": "f64", "float32": "f32", "int64": "i64", "int32": "i32"},
    **{"uint64": "u64", "uint32": "u32"},
}
"""Types of C by types of NumPy"""

_read_table = Primitive("read_table")


@_read_table.def_abstract_eval
def _of_read(place, *, begin, dtype):
    return ShapedArray((), dtype)


class Tables(AbstractTables):
    """Tables one after another, those of real numbers apart from those of whole ones."""

    def __init__(self) -> None:
        self._begins: dict[Any, int] = {}
        self._parts: dict[str, list[np.ndarray]] = {"reals": [], "wholes": []}

    def read(self, table: np.ndarray, place: Any) -> Any:
        key = table.dtype.str, table.tobytes()
        if key not in self._begins:
            parts = self._parts[_kind(table.dtype)]
            self._begins[key] = sum(map(len, parts))
            parts.append(table)
        return _read_table.bind(
            place, begin=self._begins[key], dtype=np.dtype(table.dtype)
        )

    def stored(self) -> tuple[np.ndarray, np.ndarray]:
        """All real numbers, and all whole ones."""
        reals = np.concatenate([np.zeros(0), *self._parts["reals"]])
        wholes = [x.astype(np.int64) for x in self._parts["wholes"]]
        return reals.astype(float), np.concatenate([np.zeros(0, np.int64), *wholes])


def _kind(dtype: Any) -> str:
    return "reals" if np.issubdtype(dtype, np.floating) else "wholes"


def source_of(program: ClosedJaxpr) -> str:
    """The source of a function `flights` that flies all runs.

    A run has one word of 64 bits for each number, and words lie by number and then by run:
    the threads of a GPU read neighbours. A real number is one of double precision, and a
    whole number or a truth is one of 64 bits.
    """
    writer = _Writer()
    for index, (variable, aval) in enumerate(
        zip(program.jaxpr.invars, program.in_avals, strict=True)
    ):
        c_type = _c_type(aval)
        word = f"given[{index} * runs + run]"
        read = f"of_bits({word})" if _kind(aval.dtype) == "reals" else word
        writer.names[variable] = writer.declared(aval, f"({c_type}){read}")
    constants = zip(program.jaxpr.constvars, program.consts, strict=True)
    for variable, value in constants:
        writer.names[variable] = _literal(value, np.dtype(value.dtype))
    outputs = writer.write(program.jaxpr)
    for index, (name, aval) in enumerate(zip(outputs, program.out_avals, strict=True)):
        word = f"bits_of({name})" if _kind(aval.dtype) == "reals" else f"(i64){name}"
        writer.line(f"found[{index} * runs + run] = {word};")
    return "\n".join([_operations(), _BEFORE, *writer.lines, _AFTER])


def _operations() -> str:
    return (
        importlib.resources.files("jentry.kernel").joinpath("operations.h").read_text()
    )


_ARGUMENTS = (
    "i64 runs, const i64 *given, i64 *found, const f64 *reals, const i64 *wholes"
)

_BEFORE = f"""
INLINE void flight(i64 run, {_ARGUMENTS}) {{"""

_AFTER = f"""}}

#ifdef __CUDACC__
extern "C" __global__ void flights({_ARGUMENTS}) {{
  i64 run = (i64)blockIdx.x * blockDim.x + threadIdx.x;
  if (run < runs) flight(run, runs, given, found, reals, wholes);
}}
#else
void flights({_ARGUMENTS}) {{
  for (i64 run = 0; run < runs; run++) flight(run, runs, given, found, reals, wholes);
}}
#endif
"""


class _Writer:
    """Writes the lines of a program."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.names: dict[Any, str] = {}
        self._count = 0
        self._depth = 1

    def line(self, text: str) -> None:
        self.lines.append("  " * self._depth + text)

    def declared(self, aval: Any, value: str | None = None) -> str:
        """The name of a new variable."""
        self._count += 1
        name = f"x{self._count}"
        start = "" if value is None else f" = {value}"
        self.line(f"{_c_type(aval)} {name}{start};")
        return name

    def write(self, jaxpr: Jaxpr) -> list[str]:
        """The names of the outputs."""
        for equation in jaxpr.eqns:
            given = list(map(self._name, equation.invars))
            try:
                out = self._outputs(equation, given)
            except NotInKernel as error:
                raise located(error, equation) from None
            self.names.update(zip(equation.outvars, out, strict=True))
        return list(map(self._name, jaxpr.outvars))

    def _name(self, variable: Any) -> str:
        if isinstance(variable, Literal):
            return _literal(variable.val, _aval(variable).dtype)
        return self.names[variable]

    def _outputs(self, equation: JaxprEqn, given: list[str]) -> list[str]:
        name, params = equation.primitive.name, equation.params
        if name == "while":
            return self._while(equation, given)
        if name == "cond":
            return self._cond(equation, given)
        if (inner := called(equation)) is not None:
            return self._inlined(inner, given)
        if name in ("broadcast_in_dim", "reshape", "squeeze", "copy", "copy_p"):
            return given  # of a scalar
        aval = _aval(equation.outvars[0])
        if name == "read_table":
            kind = _kind(params["dtype"])
            value = f"({_c_type(aval)}){kind}[{params['begin']} + {given[0]}]"
        else:
            value = _expression(equation, given)
        return [self.declared(aval, value)]

    def _inlined(self, closed: ClosedJaxpr, given: Sequence[str]) -> list[str]:
        jaxpr = closed.jaxpr
        for variable, value in zip(jaxpr.constvars, closed.consts, strict=True):
            self.names[variable] = _literal(value, np.dtype(value.dtype))
        self.names.update(zip(jaxpr.invars, given, strict=True))
        return self.write(jaxpr)

    def _while(self, equation: JaxprEqn, given: list[str]) -> list[str]:
        params = equation.params
        of_condition, of_body = params["cond_nconsts"], params["body_nconsts"]
        start = given[of_condition + of_body :]
        avals = list(map(_aval, equation.outvars))
        carry = [self.declared(a, x) for a, x in zip(avals, start, strict=True)]
        self._open("for (;;) {")
        going = self._inlined(params["cond_jaxpr"], [*given[:of_condition], *carry])[0]
        self.line(f"if (!{going}) break;")
        consts = given[of_condition : of_condition + of_body]
        out = self._inlined(params["body_jaxpr"], [*consts, *carry])
        # All at once: an output may be what another place of the carry was.
        after = [
            self.declared(a, x) if x in carry and x != c else x
            for a, x, c in zip(avals, out, carry, strict=True)
        ]
        self._assign(carry, after)
        self._close()
        return carry

    def _cond(self, equation: JaxprEqn, given: list[str]) -> list[str]:
        index, rest = given[0], given[1:]
        found = [self.declared(_aval(v)) for v in equation.outvars]
        branches = equation.params["branches"]
        for number, branch in enumerate(branches):
            otherwise = "else " if number else ""
            last = number == len(branches) - 1
            asked = "" if last else f"if ({index} == {number}) "
            self._open(f"{otherwise}{asked}{{")
            self._assign(found, self._inlined(branch, rest))
            self._close()
        return found

    def _assign(self, names: Sequence[str], values: Sequence[str]) -> None:
        for name, value in zip(names, values, strict=True):
            if name != value:
                self.line(f"{name} = {value};")

    def _open(self, text: str) -> None:
        self.line(text)
        self._depth += 1

    def _close(self) -> None:
        self._depth -= 1
        self.line("}")


def _aval(variable: Any) -> Any:
    return variable.aval


def _c_type(aval: Any) -> str:
    return _c_name(aval.dtype)


def _c_name(dtype: Any) -> str:
    """The type of C of a type of numbers."""
    name = str(dtype)
    if name not in TYPES:
        raise NotInKernel(f"has a number of type {name}")
    return TYPES[name]


def _literal(value: Any, dtype: Any) -> str:
    """A known number in C, with all its digits."""
    x = np.asarray(value, dtype)[()]
    if np.issubdtype(x.dtype, np.floating):
        if not np.isfinite(x):
            signs = {True: "(-1.0 / 0.0)", False: "(1.0 / 0.0)"}
            return "(0.0 / 0.0)" if np.isnan(x) else signs[bool(x < 0)]
        text = float(x).hex()
        return f"({text}{'f' if x.dtype == np.float32 else ''})"
    if x.dtype == bool:
        return "true" if x else "false"
    if x.dtype == np.uint64:
        return f"{x}ull"
    if int(x) == np.iinfo(np.int64).min:
        return "(-9223372036854775807ll - 1)"
    suffix = "u" if x.dtype == np.uint32 else "ll" if x.dtype == np.int64 else ""
    return f"({x}{suffix})" if x != np.iinfo(np.int32).min else "(-2147483647 - 1)"


_OPERATORS = {
    **{"add": "+", "add_any": "+", "sub": "-", "mul": "*"},
    **{"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="},
    **{"and": "&", "or": "|", "xor": "^"},
}
"""Operations that are operators between two numbers"""

_FUNCTIONS = {
    *("exp", "exp2", "expm1", "log", "log1p", "sqrt", "cbrt", "sin", "cos", "tan"),
    *("asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh"),
    *("atanh", "floor", "ceil", "nextafter", "pow"),
}
"""Operations that are functions of C by the same name"""

_TEXTS = {
    "max": "MAX({0}, {1})",
    "min": "MIN({0}, {1})",
    "neg": "-{0}",
    "sign": "SIGN({0})",
    "rsqrt": "1.0 / sqrt({0})",
    "logistic": "1.0 / (1.0 + exp(-{0}))",
    "is_finite": "isfinite({0})",
    "erf_inv": "erfinv({0})",
    "select_n": "{0} ? {2} : {1}",
}
"""Other operations by what they are in C"""


def _expression(equation: JaxprEqn, given: list[str]) -> str:
    name = equation.primitive.name
    dtype = np.dtype(_aval(equation.invars[0]).dtype)
    if name in _OPERATORS:
        return f"{given[0]} {_OPERATORS[name]} {given[1]}"
    if name in _FUNCTIONS:
        return f"{name}({', '.join(given)})"
    if name in _TEXTS:
        return _TEXTS[name].format(*given)
    if name in _BY_TYPE:
        return _BY_TYPE[name](equation, dtype, *given)
    raise NotInKernel(f"has the operation {name!r}, which a kernel does not know")


def _is_real(dtype: np.dtype) -> bool:
    return np.issubdtype(dtype, np.floating)


def _div(_: JaxprEqn, dtype: np.dtype, x: str, y: str) -> str:
    return f"{x} / {y}" if _is_real(dtype) else _for_whole("QUOTIENT", dtype, x, y)


def _rem(_: JaxprEqn, dtype: np.dtype, x: str, y: str) -> str:
    return (
        f"fmod({x}, {y})" if _is_real(dtype) else _for_whole("REMAINDER", dtype, x, y)
    )


def _for_whole(macro: str, dtype: np.dtype, x: str, y: str) -> str:
    return f"{macro}{'_UNSIGNED' if dtype.kind == 'u' else ''}({x}, {y})"


def _abs(_: JaxprEqn, dtype: np.dtype, x: str) -> str:
    return f"fabs({x})" if _is_real(dtype) else f"{x} < 0 ? -{x} : {x}"


def _not(_: JaxprEqn, dtype: np.dtype, x: str) -> str:
    return f"!{x}" if dtype.kind == "b" else f"~{x}"


def _round(equation: JaxprEqn, _: np.dtype, x: str) -> str:
    method = lax.RoundingMethod(equation.params["rounding_method"])
    to_even = method is lax.RoundingMethod.TO_NEAREST_EVEN
    return f"{'rint' if to_even else 'round'}({x})"


def _convert(equation: JaxprEqn, dtype: np.dtype, x: str) -> str:
    new = np.dtype(_aval(equation.outvars[0]).dtype)
    if new.kind == "b":
        return f"{x} != 0"
    if _is_real(dtype) and not _is_real(new):
        return f"TO_{_c_name(new).upper()}({x})"
    return f"({_c_name(new)}){x}"


def _bitcast(equation: JaxprEqn, dtype: np.dtype, x: str) -> str:
    new = np.dtype(_aval(equation.outvars[0]).dtype)
    if dtype.itemsize != new.itemsize or (dtype.itemsize != 8 and dtype.kind == "f"):
        raise NotInKernel(
            f"takes the bits of a number of type {dtype} for one of {new}"
        )
    bits = f"bits_of({x})" if dtype.kind == "f" else x
    return f"of_bits({bits})" if new.kind == "f" else f"({_c_name(new)}){bits}"


def _shift(macro: str) -> Callable[..., str]:
    def text(_: JaxprEqn, dtype: np.dtype, x: str, bits: str) -> str:
        c_type, size = _c_name(dtype), 8 * dtype.itemsize
        unsigned = c_type if macro == "RIGHT_SIGNED" else c_type.replace("i", "u")
        return f"({c_type}){macro}(({unsigned}){x}, {bits}, {size})"

    return text


_BY_TYPE: dict[str, Callable[..., str]] = {
    "div": _div,
    "rem": _rem,
    "abs": _abs,
    "not": _not,
    "round": _round,
    "convert_element_type": _convert,
    "bitcast_convert_type": _bitcast,
    "shift_left": _shift("LEFT"),
    "shift_right_logical": _shift("RIGHT"),
    "shift_right_arithmetic": _shift("RIGHT_SIGNED"),
    "clamp": lambda _, dtype, low, x, high: (
        f"{x} != {x} ? {x} : {x} < {low} ? {low} : {x} > {high} ? {high} : {x}"
    ),
}
"""Operations that depend on the type of the numbers: text from equation, type, names"""
