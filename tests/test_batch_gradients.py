"""Gradients of the loss of a batch, through whole dispersed flights of the missions.

From entry on the command is clipped and released at instants that move with the gains,
and each of them makes a kink somewhere in a step of the solver. A difference across one
is no derivative, so the step is chosen flight by flight: of a ladder of central
differences the three in a row count that agree best, which nothing of the derivative
enters. (Two agree by chance in one flight of some thousands.)
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.campaign.batch import LANES
from jentry.campaign.campaign import drawn_inputs
from jentry.flight import FixedStep, misses
from jentry.missions import find_mission
from jentry.parameters.parameters import Parameters
from jentry.tuning.batch_gradients import (
    Problem,
    Simulation,
    batch_gradient,
    loss_and_weights,
)
from jentry.tuning.gradients import fly_at


LADDER = 0.02 * 0.5 ** np.arange(14)
"""Steps of the logarithm of a gain, 0.02 to 2.4e-6"""


def gains(scenario):
    return scenario.guidance.gains, scenario.guidance.observer


def squares(misses, scale):
    """Of each flight; the altitude and the crossrange in km."""
    parts = misses.downrange / scale, misses.altitude / 1e3, misses.crossrange / 1e3
    return sum(part**2 for part in parts)


def differences(problem, free, address, inputs, scale):
    """Derivative of the mean of the squares, and by how much the differences disagree."""

    def at(step):
        moved = free | {address: free[address] + step}
        return np.asarray(squares(fly_at(problem, moved, inputs)[0], scale))

    rates = np.stack([(at(h) - at(-h)) / (2.0 * h) for h in LADDER])
    threes = np.stack([rates[:-2], rates[1:-1], rates[2:]])
    spread = np.ptp(threes, axis=0)
    steadiest = np.argmin(spread, axis=0), np.arange(rates.shape[1])
    return np.mean(np.median(threes, axis=0)[steadiest]), np.mean(spread[steadiest])


@pytest.mark.optimized
@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "variant", "scale", "slower", "both"),
    [
        ("mars-drag-tracking", "table-3", 1e3, 1.0, True),
        # Reverse mode over the energy is in `test_gradients`, law by law.
        ("mars-drag-tracking", "energy-index", 1e3, 1.0, False),
        ("mars-range-tracking", "three-dimensional", 20.0, 1.4, True),
    ],
)
def test_gradient_of_a_batch_matches_differences(mission, variant, scale, slower, both):
    """In both modes, for every gain; the observer slower than it is by a factor e or so,
    since the miss of a good one hardly depends on it."""
    mission = find_mission(mission)
    scenario = mission.scenario(variant)
    parameters = Parameters.of(scenario, gains)
    free = parameters.zeros() | {"guidance.observer.epsilon": jnp.asarray(slower)}
    problem = Problem(parameters, Simulation(misses, FixedStep()))
    table, key = mission.dispersion_table(), jax.random.key(0)
    inputs = drawn_inputs(scenario, table, key, np.arange(LANES))

    def loss(misses):
        return jnp.mean(squares(misses, scale))

    outputs, finite = fly_at(problem, free, inputs)
    assert np.all(finite)
    _, weights = loss_and_weights(loss, outputs)
    forward, *reverse = (
        batch_gradient(problem, free, inputs, weights, mode)
        for mode in ((True, False) if both else (True,))
    )
    assert all(int(found.failed) == 0 for found in (forward, *reverse))
    for address in parameters.addresses:
        expected, spread = differences(problem, free, address, inputs, scale)
        # What differences leave: rounding of the end, and kinks nearer than the ladder.
        np.testing.assert_allclose(
            forward.total[address], expected, rtol=1e-5, atol=spread
        )
        assert spread < 1e-4 * np.abs(expected)
        for other in reverse:
            # Rounding, over 2000 steps and back.
            np.testing.assert_allclose(
                other.total[address], forward.total[address], rtol=1e-9
            )
        assert int(forward.moved[address]) == LANES
