"""Derivatives through segments of a flight, with a learned value at the end of each.

The derivative of a whole flight is a product over all of its cycles. Through a segment it
is a product over some of them; what happens afterwards is in the derivative of a value,
which a network learns from the flights of the training.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Key

from .._batching import where_due
from ..addresses import replace_leaves
from ..campaign.batch import over_runs
from ..fields import Count, Scalar
from ..flight.closed_loop import select, start
from ..flight.cycle import Plan
from ..flight.flight import landed, ready
from ..flight.lane import Lane
from ..flight.loop import while_running_with_history
from ..flight.scenario import Scenario
from ..flight.termination import has_end
from ..guidance.neural_law import NeuralLaw
from ..onboard.sampling import normal_sample
from ..tuning.batch_gradients import Simulation, all_finite
from .flight_residuals import Flown, neural_law_of, with_weights
from .segment_value import Samples, Segments


Expected = Callable[[Float[Array, " inputs"], Count], Float[Array, " residuals"]]
"""Function of what a flight carries at the end of a segment, and of the number of segments
so far: the residuals that are expected, such as a `Value`. It is a pytree"""


def carried(lane: Lane, inputs: dict[str, Array]) -> Float[Array, " inputs"]:
    """All that decides the rest of a flight, in one vector: what the value reads."""
    parts = (
        lane.flown,
        lane.moving,
        lane.held,
        lane.noted.peaks,
        lane.aiding,
        {name: jnp.asarray(x, float) for name, x in inputs.items()},
    )
    return ravel_pytree(eqx.filter(parts, eqx.is_inexact_array))[0]


class Noise(eqx.Module):
    """Noise in the first decisions of a flight, which leads it away from other flights.

    From the end of the noise on the flight is that of the law.
    """

    deviation: Scalar
    seed: Scalar
    """Number between 0 and 1 that selects the noise of a flight"""
    segments: Count
    """Number of segments with noise"""

    def added(self, law: NeuralLaw, lane: Lane) -> Lane:
        """The flight with noise in the bank, the angle of attack and the memory."""
        normal, held = normal_sample(self.seed, lane.flown), lane.held
        drawn = [normal(axis) for axis in range(2 + held.memory.size)]
        by = jnp.asarray(self.deviation) * jnp.stack(drawn)
        angle = held.angle_of_attack
        if law.angles is not None:
            half = 0.5 * (law.angles.highest - law.angles.lowest)
            angle = jnp.clip(
                angle + by[1] * half, law.angles.lowest, law.angles.highest
            )
        held = dataclasses.replace(
            held,
            bank=held.bank + by[0],
            angle_of_attack=angle,
            memory=held.memory + by[2:],
        )
        return dataclasses.replace(lane, held=held)


class _Cut(eqx.Module):
    """A cycle of a flight that ends and begins segments."""

    plan: Plan
    cycles: int = eqx.field(static=True)
    """Number of guidance cycles in a segment"""

    @property
    def every(self) -> int:
        """Number of cycles of the plan in a segment."""
        return self.cycles * self.plan.decide_every

    def ends(self, lane: Lane) -> Array:
        """Whether a segment ends at the start of this cycle."""
        return self._begins(lane, self.every) & (lane.flown > 0.0)

    def _begins(self, lane: Lane, every: int) -> Array:
        return lane.on_schedule & (self._index(lane) % every == 0)

    def _index(self, lane: Lane) -> Array:
        """Number of cycles of the plan so far."""
        return jnp.round(lane.flown / self.plan.duration).astype(int)

    def __call__(self, parameters: Any, carry: tuple[Lane, Array]) -> Any:
        """The flight after a cycle, and the sum of the values at the ends of segments.

        `parameters` are the scenario, the value, the dispersed numbers, and the noise or
        None.
        """
        scenario, value, inputs, noise = parameters
        lane, total = carry
        ends = self.ends(lane)
        segment = self._index(lane) // self.every

        def add(total: Array) -> Array:
            return total + value(carried(lane, inputs), segment)

        total = where_due(ends, add, total)
        lane = jax.tree.map(lambda x: jnp.where(ends, lax.stop_gradient(x), x), lane)
        lane = self.plan.decided(scenario, lane)
        if noise is not None:
            decides = self._begins(lane, self.plan.decide_every)
            decides &= segment < noise.segments
            lane = select(decides, noise.added(neural_law_of(scenario), lane), lane)
        return self.plan.moved(scenario, lane), total


def _is_running(carry: tuple[Lane, Array]) -> Any:
    return carry[0].running


def fly_in_segments(
    scenario: Scenario,
    simulation: Simulation,
    cycles: int,
    value: Expected,
    inputs: dict[str, Array],
    noise: Noise | None = None,
) -> tuple[Array, Array, Array, tuple[Array, Array]]:
    """Fly one run, and cut it into segments of some guidance cycles.

    **Arguments:**

    - `value`: as many numbers as there are residuals; its input is `carried`.
    - `inputs`: dispersed numbers by address.

    **Returns:** the residuals at the end; the sum of the values at the ends of segments;
    whether the flight has an end and finite residuals; and the inputs of the value at each
    end of a segment, with whether the flight came there. The residuals have derivatives
    through the last segment, and the sum through the others.
    """
    dispersed = replace_leaves(scenario, inputs)
    flying = ready(dispersed)
    plan = Plan.of(flying, simulation.solver, None)
    cut = _Cut(plan, cycles)
    lane = start(flying, plan.step)
    total = jnp.zeros_like(value(carried(lane, inputs), jnp.asarray(0)))
    (lane, total), (lanes, _) = while_running_with_history(
        cut,
        _is_running,
        (flying, value, inputs, noise),
        (lane, total),
        plan.cycles,
        cut.every,
    )
    flight = landed(flying, lane)
    residuals = simulation.outputs(dispersed, flight)
    numbers = jnp.stack([jnp.asarray(x, float) for x in jax.tree.leaves(residuals)])
    read = jax.vmap(lambda lane: carried(lane, inputs))(lanes)
    finite = all_finite(numbers) & has_end(flight.outcome)
    return numbers, total, finite, (read, jax.vmap(cut.ends)(lanes))


def flown_in_segments(
    scenario: Scenario,
    simulation: Simulation,
    cycles: int,
    value: Expected,
    inputs: dict[str, Any],
) -> Flown:
    """Residuals of each flight, and their derivatives by the weights through segments."""
    shared = scenario, simulation, cycles, value
    return Flown(*over_runs(_with_derivatives, shared, inputs))


def _with_derivatives(
    shared: tuple[Scenario, Simulation, int, Any], inputs: dict[str, Array]
) -> tuple[Array, Array, Array]:
    scenario, simulation, cycles, value = shared
    vector, _ = ravel_pytree(neural_law_of(scenario).network.trained)

    def of(vector: Array) -> tuple[Array, Any]:
        there = with_weights(scenario, vector)
        residuals, total, finite, _ = fly_in_segments(
            there, simulation, cycles, value, inputs
        )
        return residuals + total, (residuals, finite)

    total, backwards, (residuals, finite) = jax.vjp(of, vector, has_aux=True)
    (derivatives,) = jax.vmap(backwards)(jnp.eye(len(total)))
    return residuals, derivatives, finite & jnp.all(jnp.isfinite(derivatives))


def noisy_samples(
    scenario: Scenario,
    simulation: Simulation,
    segments: Segments,
    inputs: dict[str, Any],
    key: Key[Array, ""],
    reached: int,
) -> Samples:
    """The ends of segments of flights with noise, from which a value learns.

    The noise of each flight ends with a segment that is drawn, from the first to number
    `reached`; with zero there is none. Only ends of segments from there on are samples:
    there the rest of the flight is that of the law.
    """
    count = len(next(iter(inputs.values())))
    first, second = jax.random.split(key)
    seeds = np.asarray(jax.random.uniform(first, (count,), dtype=float))
    until = np.asarray(
        jax.random.randint(second, (count,), min(1, reached), reached + 1)
    )
    shared = scenario, simulation, segments.cycles, jnp.asarray(segments.noise)
    residuals, finite, read, there = over_runs(
        _with_noise, shared, (inputs, seeds, until)
    )
    known = finite[:, None] & there & np.all(np.isfinite(read), axis=-1)
    known &= np.arange(there.shape[1]) >= until[:, None]
    return Samples(
        np.where(known[..., None], read, 0.0),
        known,
        np.where(finite[:, None], residuals, 0.0),
    )


def _with_noise(
    shared: tuple[Scenario, Simulation, int, Array],
    run: tuple[dict[str, Array], Array, Array],
) -> tuple[Array, Array, Array, Array]:
    scenario, simulation, cycles, deviation = shared
    inputs, seed, until = run
    noise = Noise(deviation, seed, until)
    residuals, _, finite, ends = fly_in_segments(
        scenario, simulation, cycles, _nothing, inputs, noise
    )
    return residuals, finite, *ends


def _nothing(read: Array, segment: Count) -> Array:
    """A value for flights that are not differentiated."""
    return jnp.zeros(1)
