"""Tools for batches of flights: one decision for all, and one number for each flight."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Bool, PyTree

from .fields import Flag


T = TypeVar("T", bound=PyTree)


def any_lane(condition: Bool[Array, "..."] | Flag) -> Bool[Array, "..."]:
    """Whether a condition holds for any flight of a batch: one value for all in `vmap`."""
    return _any.bind(jnp.asarray(condition))


_any = Primitive("any_lane")
"""Returns its operand, and of a batch whether it holds for any"""
_any.def_impl(lambda condition: condition)
_any.def_abstract_eval(lambda condition: condition)
mlir.register_lowering(_any, lambda context, condition: [condition])


def _any_of_batch(conditions: Sequence[Any], axes: Sequence[int]):
    return any_lane(jnp.any(conditions[0], axes[0])), None


batching.primitive_batchers[_any] = _any_of_batch


def _without_derivative(primals: Sequence[Any], tangents: Sequence[Any]):
    out = _any.bind(*primals)
    return out, ad.Zero(ShapedArray(out.shape, jax.dtypes.float0))


ad.primitive_jvps[_any] = _without_derivative


def where_due(due: Flag, act: Callable[[T], T], otherwise: T) -> T:
    """`act(otherwise)` where it is due, computed only if it is due for any flight.

    `lax.cond` under `vmap` always computes both sides. This function skips `act` if no
    flight of the batch needs it. It helps if all flights of a batch are due together.
    """
    acted = lax.cond(any_lane(jnp.asarray(due)), act, lambda same: same, otherwise)
    return jax.tree.map(lambda a, b: jnp.where(due, a, b), acted, otherwise)


def side_by_side(tree: T, by: PyTree = None) -> T:
    """The leaves of a tree, all of them batched if any leaf of it or of `by` is batched.

    `vmap` traces the body of a loop again as long as this makes more leaves of the carry
    batched. If all leaves are batched from the start, it traces the body once. The compiled
    program contains nothing of this.
    """
    leaves, structure = jax.tree.flatten(tree)
    others = [x for x in jax.tree.leaves(by) if eqx.is_array(x)]
    out = _alike.bind(*map(jnp.asarray, leaves), *others, count=len(leaves))
    return jax.tree.unflatten(structure, out)


_alike = Primitive("side_by_side")
"""Returns its first `count` operands unchanged, in a batch each along a first axis"""
_alike.multiple_results = True


@_alike.def_impl
def _same(*leaves: Any, count: int) -> list[Any]:
    return list(leaves[:count])


_alike.def_abstract_eval(_same)
mlir.register_lowering(_alike, mlir.lower_fun(_same, multiple_results=True))


def _jvp(primals: Sequence[Any], tangents: Sequence[Any], *, count: int):
    out = list(tangents[:count])
    moved = [i for i in range(count) if type(out[i]) is not ad.Zero]
    if moved:
        alike = _alike.bind(*(out[i] for i in moved), count=len(moved))
        for i, tangent in zip(moved, alike, strict=True):
            out[i] = tangent
    return _alike.bind(*primals, count=count), out


ad.primitive_jvps[_alike] = _jvp


def _transpose(cotangents: Sequence[Any], *leaves: Any, count: int) -> list[Any]:
    return [*cotangents, *[None] * (len(leaves) - count)]


ad.primitive_transposes[_alike] = _transpose


def _batch(leaves: Sequence[Any], axes: Sequence[Any], *, count: int):
    size = next(x.shape[a] for x, a in zip(leaves, axes, strict=True) if a is not None)
    out = [
        jnp.broadcast_to(x, (size, *x.shape)) if a is None else jnp.moveaxis(x, a, 0)
        for x, a in zip(leaves[:count], axes[:count], strict=True)
    ]
    return _alike.bind(*out, count=count), [0] * count


batching.primitive_batchers[_alike] = _batch
