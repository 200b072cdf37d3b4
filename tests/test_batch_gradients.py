"""Gradients of the loss of a batch, through whole dispersed flights of the missions.

From entry on the command is clipped and released at instants that move with the gains,
and each of them makes a kink somewhere in a step of the solver. A difference across one
is no derivative, so the step is chosen flight by flight: of a ladder of central
differences the three in a row count that agree best, which nothing of the derivative
enters. (Two agree by chance in one flight of some thousands.)
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiling import little_optimized

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
from jentry.tuning.losses import BY_NAME, ScaledMisses


LADDER = 0.02 * 0.5 ** np.arange(14)
"""Steps of the logarithm of a gain, 0.02 to 2.4e-6"""


def gains(scenario):
    return scenario.guidance.gains, scenario.guidance.observer


def squares(misses, scale):
    """Of each flight; the altitude and the crossrange in km."""
    parts = misses.downrange / scale, misses.altitude / 1e3, misses.crossrange / 1e3
    return sum(part**2 for part in parts)


class Case:
    """A mission whose gains move, and draws of its campaign."""

    def __init__(self, mission, variant):
        mission = find_mission(mission)
        scenario = mission.scenario_of(variant)
        self.parameters = Parameters.of(scenario, gains)
        self.problem = Problem(self.parameters, Simulation(misses, FixedStep()))
        # Of one type: with others a program is another.
        zeros = self.parameters.zeros()
        self.free = jax.tree.map(lambda x: jnp.asarray(x, float), zeros)
        table, key = mission.dispersion_table(), jax.random.key(0)
        self.inputs = drawn_inputs(scenario, table, key, np.arange(LANES))

    def gradient(self, free, loss, outputs, forward):
        """Its programs run a few times: they are not worth optimizing."""
        _, weights = loss_and_weights(loss, outputs)
        with little_optimized():
            return batch_gradient(self.problem, free, self.inputs, weights, forward)


case = functools.cache(Case)
"""One for the tests of a variant, so that its programs are compiled once"""


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
def test_gradient_of_a_batch_matches_differences():
    """In both modes, for every gain, over the velocity."""
    mission, variant, scale = "mars-drag-tracking", "table-3", 1e3
    given = case(mission, variant)
    problem, parameters = given.problem, given.parameters
    free = given.free | {"guidance.observer.epsilon": jnp.asarray(1.0)}
    inputs = given.inputs

    def loss(misses):
        return jnp.mean(squares(misses, scale))

    outputs, finite = fly_at(problem, free, inputs)
    assert np.all(finite)
    forward, reverse = (
        given.gradient(free, loss, outputs, mode) for mode in (True, False)
    )
    assert int(forward.failed) == int(reverse.failed) == 0
    for address in parameters.addresses:
        expected, spread = differences(problem, free, address, inputs, scale)
        # What differences leave: rounding of the end, and kinks nearer than the ladder.
        np.testing.assert_allclose(
            forward.total[address], expected, rtol=1e-5, atol=spread
        )
        assert spread < 1e-4 * np.abs(expected)
        # Rounding, over 2000 steps and back.
        np.testing.assert_allclose(
            reverse.total[address], forward.total[address], rtol=1e-9
        )
        assert int(forward.moved[address]) == LANES


@pytest.mark.optimized
@pytest.mark.slow
def test_tails_of_the_mars_mission():
    """Of the law and the draws of the campaign that tuning is for, b and epsilon0: every
    named loss in both modes.

    Differences have kinks between them: where a command is clipped, in a flight of some.
    """
    given = case("mars-drag-tracking", "table-3")
    free, inputs = given.free, given.inputs
    scaled = ScaledMisses((("downrange", 1e3),))

    @functools.cache
    def beside(address, step):
        moved = free | {address: jnp.asarray(step, float)}
        return fly_at(given.problem, moved, inputs)[0]

    here, _ = fly_at(given.problem, free, inputs)
    for name, forward in itertools.product(BY_NAME, (True, False)):
        loss = BY_NAME[name](scaled)
        found = given.gradient(free, loss, here, forward)
        assert int(found.failed) == 0
        for address in ("guidance.gains.epsilon0", "guidance.gains.b"):
            slopes = []
            for step in (1e-4, 1e-5, 1e-6):
                up, down = (float(loss(beside(address, s))) for s in (step, -step))
                slopes.append((up - down) / (2.0 * step))
            error = min(abs(float(found.total[address]) / s - 1.0) for s in slopes)
            assert error < 1e-4, (name, address, found.total[address], slopes)
