"""Starts a neural law from another law: it learns the banks of flights of that law."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from jaxtyping import Array, Float, Key

from ..flight.scenario import Scenario
from ..guidance.neural_law import NeuralLaw
from .flight_residuals import neural_law_of, weights_of, with_weights
from .recorded_law import Recording


_BATCH = 128
"""Number of flights in a step"""

_REPORT_EVERY = 500
"""Number of steps between reports"""


def imitated(
    scenario: Scenario,
    recording: Recording,
    key: Key[Array, ""],
    *,
    steps: int = 2000,
    rate: float = 5e-3,
    report: Callable[[str], None] = lambda line: None,
) -> Scenario:
    """The scenario with a neural law that has learnt the banks of recorded flights.

    At each cycle of a recorded flight the law reads what was recorded, with the memory that
    it has built up along this flight, and turns from the bank that was flown before. The
    loss is the mean of 1 - cos of the difference to the bank that was flown next.

    **Arguments:**

    - `scenario`: scenario with a `NeuralLaw`, whose weights are the start.
    - `recording`: flights of another law, see `record_inputs`.
    - `steps`: number of steps of Adam, with 128 flights each.
    - `rate`: learning rate at the start; it falls to zero.
    - `report`: function that is called with lines of text on the progress.
    """
    law = neural_law_of(scenario)
    if law.beside is not None:
        raise ValueError(
            "the law flies beside another one: imitation is for a network alone, since a "
            "correction of zero is the other law already"
        )
    if law.angles is not None:
        raise ValueError(
            "the law commands the angle of attack too: imitation learns banks alone; train "
            "through the flight from random weights"
        )
    read, banks = (jnp.asarray(np.nan_to_num(x)) for x in recording)
    flying = jnp.asarray(np.isfinite(recording.banks))
    optimizer = optax.chain(
        optax.clip_by_global_norm(1.0),
        optax.adam(optax.cosine_decay_schedule(rate, steps)),
    )

    @jax.jit
    def run(weights: Array, state: Any, keys: Array) -> tuple[Array, Any, Array]:
        def step(carry, key):
            weights, state = carry
            chosen = jax.random.randint(key, (_BATCH,), 0, len(read))

            def loss(weights):
                own = neural_law_of(with_weights(scenario, weights))
                off = jax.vmap(lambda x, b: _off(own, x, b))(
                    read[chosen], banks[chosen]
                )
                count = jnp.maximum(jnp.sum(flying[chosen]), 1)
                return jnp.sum(jnp.where(flying[chosen], off, 0.0)) / count

            value, gradient = jax.value_and_grad(loss)(weights)
            update, state = optimizer.update(gradient, state, weights)
            return (weights + jnp.asarray(update), state), value

        (weights, state), values = lax.scan(step, (weights, state), keys)
        return weights, state, jnp.mean(values)

    weights: Any = jnp.asarray(weights_of(scenario))
    state: Any = optimizer.init(weights)
    keys = jax.random.split(key, steps)
    for begin in range(0, steps, _REPORT_EVERY):
        some = keys[begin : begin + _REPORT_EVERY]
        weights, state, value = run(weights, state, some)
        report(f"imitation, {begin + len(some)} steps: loss {float(value):.4f}")
    return with_weights(scenario, weights)


def _off(
    law: NeuralLaw, read: Float[Array, "cycles inputs"], banks: Float[Array, " cycles"]
) -> Float[Array, " cycles"]:
    """1 - cos of the difference of the banks, along a recorded flight."""

    def cycle(carry, recorded):
        memory, before = carry
        inputs, flown = recorded
        (output,), memory = law.network(inputs, memory)
        bank = law.turned(before, output)
        return (memory, flown), 1.0 - jnp.cos(bank - flown)

    start = law.network.start(), law.first_bank
    _, off = lax.scan(cycle, start, (read, banks))
    return off
