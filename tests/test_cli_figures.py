"""The flights of the figures, beside the campaign."""

import dataclasses
import threading

import numpy as np
import pytest
from helpers import bank_profile, mars_scenario

from jentry.campaign import monte_carlo
from jentry.campaign.dispersions import Dispersion, key_of
from jentry.campaign.distributions import Uniform
from jentry.cli.figures import Histories, histories_of, interval_of
from jentry.flight import FixedStep
from jentry.flight.cycle import Plan
from jentry.guidance import Sampled


def test_they_begin_when_they_are_told_and_once():
    begun = []
    histories = Histories(lambda: begun.append(threading.current_thread()) or "flown")
    assert not begun
    histories.begin()
    histories.begin()
    assert histories.flown() == "flown" == histories.flown()
    (thread,) = begun
    assert thread is not threading.main_thread()


def test_they_begin_at_the_latest_when_they_are_asked_for():
    assert Histories(lambda: 3).flown() == 3


def test_what_flying_raises_is_raised_where_they_are_asked_for():
    def fails():
        raise ValueError("no such flight")

    histories = Histories(fails)
    with histories:
        histories.begin()
    with pytest.raises(ValueError, match="no such flight"):
        histories.flown()


class Held:
    """Histories that fly until they are let go."""

    def __init__(self):
        self.go, self.done = threading.Event(), False
        self.histories = Histories(self.fly)

    def fly(self):
        assert self.go.wait(20.0)
        self.done = True


def test_an_error_of_the_campaign_waits_for_them():
    held = Held()
    with pytest.raises(OSError, match="disk"), held.histories:
        held.histories.begin()
        threading.Timer(0.2, held.go.set).start()
        raise OSError("disk")
    assert held.done


def test_ctrl_c_does_not_wait():
    held = Held()
    with pytest.raises(KeyboardInterrupt), held.histories:
        held.histories.begin()
        raise KeyboardInterrupt
    assert not held.done
    held.go.set()
    held.histories.flown()


@pytest.mark.parametrize("given", [False, True])
def test_they_are_the_first_runs_and_the_nominal_one(given):
    scenario = mars_scenario()
    table = {"mass": Dispersion(lambda s: s.vehicle.mass, Uniform(900.0, 1100.0))}
    campaign = monte_carlo(scenario, table, key_of(5), 3)
    inputs = campaign.inputs if given else None
    flown = histories_of(
        scenario, None if given else table, 5, inputs, 3, None, FixedStep()
    ).flown()
    masses = flown["vehicle.mass"].values
    np.testing.assert_array_equal(masses[:-1], campaign.inputs["vehicle.mass"])
    assert masses[-1] == float(scenario.vehicle.mass)
    np.testing.assert_allclose(
        flown["end_altitude"].values[:-1], campaign.flights.state.altitude, rtol=1e-9
    )
    kept = histories_of(
        scenario, None if given else table, 5, inputs, 3, 1.0, FixedStep()
    ).flown()
    assert kept["vehicle.mass"].values == [float(scenario.vehicle.mass)]


def test_a_campaign_that_is_refused_flies_none(command, monkeypatch):
    monkeypatch.setattr(Histories, "begin", lambda self: pytest.fail("has begun"))
    first = "monte-carlo", "cheap", "--runs", 2, "--out", "one"
    code, _, said = command(*first, "--no-figures")
    assert code == 0, said
    code, _, said = command(*first, "--seed", 1)
    assert code == 3 and "seed is 0 there and 1 now" in said


@pytest.mark.parametrize(
    ("period", "step", "time_limit", "interval"),
    [
        (None, 0.1, 600.0, 0.5),
        (None, 0.3, 600.0, 0.6),  # two steps
        (None, 1.0, 600.0, 1.0),  # one step, which is longer than half a second
        (None, 0.1, 6000.0, 3.0),  # 2000 entries
        (0.1, 0.05, 600.0, 0.5),
        (0.1, 0.05, 4000.0, 2.0),
        (2.0, 0.1, 600.0, 0.5),
        (2.0, 2.0, 600.0, 2.0),
        (3.0, 1.0, 600.0, 1.0),
        (0.7, 0.1, 600.0, 0.7),  # a half of it would be three steps and a half
    ],
)
def test_histories_are_kept_at_whole_steps_of_the_flights(
    period, step, time_limit, interval
):
    law = bank_profile()
    scenario = mars_scenario(law if period is None else Sampled(law, period))
    termination = dataclasses.replace(scenario.termination, time_limit=time_limit)
    scenario = dataclasses.replace(scenario, termination=termination)
    solver = FixedStep(step)
    assert interval_of(scenario, solver) == pytest.approx(interval, rel=1e-12)
    flown, kept = [
        Plan.of(scenario, solver, h) for h in (None, interval_of(scenario, solver))
    ]
    assert kept.step == pytest.approx(flown.step, rel=1e-12)
    assert kept.step == pytest.approx(step, rel=1e-12)
