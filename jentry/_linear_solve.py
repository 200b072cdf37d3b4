"""The solution of a linear system, differentiable to any order, traced only as needed.

`lax.custom_linear_solve` traces and batches the equations, their transpose and both
solutions at each call. A derivative of first order needs one of the four. If the equations
are those of a whole flight, the other three take most of the time in Python.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, PyTree


Places = TypeVar("Places", bound=PyTree)
X = TypeVar("X", bound=PyTree)
# Arrays, and also literals where JAX processes a program.
Leaves = Sequence[Any]


def linear_solve(
    equations: Callable[[Places, X], X],
    solve: Callable[[Places, X], X],
    transpose_solve: Callable[[Places, X], X],
    places: Places,
    right: X,
) -> X:
    """The x with `equations(places, x) == right`, which is linear in x.

    The equations and the solvers depend on no arrays other than `places`. The equations
    are differentiable in these. The solvers themselves are not differentiated.

    **Arguments:**

    - `equations`: left-hand sides, with the structure and shapes of x.
    - `solve`: function that returns x for right-hand sides.
    - `transpose_solve`: function that returns x for the transposed system.
    - `places`: a pytree of arrays on which the system depends.
    - `right`: a pytree of arrays of floats.
    """
    flat_places, places_structure = jax.tree.flatten(places)
    flat_right, structure = jax.tree.flatten(right)

    def flat(function):
        def on_leaves(places: Leaves, x: Leaves) -> list[Array]:
            out = function(
                jax.tree.unflatten(places_structure, places),
                jax.tree.unflatten(structure, x),
            )
            return jax.tree.leaves(out)

        return on_leaves

    system = _System(flat(equations), flat(solve), flat(transpose_solve))
    flat_right = [jnp.asarray(r) for r in flat_right]
    out = _solve.bind(*flat_places, *flat_right, system=system, count=len(flat_places))
    return jax.tree.unflatten(structure, out)


def solve_dense(matrix: Array, right: Array) -> Array:
    """The x with `matrix @ x == right`; in a batch, one system is solved after the other.

    Use it within flights. `jnp.linalg.solve` of a batch gives its systems to threads and
    waits for them. Threads that fly on other devices wait for this device in turn, which is
    a deadlock.

    **Arguments:**

    - `matrix`: matrix, shape (n, n).
    - `right`: right-hand sides, shape (n, columns).
    """
    return linear_solve(
        jnp.matmul, _one, lambda matrix, right: _one(matrix.T, right), matrix, right
    )


@jax.custom_batching.sequential_vmap
def _one(matrix: Array, right: Array) -> Array:
    return jnp.linalg.solve(matrix, right)


@dataclasses.dataclass(frozen=True, eq=False)
class _System:
    """Functions of the leaves of places and x that return leaves like those of x."""

    equations: Callable[[Leaves, Leaves], Leaves]
    solve: Callable[[Leaves, Leaves], Leaves]
    transpose_solve: Callable[[Leaves, Leaves], Leaves]

    def transposed(self) -> "_System":
        def equations(places: Leaves, x: Leaves) -> Leaves:
            transpose = jax.linear_transpose(
                functools.partial(self.equations, places), x
            )
            return transpose(x)[0]

        return _System(equations, self.transpose_solve, self.solve)

    def batched(self, axes: Sequence[int | None], size: int) -> "_System":
        """The batched system, along axes of the places and along the first axis of x."""

        def over(function):
            return jax.vmap(function, (list(axes), 0), 0, axis_size=size)

        return _System(
            over(self.equations), over(self.solve), over(self.transpose_solve)
        )


_solve = Primitive("linear_solve")
_solve.multiple_results = True


@_solve.def_impl
def _solved(*leaves: Any, system: _System, count: int) -> Leaves:
    return system.solve(list(leaves[:count]), list(leaves[count:]))


mlir.register_lowering(_solve, mlir.lower_fun(_solved, multiple_results=True))


@_solve.def_abstract_eval
def _(*leaves: Any, system: _System, count: int) -> Leaves:
    return [ShapedArray(r.shape, r.dtype) for r in leaves[count:]]


def _jvp(primals: Leaves, tangents: Leaves, *, system: _System, count: int):
    places, _ = primals[:count], primals[count:]
    found = _solve.bind(*primals, system=system, count=count)
    sides = [ad.instantiate_zeros(t) for t in tangents[count:]]
    moved = [i for i in range(count) if type(tangents[i]) is not ad.Zero]
    if moved:

        def at(leaves: Leaves) -> Leaves:
            there = list(places)
            for i, leaf in zip(moved, leaves, strict=True):
                there[i] = leaf
            return system.equations(there, found)

        here, rates = [places[i] for i in moved], [tangents[i] for i in moved]
        _, change = jax.jvp(at, (here,), (rates,))
        sides = [s - c for s, c in zip(sides, change, strict=True)]
    return found, _solve.bind(*places, *sides, system=system, count=count)


ad.primitive_jvps[_solve] = _jvp


def _transpose(cotangents: Leaves, *leaves: Any, system: _System, count: int):
    given = [ad.instantiate_zeros(c) for c in cotangents]
    system = system.transposed()
    out = _solve.bind(*leaves[:count], *given, system=system, count=count)
    linear = [ad.is_undefined_primal(r) for r in leaves[count:]]
    wanted = [
        c if is_linear else None for c, is_linear in zip(out, linear, strict=True)
    ]
    return [None] * count + wanted


ad.primitive_transposes[_solve] = _transpose


def _batch(leaves: Leaves, axes: Sequence[Any], *, system: _System, count: int):
    mapped = zip(leaves, axes, strict=True)
    size = next(x.shape[a] for x, a in mapped if a is not None)
    right = [
        jnp.broadcast_to(x, (size, *x.shape))
        if axis is None
        else jnp.moveaxis(x, axis, 0)
        for x, axis in zip(leaves[count:], axes[count:], strict=True)
    ]
    system = system.batched(axes[:count], size)
    out = _solve.bind(*leaves[:count], *right, system=system, count=count)
    return out, [0] * len(out)


batching.primitive_batchers[_solve] = _batch
