"""Linear-quadratic regulation over a finite horizon: by collocation, and by Riccati.

The cost is x(t_f)' P_f x(t_f) / 2 plus the integral of (x' Q x + u' R u) / 2 along
dx/dt = A(t) x + B(t) u. The cost to go from x at t is x' S(t) x / 2, and the optimal
control is u = -R^-1 B' S x.

Reference: D.-W. Lee, K.-R. Cho, H. Yan, "Re-Entry Trajectory Tracking Via an Inverse
Dynamics Method", KSME International Journal 18(9), 2004, section 4.
"""

from collections.abc import Callable

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from .._collocation import legendre_gauss_lobatto
from .._linear_solve import solve_dense
from ..fields import Count, Scalar, Vector, table


Square = Float[Array, "states states"]
Control = Float[Array, "states controls"]
System = Callable[[Scalar], tuple[Square, Control]]
"""A and B as functions of the time"""
SplitSystem = Callable[[Count, Scalar], tuple[Square, Control]]
"""A and B as functions of the part of the horizon, from 0, and of the time. They are smooth
within each part; at its end they are those before a jump"""


class Weights(eqx.Module):
    """Weights of the cost."""

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
        """K of u = -K x, from S and B; or -u, from costates and B, (29)."""
        return self.per_control @ (control.T @ cost_to_go)

    @property
    def per_control(self) -> Float[Array, "controls controls"]:
        """The inverse of R."""
        return solve_dense(self.controls, jnp.eye(self.controls.shape[0]))


class Plan(eqx.Module):
    """The optimal motion from unit deviations at the start, at the nodes.

    With several parts of a horizon they are along a leading axis.
    """

    states: Float[Array, "*parts nodes states states"]
    """W_1 of (57): a column of the last two axes for each unit deviation"""
    costates: Float[Array, "*parts nodes states states"]
    """W_2 of (57); that at the start is the cost to go"""
    controls: Float[Array, "*parts nodes controls states"]
    """M W_2 of (58)"""


def collocated_plan(
    system: System,
    weights: Weights,
    start: Scalar | float,
    end: Scalar | float,
    degree: int,
) -> Plan:
    """The optimal motion by (33), (34) at all Legendre-Gauss-Lobatto nodes at once.

    The equation (52) of the states at the first node and that of the costates at the last
    node are left out, where the ends are prescribed: with them there would be more
    equations than unknowns. Between start and end A and B must be smooth; where they
    jump, see `collocated_plans`.
    """
    made = legendre_gauss_lobatto(degree)
    half = 0.5 * (end - start)
    a, b = jax.vmap(system)(start + half * (1.0 + jnp.asarray(made.nodes)))
    n = a.shape[-1]
    per_control = weights.per_control
    pushed = b @ per_control @ jnp.swapaxes(b, 1, 2)
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
    found = -solve_dense(matrix, given)
    later = found[:size].reshape(degree, n, n)
    costates = found[size:].reshape(degree, n, n)
    last = weights.final @ later[-1]
    costates = jnp.concatenate([costates, last[None]])
    return Plan(
        jnp.concatenate([eye[None], later]),
        costates,
        -jax.vmap(weights.gain)(costates, b),
    )


def collocated_plans(
    system: SplitSystem, weights: Weights, ends: Vector, degree: int
) -> Plan:
    """The optimal motion in each part of a horizon, from unit deviations at its start.

    A horizon in which A or B jump is split at the jumps, and may be split elsewhere: many
    parts of a low degree cost less than one of a high degree. The final weight of a part
    is the cost to go from its end. A part may have zero length.

    **Arguments:**

    - `ends`: ends of the parts, shape (parts + 1,), from the start of the horizon to its
      end.
    - `degree`: degree of the polynomials in each part.

    **Returns:** the plans of the parts, along a leading axis.
    """

    def one(final: Square, part: Count) -> tuple[Square, Plan]:
        paying = eqx.tree_at(lambda w: w.final, weights, final)
        plan = collocated_plan(
            lambda time: system(part, time), paying, ends[part], ends[part + 1], degree
        )
        return plan.costates[0], plan

    parts = jnp.arange(_parts(ends))
    return lax.scan(one, weights.final, parts, reverse=True)[1]


def cost_to_go(
    system: SplitSystem, weights: Weights, ends: Vector, degree: int = 30
) -> Square:
    """S at the first of `ends`, by collocation; arguments as in `collocated_plans`."""
    return collocated_plans(system, weights, ends, degree).costates[0, 0]


def riccati_cost_to_go(
    system: SplitSystem, weights: Weights, ends: Vector, tolerance: float = 1e-11
) -> Square:
    """S at the first of `ends`, by Riccati's differential equation with adaptive steps.

    -dS/dt = A' S + S A - S B R^-1 B' S + Q, backward in time. This is slow; it serves to
    verify `cost_to_go`.
    """

    def slope(time, s, part):
        a, b = system(part, time)
        pushed = s @ b
        return_cost = pushed @ weights.per_control @ pushed.T
        return -(a.T @ s + s @ a - return_cost + weights.states)

    def one(final: Square, part: Count) -> tuple[Square, None]:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(slope),
            diffrax.Dopri8(),
            t0=ends[part + 1],
            t1=ends[part],
            dt0=None,
            y0=final,
            args=part,
            stepsize_controller=diffrax.PIDController(tolerance, tolerance),
            max_steps=100_000,
        )
        assert solution.ys is not None
        return solution.ys[-1], None

    parts = jnp.arange(_parts(ends))
    return lax.scan(one, weights.final, parts, reverse=True)[0]


def _parts(ends: Vector) -> int:
    if ends.shape[0] < 2:
        raise ValueError(f"ends is {ends}: a horizon has a start and an end")
    return ends.shape[0] - 1
