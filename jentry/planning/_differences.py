"""Derivatives of tabulated values by finite differences."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fields import Scalar
from ..onboard.profiles import Nodes


def with_differences(values: Float[Array, " nodes"], spacing: Scalar) -> Nodes:
    """Values on an even grid, with two derivatives by differences of fourth order.

    The values are derivatives themselves, so that two more exact derivatives would be
    costly. Laws use mainly the values.
    """
    if values.shape[0] < 5:
        raise ValueError(
            f"intervals is {values.shape[0] - 1}: differences of fourth order take 4 or "
            "more"
        )
    near, far = jnp.array([-1.0, 8.0]), jnp.array([-1.0, 16.0])
    beyond = jnp.concatenate(
        [_extrapolated(values[:5][::-1])[::-1], values, _extrapolated(values[-5:])]
    )
    left = jnp.stack([beyond[:-4], beyond[1:-3]])
    right = jnp.stack([beyond[4:], beyond[3:-1]])
    first = near @ (right - left) / (12.0 * spacing)
    second = (far @ (right + left) - 30.0 * values) / (12.0 * spacing**2)
    return values, first, second


def _extrapolated(last: Float[Array, " 5"]) -> Float[Array, " 2"]:
    """The next two values of the quartic through five values on an even grid."""
    once = jnp.array([1.0, -5.0, 10.0, -10.0, 5.0])
    following = once @ last
    return jnp.stack([following, once @ jnp.append(last[1:], following)])
