"""Damping of a closed loop along its flight, as a function of its gains."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Complex, Float

from .._setup import needs_float64
from ..fields import Scalar
from ..flight.cycle import Plan
from ..flight.lane import Lane
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver, FixedStep
from ..guidance.law import AbstractSampledLaw
from ..motion.index import AbstractIndex, TimeIndex
from .frozen_loop import DEADBEAT, at_equal_index
from .local_derivatives import derivatives_at


_SIMPLE = 1e-12
"""Cosine between the left and the right eigenvector, below which an eigenvalue counts as a
multiple one, which has no derivative"""


class Damping(eqx.Module):
    """Damping ratios of the modes of a closed loop, at points of a flight.

    The modes are those of `linearize`, but always in coordinates of the motion; `linearize`
    may use the errors that a law feeds back instead, which gives other modes. The damping
    ratios can be differentiated once, in the gains of the law and in all other numbers of
    the scenario. The points are those of the flight from which this object was made, also
    for a scenario with other gains. The ratios are NaN if coordinates depend on each other
    that did not in that flight, such as an integral whose gain was zero.

    Use one scenario at a time, and no `vmap` over several: see `eigenvalues`.

        damping = Damping.of(scenario, faster_than=0.1)
        damping(scenario).min()
    """

    index: AbstractIndex
    plan: Plan
    lanes: Lane
    out: int = eqx.field(static=True)
    blocks: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """Blocks of coordinates that depend on each other, as places without the eliminated
    coordinate"""
    unlinked: Bool[Array, "n n"]
    """Dependences that would merge two blocks"""
    faster_than: float = eqx.field(static=True)
    """Magnitude above which an eigenvalue counts, per unit of the index"""

    @classmethod
    @needs_float64
    def of(
        cls,
        scenario: Scenario,
        index: AbstractIndex = TimeIndex(),
        points: int = 20,
        *,
        faster_than: float = 0.0,
        solver: AbstractSolver = FixedStep(),
    ) -> "Damping":
        """Fly a scenario once, for the points and the dependences of the coordinates.

        **Arguments:**

        - `index`, `points`, `solver`: as for `linearize`.
        - `faster_than`: modes with a smaller eigenvalue do not count. In a frozen loop,
            quantities that hardly change along the whole flight look undamped, such as the
            heading and the phugoid.

        **Raises:** `ValueError` as `linearize`.
        """
        if not faster_than >= 0.0:
            raise ValueError(f"faster_than is {faster_than}: it must not be negative")
        _, flown, _, out, matrices = at_equal_index(scenario, index, points, solver)
        linked = np.any(matrices != 0.0, axis=0)
        # Whether i depends on j, directly or indirectly: path lengths double in each round.
        reached = linked | np.eye(len(linked), dtype=bool)
        for _ in range(len(linked).bit_length()):
            reached = reached @ reached
        _, label = np.unique(reached & reached.T, axis=0, return_inverse=True)
        blocks = (tuple(np.flatnonzero(label == i).tolist()) for i in set(label))
        return cls(
            index,
            flown.plan,
            flown.lanes,
            out,
            tuple(sorted(blocks)),
            jnp.asarray(reached.T & (label[:, None] != label[None, :])),
            float(faster_than),
        )

    def __call__(self, scenario: Scenario) -> Float[Array, "points modes"]:
        """Damping ratios from 1 (aperiodic) to -1; 1 for a mode that does not count."""
        rates, deadbeat = self.eigenvalues(scenario)
        size = jnp.abs(rates)
        # NaN is neither deadbeat nor slow, and stays NaN.
        passed_over = deadbeat | (size <= self.faster_than)
        ratio = -jnp.real(rates) / jnp.where(passed_over, 1.0, size)
        return jnp.where(passed_over, 1.0, ratio)

    @property
    def points(self) -> int:
        """Number of points."""
        return jnp.shape(self.lanes.flown)[0]

    def described(self) -> dict[str, Any]:
        """Description of this object, without the numbers of the flight."""
        return {
            "index": type(self.index).__name__,
            "points": self.points,
            "faster_than": self.faster_than,
        }

    def least(self, scenario: Scenario) -> Scalar:
        """The smallest damping ratio of all modes and points."""
        return jnp.min(self(scenario))

    def eigenvalues(
        self, scenario: Scenario
    ) -> tuple[Complex[Array, "points modes"], Bool[Array, "points modes"]]:
        """Eigenvalues per unit of the passed index, and which of them are deadbeat.

        With `vmap` over scenarios, the program may deadlock on a machine with few cores.
        """
        sampled = isinstance(scenario.guidance, AbstractSampledLaw)
        found = derivatives_at(scenario, self.index, self.plan, self.lanes)
        equal = _at_equal_index(found.gradient, self.out)
        matrices = jnp.delete(found.derivative @ equal, self.out, axis=1)
        merged = jnp.any((matrices != 0.0) & self.unlinked[None])
        matrices = jnp.where(merged, jnp.nan, matrices)
        parts = []
        for block in self.blocks:
            rows = np.array(block)
            # One by one: for a batch of matrices jaxlib waits, in a thread of its pool,
            # for tasks in the same pool. Two such programs at once deadlock.
            parts.append(lax.map(eigenvalues_of, matrices[:, rows[:, None], rows]))
        found_values = jnp.concatenate(parts, axis=1)
        if not sampled:
            return found_values, jnp.zeros(found_values.shape, bool)
        deadbeat = jnp.abs(found_values) < DEADBEAT
        multipliers = jnp.where(deadbeat, 1.0, found_values)
        return jnp.log(multipliers) / found.way[:, None], deadbeat


def _at_equal_index(gradient: Float[Array, "points n"], out: int) -> Array:
    """Matrix from deviations at equal index to all deviations, as `coordinates.lift`."""
    n = gradient.shape[-1]
    others = np.delete(np.arange(n), out)
    lifted = jnp.broadcast_to(jnp.eye(n)[:, others], (len(gradient), n, n - 1))
    follows = -gradient[:, others] / gradient[:, [out]]
    return lifted.at[:, out].set(follows)


def eigenvalues_of(matrix: Float[Array, "k k"]) -> Complex[Array, " k"]:
    """Eigenvalues that can be differentiated once where they are simple.

    The derivative of a multiple eigenvalue is one of its possible slopes, or zero. (With
    the derivative of JAX itself, one multiple eigenvalue makes all derivatives infinite or
    NaN.)
    """
    frozen = lax.stop_gradient(matrix)
    values, left, right = lax.linalg.eig(
        frozen, compute_left_eigenvectors=True, compute_right_eigenvectors=True
    )
    moved = jnp.einsum("ji,jk,ki->i", left.conj(), matrix + 0j, right)
    across = jnp.einsum("ji,ji->i", left.conj(), right)
    simple = jnp.abs(across) > _SIMPLE
    change = (moved - lax.stop_gradient(moved)) / jnp.where(simple, across, 1.0)
    return values + jnp.where(simple, change, 0.0)
