"""Linear-quadratic regulation over a finite horizon: by collocation, and by Riccati.

The cost is x(t_f)' P_f x(t_f) / 2 and the integral of (x' Q x + u' R u) / 2 along
dx/dt = A(t) x + B(t) u. What it costs to go on from x at t is x' S(t) x / 2, and the
control that costs least is u = -R^-1 B' S x.

Reference: D.-W. Lee, K.-R. Cho, H. Yan, "Re-Entry Trajectory Tracking Via an Inverse
Dynamics Method", KSME International Journal 18(9), 2004, section 4.
"""

from collections.abc import Callable, Sequence

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from .._collocation import legendre_gauss_lobatto
from ..fields import Scalar, table


Square = Float[Array, "states states"]
Control = Float[Array, "states controls"]
System = Callable[[Scalar], tuple[Square, Control]]
"""A and B over the time, s"""


class Weights(eqx.Module):
    """What deviations cost."""

    states: Float[Array, "..."] = table()
    """Q"""
    controls: Float[Array, "..."] = table()
    """R"""
    final: Float[Array, "..."] = table()
    """P_f"""

    def __check_init__(self):
        for name in ("states", "controls", "final"):
            shape = getattr(self, name).shape
            if len(shape) != 2 or shape[0] != shape[1]:
                raise ValueError(
                    f"{name} has shape {shape}: it must be a square matrix"
                )
        if self.states.shape != self.final.shape:
            raise ValueError(
                f"states has shape {self.states.shape} and final {self.final.shape}: "
                "both weigh the same states"
            )

    def gain(self, cost_to_go: Square, control: Control) -> Float[Array, "controls n"]:
        """K of u = -K x, from S and B."""
        return jnp.linalg.solve(self.controls, control.T @ cost_to_go)


def _inside(times: Float[Array, " times"]) -> Float[Array, " times"]:
    """The first and the last a hair nearer to each other: where A and B jump at an end,
    those of this side count."""
    first = jnp.nextafter(times[0], jnp.inf) - times[0]
    last = jnp.nextafter(times[-1], -jnp.inf) - times[-1]
    hair = jnp.zeros_like(times).at[0].set(first).at[-1].set(last)
    return times + lax.stop_gradient(hair)


class Plan(eqx.Module):
    """The optimal motion from unit deviations at the start, at the nodes."""

    states: Float[Array, "nodes states states"]
    """W_1 of (57): each column of the last two axes from one unit deviation"""
    costates: Float[Array, "nodes states states"]
    """W_2 of (57); the one at the start is the cost to go"""


def collocated_plan(
    system: System,
    weights: Weights,
    start: Scalar | float,
    end: Scalar | float,
    degree: int,
) -> Plan:
    """Equations (33), (34) at the Legendre-Gauss-Lobatto nodes, as one linear system.

    Of (52) the equation of the states at the first node and that of the costates at the
    last one are left out, where the ends are given: with them there would be more
    equations than unknowns. Between start and end (s) A and B must be smooth; where they
    jump, see `cost_to_go`.
    """
    made = legendre_gauss_lobatto(degree)
    half = 0.5 * (end - start)
    a, b = jax.vmap(system)(_inside(start + half * (1.0 + jnp.asarray(made.nodes))))
    n = a.shape[-1]
    pushed = jax.vmap(lambda b: b @ jnp.linalg.solve(weights.controls, b.T))(b)
    eye, derivative = jnp.eye(n), jnp.asarray(made.first)

    def blocks(diagonal: Float[Array, "nodes n n"]) -> Float[Array, "nodes n nodes n"]:
        return jnp.einsum("kj,kab->kajb", jnp.eye(degree + 1), diagonal)

    def differences() -> Float[Array, "nodes n nodes n"]:
        return jnp.einsum("kj,ab->kajb", derivative, eye)

    unit = jnp.broadcast_to(weights.states, a.shape)
    # Rows of the states at all nodes but the first, of the costates at all but the last.
    of_states = (differences() - half * blocks(a))[1:]
    of_controls = (half * blocks(pushed))[1:]
    of_weights = (half * blocks(unit))[:-1]
    of_costates = (differences() + half * blocks(jnp.swapaxes(a, 1, 2)))[:-1]
    # The last costate is P_f times the last state.
    end_controls = of_controls[:, :, -1] @ weights.final
    end_costates = of_costates[:, :, -1] @ weights.final
    of_states = of_states.at[:, :, -1].add(end_controls)
    of_weights = of_weights.at[:, :, -1].add(end_costates)

    size = n * degree
    matrix = jnp.concatenate(
        [
            jnp.concatenate(
                [
                    of_states[:, :, 1:].reshape(size, size),
                    of_controls[:, :, :-1].reshape(size, size),
                ],
                axis=1,
            ),
            jnp.concatenate(
                [
                    of_weights[:, :, 1:].reshape(size, size),
                    of_costates[:, :, :-1].reshape(size, size),
                ],
                axis=1,
            ),
        ]
    )
    given = jnp.concatenate(
        [of_states[:, :, 0].reshape(size, n), of_weights[:, :, 0].reshape(size, n)]
    )
    found = -jnp.linalg.solve(matrix, given)
    later = found[:size].reshape(degree, n, n)
    costates = found[size:].reshape(degree, n, n)
    last = weights.final @ later[-1]
    return Plan(
        jnp.concatenate([eye[None], later]), jnp.concatenate([costates, last[None]])
    )


def cost_to_go(
    system: System,
    weights: Weights,
    ends: Sequence[Scalar | float],
    degree: int = 30,
) -> Square:
    """S at the first of `ends` (s), by collocation between each two of them.

    Between the ends A and B must be smooth: a horizon in which they jump is split there.
    What is to be paid from a split on is the final weight of the part before it.
    """
    if len(ends) < 2:
        raise ValueError(f"ends is {ends}: a horizon has a start and an end")
    final = weights.final
    for start, end in reversed(list(zip(ends[:-1], ends[1:], strict=True))):
        part = eqx.tree_at(lambda w: w.final, weights, final)
        final = collocated_plan(system, part, start, end, degree).costates[0]
    return final


def riccati_cost_to_go(
    system: System,
    weights: Weights,
    ends: Sequence[Scalar | float],
    tolerance: float = 1e-11,
) -> Square:
    """The same by Riccati's differential equation, backward, with adaptive steps.

    -dS/dt = A' S + S A - S B R^-1 B' S + Q. Slow: what `cost_to_go` is judged by.
    """

    def slope(time, s, ends):
        a, b = system(jnp.clip(time, *_inside(ends)))
        pushed = s @ b
        return_cost = pushed @ jnp.linalg.solve(weights.controls, pushed.T)
        return -(a.T @ s + s @ a - return_cost + weights.states)

    final = weights.final
    for start, end in reversed(list(zip(ends[:-1], ends[1:], strict=True))):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(slope),
            diffrax.Dopri8(),
            t0=jnp.asarray(end, float),
            t1=start,
            dt0=None,
            y0=final,
            args=jnp.asarray([start, end], float),
            stepsize_controller=diffrax.PIDController(tolerance, tolerance),
            max_steps=100_000,
        )
        assert solution.ys is not None
        final = solution.ys[-1]
    return final
