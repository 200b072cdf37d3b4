"""Functions of one flight as kernels, of which each thread flies one flight."""

import functools
import math
from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr
from jaxtyping import PyTree

from .c_source import Tables, source_of
from .compiled import OnGpu, OnProcessor
from .elements import NotInKernel, as_elements, objects
from .places import AbstractTables
from .walk import Walk


Form = Literal["gpu", "c", "xla"]
"""A kernel in CUDA for a GPU; the same source as a program in C for the processor, for
tests; or its operations, compiled by XLA for any device, for tests without a compiler"""


def kernel_of(
    function: Callable[[Any], Any], example: PyTree, *, form: Form = "gpu"
) -> Callable[[PyTree], PyTree]:
    """A function of many flights, of which each is one thread of a kernel.

    The kernel is made from the operations of the traced function: there is no other
    version of any equation. What it does not know it refuses.

    **Arguments:**

    - `function`: a function of one run, a pytree of arrays, that returns a pytree of
      arrays. The numbers that it closes over are written into the kernel.
    - `example`: a run, or shapes and types of one (`jax.ShapeDtypeStruct`).
    - `form`: "gpu", "c" (needs the command `cc`) or "xla".

    Returns a function of runs of shape (runs, ...). It takes arrays and not traced ones.

    **Raises:** `NotInKernel` for an operation that a kernel cannot do, with its line in
    the source; `RuntimeError` where there is no compiler.
    """
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(example)
    structure = jax.tree.structure(shapes)
    program = _Program(closed)
    fly = _by_xla(program) if form == "xla" else _by_source(program, form)

    def act(runs: PyTree) -> PyTree:
        if jax.tree.structure(runs) != jax.tree.structure(example):
            raise ValueError(
                f"runs have the structure {jax.tree.structure(runs)}: it must be that of "
                f"the example, {jax.tree.structure(example)}"
            )
        return jax.tree.unflatten(structure, fly(jax.tree.leaves(runs)))

    return act


class _Program:
    """The program of a run, number by number."""

    def __init__(self, closed: ClosedJaxpr):
        self._closed = closed
        self.inputs = closed.in_avals
        self.outputs = closed.out_avals

    def __call__(self, tables: AbstractTables, numbers: list[Any]) -> list[Any]:
        """All numbers of the results, from all numbers of the run."""
        following, given = iter(numbers), []
        for aval in self.inputs:
            elements = (next(following) for _ in range(_size(aval)))
            given.append(objects(elements, _shape(aval)))
        out = Walk(tables)(self._closed, given)
        return [
            lax.convert_element_type(e, aval.dtype)
            for array, aval in zip(out, self.outputs, strict=True)
            for e in as_elements(array).ravel()
        ]

    def traced(self, tables: AbstractTables) -> ClosedJaxpr:
        numbers = [
            jax.ShapeDtypeStruct((), aval.dtype)
            for aval in self.inputs
            for _ in range(_size(aval))
        ]
        return jax.make_jaxpr(functools.partial(self, tables))(numbers)


def _shape(aval: Any) -> tuple[int, ...]:
    return aval.shape


def _size(aval: Any) -> int:
    return math.prod(aval.shape)


class _InPlace(AbstractTables):
    """Reads tables that are constants of a program of XLA."""

    def read(self, table: np.ndarray, place: Any) -> Any:
        return jnp.take(jnp.asarray(table), place, mode="clip")


def _by_xla(program: _Program) -> Callable[[list[Any]], list[Any]]:
    def one(leaves: list[Any]) -> list[Any]:
        numbers = [x.ravel()[i] for x in leaves for i in range(x.size)]
        out = iter(program(_InPlace(), numbers))
        return [
            jnp.stack([next(out) for _ in range(_size(a))]).reshape(a.shape)
            if _size(a)
            else jnp.zeros(a.shape, a.dtype)
            for a in program.outputs
        ]

    # One run after another, as in C. Over a vector of runs, the loop vectorizer of LLVM
    # that JAX 0.11 has (`onlyFirstLaneUsed`) follows every path from an operation to the
    # results. Each of the 20 rounds of Threefry-2x32 at least doubles their number.
    act = jax.jit(functools.partial(lax.map, one))
    return lambda leaves: act(list(map(jnp.asarray, leaves)))


def _by_source(program: _Program, form: Form) -> Callable[[list[Any]], list[Any]]:
    tables = Tables()
    source = source_of(program.traced(tables))
    compiled = (OnGpu if form == "gpu" else OnProcessor)(source, *tables.stored())

    def fly(leaves: list[Any]) -> list[Any]:
        arrays = compiled.arrays
        count = len(leaves[0])
        given = arrays.empty((sum(map(_size, program.inputs)), count), np.int64)
        begin = 0
        for leaf, aval in zip(leaves, program.inputs, strict=True):
            end = begin + _size(aval)
            rows = compiled.taken(leaf).reshape(count, -1).T
            if np.issubdtype(aval.dtype, np.floating):
                given[begin:end].view(np.float64)[:] = rows
            else:
                given[begin:end] = rows
            begin = end
        found = arrays.empty((sum(map(_size, program.outputs)), count), np.int64)
        compiled.fly(count, given, found)
        out, begin = [], 0
        for aval in program.outputs:
            end = begin + _size(aval)
            rows = found[begin:end]
            if np.issubdtype(aval.dtype, np.floating):
                rows = rows.view(np.float64)
            shaped = rows.T.reshape(count, *_shape(aval)).astype(aval.dtype)
            out.append(compiled.given_back(shaped))
            begin = end
        return out

    return fly


__all__ = "Form", "NotInKernel", "kernel_of"
