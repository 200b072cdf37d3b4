"""Functions of one flight as kernels that fly blocks of flights."""

import functools
import math
from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr
from jaxtyping import PyTree

from .elements import NotInKernel, as_elements, objects, spread
from .places import AbstractTables
from .walk import Walk


Form = Literal["gpu", "interpreted", "plain"]
"""A kernel for a GPU; the same one, interpreted by XLA on any device, for tests; or its
program as XLA compiles it, without a kernel"""

BLOCK = 32
"""Flights of a block: one warp of a GPU, so that no flight waits for those of others"""

MOST_SECONDS = 120.0
"""Time that Triton may take for a kernel, as estimated from the kernel's size"""

_SECONDS = 1e-8
"""Time of Triton by accesses to memory and square of operations, s"""


def kernel_of(
    function: Callable[[Any], Any],
    example: PyTree,
    *,
    block: int = BLOCK,
    form: Form = "gpu",
) -> Callable[[PyTree], PyTree]:
    """A function of many flights, of which each block is one program of a kernel.

    The kernel is made from the operations of the traced function: there is no other
    version of any equation. What it does not know it refuses.

    **Arguments:**

    - `function`: a function of one run, a pytree of arrays, that returns a pytree of
      arrays. The numbers that it closes over are written into the kernel.
    - `example`: a run, or shapes and types of one (`jax.ShapeDtypeStruct`).
    - `block`: number of flights side by side, a power of two.
    - `form`: "gpu", "interpreted" or "plain".

    Returns a function of runs of shape (runs, ...).

    **Raises:** `NotInKernel` for an operation that a kernel cannot do, with its line in
    the source.
    """
    if block < 1 or block & (block - 1):
        raise ValueError(f"block is {block}: it must be a power of two")
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(example)
    structure = jax.tree.structure(shapes)
    program = _Program(closed, block)
    collected = _Collected()
    shapes_of_block = [jax.ShapeDtypeStruct((block,), d) for d in program.inputs]
    traced = jax.make_jaxpr(functools.partial(program, collected))(shapes_of_block)
    if form == "gpu":
        _check_compile_time(traced, collected)
    run = _FORMS[form](program, collected)

    def fly(runs: PyTree) -> PyTree:
        leaves = [jnp.asarray(x) for x in jax.tree.leaves(runs)]
        count = leaves[0].shape[0]
        filled = -(-count // block) * block
        # Flights of the runs themselves fill the last block.
        place = jnp.arange(filled) % count
        rows = [
            jnp.take(x.reshape(count, -1), place, 0)[:, i]
            for x in leaves
            for i in range(math.prod(x.shape[1:]))
        ]
        out = iter(run(rows, filled))
        flown = []
        for shape in closed.out_avals:
            size = math.prod(shape.shape)
            columns = [next(out)[:count] for _ in range(size)]
            stacked = jnp.stack(columns, -1) if columns else jnp.zeros((count, 0))
            flown.append(stacked.reshape(count, *shape.shape).astype(shape.dtype))
        return jax.tree.unflatten(structure, flown)

    return fly


def _check_compile_time(traced: ClosedJaxpr, collected: "_Collected") -> None:
    """Refuse a kernel that Triton would compile for too long.

    One of its passes (`TritonGPUCoalesce`) looks, for each access to memory, at every
    operation from every other one.
    """
    operations = _operations(traced.jaxpr)
    accesses = collected.reads + len(traced.in_avals) + len(traced.out_avals)
    seconds = _SECONDS * accesses * operations**2
    if seconds > MOST_SECONDS:
        raise NotInKernel(
            f"has {operations} operations and {accesses} accesses to memory, for which "
            f"Triton would need some {seconds / 60.0:.0f} minutes; a kernel may take "
            f"{MOST_SECONDS / 60.0:.0f}"
        )


def _operations(jaxpr: Jaxpr) -> int:
    """Number of operations of a program, with those of its loops and branches."""
    inner = (
        x.jaxpr if isinstance(x, ClosedJaxpr) else x
        for equation in jaxpr.eqns
        for value in equation.params.values()
        for x in (value if isinstance(value, tuple | list) else [value])
        if isinstance(x, ClosedJaxpr | Jaxpr)
    )
    return len(jaxpr.eqns) + sum(map(_operations, inner))


class _Program:
    """The program of one block: a function of arrays of shape (block,)."""

    def __init__(self, closed: ClosedJaxpr, block: int):
        self.closed = closed
        self.block = block
        self.inputs = _columns(closed.in_avals)
        self.outputs = _columns(closed.out_avals)

    def __call__(self, tables: Any, rows: list[Any]) -> list[Any]:
        """Results of shape (block,) each, from inputs of this shape."""
        following, given = iter(rows), []
        for aval in self.closed.in_avals:
            elements = (next(following) for _ in range(math.prod(aval.shape)))
            given.append(objects(elements, aval.shape))
        out = Walk(tables, self.block)(self.closed, given)
        flat = [e for array in out for e in as_elements(array).ravel()]
        return [
            spread(lax.convert_element_type(e, dtype), self.block)
            for e, dtype in zip(flat, self.outputs, strict=True)
        ]


def _columns(avals: Any) -> list[np.dtype]:
    """The type of each number of a run. A truth is stored as a whole number."""
    return [
        np.dtype(np.int32) if aval.dtype == bool else np.dtype(aval.dtype)
        for aval in avals
        for _ in range(math.prod(aval.shape))
    ]


class _Collected(AbstractTables):
    """Tables that a program reads, by their contents."""

    def __init__(self) -> None:
        self.tables: list[np.ndarray] = []
        self.reads = 0
        """Number of operations that read a table"""
        self._places: dict[Any, int] = {}

    def place_of(self, table: np.ndarray) -> int:
        key = table.dtype.str, table.tobytes()
        if key not in self._places:
            self._places[key] = len(self.tables)
            self.tables.append(table)
        return self._places[key]

    def read(self, table: np.ndarray, place: Any) -> Any:
        self.place_of(table)
        self.reads += 1
        return jnp.take(jnp.asarray(table), place, mode="clip")


class _Read(AbstractTables):
    """Reads tables through references."""

    def __init__(self, collected: _Collected, references: Any):
        self._collected = collected
        self._references = references

    def read(self, table: np.ndarray, place: Any) -> Any:
        return self._references[self._collected.place_of(table)][place]


def _plain(program: _Program, collected: _Collected) -> Callable[..., list[Any]]:
    def run(rows: list[Any], count: int) -> list[Any]:
        blocks = [x.reshape(-1, program.block) for x in rows]
        out = lax.map(functools.partial(program, collected), blocks)
        return [x.reshape(-1) for x in out]

    return jax.jit(run, static_argnums=1)


def _pallas(
    program: _Program, collected: _Collected, interpret: bool
) -> Callable[..., list[Any]]:
    from jax.experimental import pallas

    block = program.block
    # A reference has at least one number, and a truth is stored as a whole number.
    tables = [_stored(x) for x in collected.tables]
    params: dict[str, Any] = {"interpret": True}
    if not interpret:
        from jax.experimental.pallas import triton

        warps = max(block // 32, 1)
        options = triton.CompilerParams(num_warps=warps, num_stages=1)
        params = {"compiler_params": options}

    def body(*references: Any) -> None:
        inputs = references[: len(program.inputs)]
        of_tables = references[len(inputs) : len(inputs) + len(tables)]
        outputs = references[len(inputs) + len(tables) :]
        reads = _Read(collected, of_tables)
        out = program(reads, [reference[...] for reference in inputs])
        for reference, value in zip(outputs, out, strict=True):
            reference[...] = value

    def run(rows: list[Any], count: int) -> list[Any]:
        own = pallas.BlockSpec((block,), lambda i: (i,))
        whole = pallas.BlockSpec(memory_space=pallas.ANY)
        if interpret:
            in_tables = [pallas.BlockSpec(x.shape, lambda i: (0,)) for x in tables]
        else:
            in_tables = [whole] * len(tables)
        call = pallas.pallas_call(
            body,
            out_shape=[jax.ShapeDtypeStruct((count,), d) for d in program.outputs],
            grid=(count // block,),
            in_specs=[own] * len(rows) + in_tables,
            out_specs=[own] * len(program.outputs),
            **params,
        )
        return list(call(*rows, *map(jnp.asarray, tables)))

    return jax.jit(run, static_argnums=1)


def _stored(table: np.ndarray) -> np.ndarray:
    return table.astype(np.int32) if table.dtype == bool else table


_FORMS: dict[str, Callable[[_Program, _Collected], Callable[..., list[Any]]]] = {
    "plain": _plain,
    "interpreted": functools.partial(_pallas, interpret=True),
    "gpu": functools.partial(_pallas, interpret=False),
}

__all__ = "BLOCK", "Form", "NotInKernel", "kernel_of"
