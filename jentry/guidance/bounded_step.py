"""Step of one or two numbers, within bounds, that minimises the remaining misses."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._interpolation import clamp
from .._newton import solve
from .bank_shapes import Numbers


def least_squares_step(
    misses: Numbers,
    effects: Float[Array, "numbers numbers"],
    lower: Numbers,
    upper: Numbers,
) -> Numbers:
    """The step within bounds that minimises the norm of misses + effects step.

    For two numbers it is the step that makes the misses zero, if it lies within the
    bounds, and otherwise the best of the optimal points on the four edges. Derivatives are
    those of the selected candidate.
    """
    if misses.shape[0] == 1:
        return within_bounds(-misses / effects[0], lower, upper)
    (a, b), (c, d) = effects
    regular = a * d - b * c != 0.0
    # On both sides of the selection, so that the unused branch has no derivative.
    inside = -solve(jnp.where(regular, effects, jnp.eye(2)), misses)
    points = [inside]
    for fixed, free in ((0, 1), (1, 0)):
        column = effects[:, free]
        size = jnp.sum(column * column)
        size = jnp.where(size > 0.0, size, 1.0)
        for bound in (lower[fixed], upper[fixed]):
            left = misses + effects[:, fixed] * bound
            along = clamp(-jnp.sum(column * left) / size, lower[free], upper[free])
            pair = (bound, along) if fixed == 0 else (along, bound)
            points.append(jnp.stack(pair))
    candidates = jnp.stack(points)
    left = jax.vmap(lambda step: misses + effects @ step)(candidates)
    remains = jnp.sum(left * left, axis=1)
    within = regular & jnp.all((inside >= lower) & (inside <= upper))
    remains = jnp.where(jnp.arange(5) == 0, jnp.where(within, -1.0, jnp.inf), remains)
    return candidates[jnp.argmin(remains)]


def within_bounds(x: Numbers, low: Numbers, high: Numbers) -> Numbers:
    """Each number clamped to its bounds; `clamp` takes one number."""
    return jnp.where(x < low, low, jnp.where(x > high, high, x))
