"""Navigation that is updated in a flight whose guidance cycle varies."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filter_flights import ALTIMETER, TERRAIN, aided

from jentry.fields import Scalar, scalar
from jentry.flight import FixedStep, fly
from jentry.flight.closed_loop import start
from jentry.flight.cycle import Plan
from jentry.guidance import (
    AbstractCycle,
    AbstractSampledLaw,
    AbstractTimedDecision,
    FixedCycle,
    ShorteningCycle,
)
from jentry.motion import Controls


class Timed(AbstractTimedDecision):
    duration: Scalar


class Holding(AbstractSampledLaw):
    """The same bank in each cycle, of `rhythm` seconds or shorter towards 60 s."""

    rhythm: Scalar = scalar(4.0, unit="s")
    cycle: AbstractCycle = ShorteningCycle(4.0, shorter=((40.0, 1.0), (12.0, 0.25)))

    def init(self, measurement):
        return (), Timed(self.rhythm + 0.0 * measurement.drag)

    def update(self, time, measurement, memory, held):
        if isinstance(self.cycle, ShorteningCycle):
            return (), Timed(self.cycle.duration(60.0 - time, held.duration))
        return (), held

    def __call__(self, time, measurement, memory, held):
        nothing = jnp.zeros_like(held.duration)
        return Controls(nothing, nothing + 0.6, nothing + 0.8), ()


CYCLE = 8.0
"""Of the navigation, s: twice the longest of the guidance cycles"""


def flown(law, sensors=None):
    """With random walks, and with a filter if there are sensors: at 50 s."""
    scenario = dataclasses.replace(aided({}, 50.0), guidance=law)
    navigation = scenario.navigation
    aiding = dataclasses.replace(navigation.filter, sensors=sensors or {}, cycle=CYCLE)
    noise = dataclasses.replace(navigation.noise, cycle=CYCLE)
    noise = eqx.tree_at(lambda n: n.velocity_random_walk, noise, jnp.asarray(0.5))
    navigation = dataclasses.replace(
        navigation, noise=noise, filter=aiding if sensors else None, seed=0.3
    )
    return fly(dataclasses.replace(scenario, navigation=navigation), FixedStep(0.5))


def assert_alike(one, other):
    """To the error of their steps, which are not of the same lengths."""
    for a, b in zip(*map(jax.tree.leaves, (one, other)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
def test_random_walks_are_the_same_whatever_the_guidance_cycle():
    """The noise is a function of seed and time. The law commands the same bank at all
    times, and its cycle is 4 s until 20 s, and 1 s and 0.25 s later."""
    varying, fixed = (flown(law) for law in (Holding(), Holding(cycle=FixedCycle(4.0))))
    assert float(varying.time) == float(fixed.time) == 50.0
    # After six kicks of 0.5 m/s and the root of 8 s the velocity is meters off.
    off = float(varying.navigated.velocity - varying.state.velocity)
    assert abs(off) > 0.5
    assert_alike((varying.state, varying.navigated), (fixed.state, fixed.navigated))


@pytest.mark.slow
def test_a_filter_is_updated_at_the_same_times():
    sensors = {
        "altimeter": dataclasses.replace(ALTIMETER, cycle=CYCLE),
        "terrain": dataclasses.replace(TERRAIN, cycle=2.0 * CYCLE),
    }
    varying, fixed = (
        flown(law, sensors) for law in (Holding(), Holding(cycle=FixedCycle(4.0)))
    )
    # Below 60 km, which is so from about 9 s on: at 16, 24, ... 48 s and at 16, 32, 48 s.
    counts = {name: float(x) for name, x in varying.knowledge.measured.items()}
    assert counts == {"altimeter": 5.0, "terrain": 6.0}
    assert_alike((varying.state, varying.navigated), (fixed.state, fixed.navigated))
    assert_alike(varying.knowledge, fixed.knowledge)


@pytest.mark.parametrize("rhythm", [0.7, 0.25, 4.0, 3.1])
def test_no_update_is_lost_where_the_clocks_are_not_the_same(rhythm):
    """In 100 s as many as there are multiples of 8 s, each at the first decision after
    it."""
    scenario = dataclasses.replace(aided({}), guidance=Holding(rhythm))
    navigation = dataclasses.replace(scenario.navigation, filter=None)
    noise = dataclasses.replace(navigation.noise, cycle=CYCLE)
    navigation = dataclasses.replace(navigation, noise=noise)
    scenario = dataclasses.replace(scenario, navigation=navigation)
    plan = Plan.of(scenario, FixedStep(0.5), None)
    lane = start(scenario, 1.0)
    held = Timed(jnp.asarray(rhythm))

    @jax.jit
    @jax.vmap
    def due(flown):
        return plan._has_passed(
            scenario.law, dataclasses.replace(lane, flown=flown, held=held)
        )

    times = np.add.accumulate(np.full(int(100.0 / rhythm), rhythm))
    multiples = CYCLE * np.arange(1, 13)
    expected = [
        np.flatnonzero(times > m - 1e-6)[0] for m in multiples if m <= times[-1]
    ]
    np.testing.assert_array_equal(np.flatnonzero(due(jnp.asarray(times))), expected)


def test_a_navigation_that_is_faster_than_guidance_is_refused():
    scenario = dataclasses.replace(aided({}), guidance=Holding())
    said = (
        "the cycle of the navigation is 1.0 s: with a guidance cycle that varies it must "
        "be a multiple of the longest, 4.0 s"
    )
    with pytest.raises(ValueError, match=said):
        fly(scenario)
