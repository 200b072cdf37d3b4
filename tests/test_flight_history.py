"""The history of a flight has what was commanded, and does not change the flight."""

import jax
import numpy as np
import pytest
from helpers import bank_profile, fly_compiled, mars_scenario

from jentry.flight import FixedStep
from jentry.guidance import AbstractSampledLaw, FixedCycle, Sampled
from jentry.motion import Controls


def sampled_scenario():
    return mars_scenario(Sampled(bank_profile(), 1.0))


@pytest.fixture(scope="module")
def sampled_flight():
    return fly_compiled(sampled_scenario(), FixedStep(0.25))


@pytest.mark.slow
@pytest.mark.parametrize("interval", [0.5, 1.0, 4.0])
def test_history_does_not_change_the_flight(interval, sampled_flight):
    """Intervals that divide the guidance period, equal it, and are multiples of it."""
    flight = fly_compiled(sampled_scenario(), FixedStep(0.25), interval)
    history = flight.history
    assert flight.outcome == sampled_flight.outcome
    # The same steps in another program: rounding, grown along the flight.
    ours, theirs = (
        jax.tree.leaves((f.time, f.state, f.peaks)) for f in (flight, sampled_flight)
    )
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15)
    # Entries at multiples of the interval while it flew, then nothing.
    count = int(np.ceil(float(flight.time) / interval))
    assert history.time.shape == (400 / interval,)
    for leaf in jax.tree.leaves(history):
        assert np.all(np.isfinite(leaf[:count]))
        assert np.all(np.isnan(leaf[count:]))
    np.testing.assert_allclose(history.time[:count], interval * np.arange(count))
    assert history.states.velocity[0] == 6750.0


@pytest.mark.optimized
class Counting(AbstractSampledLaw):
    """A bank that is another one after each decision."""

    cycle: FixedCycle = FixedCycle(2.0)

    def init(self, measurement):
        return (), 0.0 * measurement.drag

    def update(self, time, measurement, memory, held):
        return (), held + 1.0

    def __call__(self, time, measurement, memory, held):
        return Controls.from_bank(0.01 * held, 0.0 * held), ()


@pytest.mark.parametrize("interval", [1.0, 2.0, 6.0])
def test_a_history_decides_when_the_flight_does_and_no_more(interval):
    scenario = mars_scenario(Counting(), 31.0)
    flight = fly_compiled(scenario, FixedStep(0.5), interval)
    times = np.asarray(flight.history.time)
    there = np.isfinite(times)
    np.testing.assert_allclose(times[there], interval * np.arange(there.sum()))
    assert there.sum() == np.ceil(31.0 / interval)
    # One decision at the start of each cycle, and it counts from there on.
    decided = np.floor(times[there] / 2.0) + 1.0
    np.testing.assert_array_equal(flight.history.decisions[there], decided)
    bank = np.arctan2(
        flight.history.controls.sin_bank, flight.history.controls.cos_bank
    )[there]
    np.testing.assert_allclose(bank, 0.01 * decided, rtol=1e-14)
    alone = fly_compiled(scenario, FixedStep(0.5))
    np.testing.assert_allclose(flight.state.altitude, alone.state.altitude, rtol=1e-13)


def test_history_shows_what_was_commanded_and_met():
    flight = fly_compiled(sampled_scenario(), FixedStep(0.25), 0.5)
    history = flight.history
    there = np.isfinite(history.time)
    cosine = history.controls.cos_bank[there]
    # Held through each cycle of 1 s, from the decision at its start on: two entries of
    # 0.5 s each, equal to the last bit.
    pairs = cosine[: len(cosine) // 2 * 2].reshape(-1, 2)
    assert np.array_equal(pairs[:, 0], pairs[:, 1])
    assert len(np.unique(pairs[:, 0])) > 0.9 * len(pairs)
    np.testing.assert_allclose(
        cosine[0],
        bank_profile().cos_bank(flight.history.states.velocity[0]),
        rtol=1e-14,
    )
    # Peaks are those of all steps: the history of every second one comes close.
    for name in ("drag", "dynamic_pressure", "heat_rate", "load_factor"):
        seen = np.nanmax(getattr(history.constraints, name))
        peak = getattr(flight.peaks, name)
        assert seen <= peak * (1 + 1e-12)
        np.testing.assert_allclose(seen, peak, rtol=1e-3)  # 0.25 s beside the peak
