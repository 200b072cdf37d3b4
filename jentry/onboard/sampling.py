"""Noise of a sample: a function of seed, time and axis."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from ..fields import Scalar


def normal_sample(seed: Scalar, sampled_at: Scalar) -> Callable[[int], Scalar]:
    """Independent standard normal numbers of a flight at a time (s), by their axis.

    `seed` is a number between 0 and 1, of which 31 bits are used. The time is rounded to
    1 ms.
    """
    seed = jnp.asarray(seed * 2.0**31).astype(jnp.uint32)
    millisecond = jnp.round(1e3 * jnp.asarray(sampled_at)).astype(jnp.uint32)
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(0), seed), millisecond)

    def drawn(axis: int) -> Scalar:
        # Drawn one by one. With one array for all axes, in a batch with other runs, the
        # compiler treats the last runs of a block differently from the rest.
        return jax.random.normal(jax.random.fold_in(key, axis), dtype=float)

    return drawn
