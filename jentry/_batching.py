"""One answer for all flights that are flown side by side."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, PyTree

from .fields import Flag


T = TypeVar("T", bound=PyTree)


@jax.custom_batching.custom_vmap
def any_lane(condition: Bool[Array, "..."]) -> Bool[Array, "..."]:
    """Whether it holds for any flight of the batch: one answer for all under `vmap`."""
    return condition


@any_lane.def_vmap
def _(axis_size, in_batched, condition):
    return any_lane(jnp.any(condition)), False


def where_due(due: Flag, act: Callable[[T], T], otherwise: T) -> T:
    """`act(otherwise)` where it is due, computed only while it is for any flight.

    `lax.cond` under `vmap` computes both sides at all times; this skips what no flight
    of the batch needs. Worth it where all flights of a batch are due together.
    """
    acted = lax.cond(any_lane(jnp.asarray(due)), act, lambda same: same, otherwise)
    return jax.tree.map(lambda a, b: jnp.where(due, a, b), acted, otherwise)
