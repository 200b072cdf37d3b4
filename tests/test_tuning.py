"""Tuning finds a known bank angle, stops, resumes, and judges on other draws."""

import cheap
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from cheap_tuning import (
    ADDRESS,
    BEST,
    KEY,
    LOSS,
    OPTIMIZERS,
    RUNS,
    SIMULATION,
    bank,
    scenario,
    tuned,
)
from helpers import with_leaf

from jentry.campaign import monte_carlo
from jentry.flight import misses
from jentry.tuning import (
    Bounds,
    CentralDifferences,
    MeanSquare,
    control_effort,
    excess,
    mean_square,
)
from jentry.tuning.draws import held_out
from jentry.tuning.judgement import judge
from jentry.units import degree


pytestmark = pytest.mark.optimized  # of few programs each flies thousands of flights


@pytest.mark.slow
@pytest.mark.parametrize("name", OPTIMIZERS)
def test_the_best_bank_is_found(name):
    """Up to what the mean of the dispersed flights differs from the nominal."""
    result = tuned(name)
    assert float(result.values["guidance.bank_angle"]) == pytest.approx(BEST, abs=0.01)
    first, best = result.course[0], result.course[result.best]
    assert best.loss < 0.05 * first.loss
    assert best.loss == min(entry.loss for entry in result.course)
    assert bank(result.scenario) == result.values["guidance.bank_angle"]
    assert result.gradient_shares == {"guidance.bank_angle": 1.0}
    comparison = result.judgement["loss", ""]
    assert comparison.lower
    assert comparison.after.value < 0.1 * comparison.before.value


@pytest.mark.slow
def test_all_optimizers_end_at_the_same_point():
    ends = [float(tuned(n).values["guidance.bank_angle"]) for n in OPTIMIZERS]
    assert ends[0] == pytest.approx(ends[1], abs=2e-3)  # adam creeps


@pytest.mark.slow
@pytest.mark.parametrize("name", OPTIMIZERS)
def test_resumed_as_if_never_stopped(name, tmp_path):
    """In history and result, and the finished run flies nothing more."""
    record = tmp_path / "record.npz"
    whole = tuned(name, steps=6)
    tuned(name, steps=2, path=record)
    resumed = tuned(name, steps=6, path=record)
    assert [e.loss for e in resumed.course] == [e.loss for e in whole.course]
    assert [e.free for e in resumed.course] == [e.free for e in whole.course]
    again = tuned(name, steps=6, path=record)
    assert len(again.course) == len(whole.course)
    assert again.stopped == whole.stopped


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"runs": RUNS + 1}, "runs is 32 there and 33 now"),
        ({"optimizer": "adam"}, "optimizer"),
        ({"ranges": {"guidance.bank_angle": Bounds(0.1, 1.5)}}, "parameters"),
        ({"gradient": CentralDifferences()}, "gradient"),
        ({"loss": MeanSquare(lambda m: m.downrange / 5e3)}, "loss"),
        ({"labels": {"of": "altitude"}}, "labels.of is given only now"),
    ],
)
def test_another_run_is_not_resumed(changes, message, tmp_path):
    record = tmp_path / "record.npz"
    tuned(steps=1, path=record)
    with pytest.raises(ValueError, match="another tuning run") as raised:
        tuned(**({"steps": 2, "path": record} | changes))
    assert message in str(raised.value)


def test_a_loss_of_the_same_name_is_told_by_its_value(tmp_path):
    record = tmp_path / "record.npz"

    def loss(scale):
        return lambda misses: mean_square(misses.downrange / scale)

    tuned(loss=loss(1e4), steps=1, path=record)
    with pytest.raises(ValueError, match="its loss at the start is"):
        tuned(loss=loss(2e4), steps=2, path=record)


# When it ends.


def test_it_stops_by_its_budget_of_steps_and_of_time():
    result = tuned("adam", steps=3)
    assert result.stopped == "3 steps" and len(result.course) == 3
    result = tuned("adam", seconds=1e-9)
    assert result.stopped == "1e-09 s" and len(result.course) == 1


@pytest.mark.parametrize("tolerance", [1e-4, 0.0])
def test_it_stops_without_progress(tolerance):
    result = tuned(optax.sgd(0.0), patience=2, tolerance=tolerance)
    assert result.stopped == "no progress in 2 steps" and len(result.course) == 3


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_it_stops_where_no_gradient_reaches():
    """The nose is in the heat rate alone, on which no miss depends."""
    result = tuned(where=lambda s: s.vehicle.nose_radius)
    assert result.stopped == "the gradient is zero"
    assert result.gradient_shares == {"vehicle.nose_radius": 0.0}


def test_a_trial_without_gradient_does_not_end_it():
    """A first step of adam so wide that the flights skip out, all by the time limit."""
    result = tuned(optax.sgd(30.0), steps=12)
    assert len(result.course) > 2 and result.best >= 0


def velocity(misses):
    return misses.velocity


AT_ROUNDING = MeanSquare(velocity)
"""All flights end by the velocity: what is left of the miss is rounding"""


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_it_stops_where_the_loss_is_rounding(name):
    """And says so, in place of walking after it."""
    result = tuned(name, loss=AT_ROUNDING)
    assert 0.0 < result.course[0].loss < 1e-16
    assert "is below the rounding of the loss" in result.stopped
    assert len(result.course) == 1
    assert float(result.values[ADDRESS]) == float(scenario().guidance.bank_angle)


def test_a_difference_of_rounding_is_not_judged_to_be_one():
    """Between any two bank angles: their bootstrap alone may say that one is better."""
    banks = [with_leaf(scenario(), bank, a * degree) for a in (50.0, 42.0, 46.0, 48.0)]
    for other in banks[1:]:
        for pair in ((banks[0], other), (other, banks[0])):
            given = cheap.mass_only(), KEY, 48, AT_ROUNDING, SIMULATION
            found = judge(*pair, *given)
            assert not found["loss", ""].lower
            for statistic in ("std", "mean", "95 % of |.|"):
                change = found["velocity", statistic].change
                assert change.low < 0.0 < change.high
            # And what is more than rounding still is.
            change = found["downrange", "mean"].change
            assert change.low > 0.0 or change.high < 0.0


def test_differences_agree_with_derivatives_where_nothing_jumps():
    given = {"gradient": CentralDifferences(1e-5), "steps": 1}
    first, exact = tuned(**given).course[0], tuned(steps=1).course[0]
    # A third derivative, times the square of the step, and rounding over the step.
    assert first.gradient_norm == pytest.approx(exact.gradient_norm, rel=1e-5)
    assert first.gradient_shares == exact.gradient_shares == {ADDRESS: 1.0}


# How it is asked.


def test_bounds_hold():
    result = tuned(ranges={ADDRESS: Bounds(45 * degree, 60 * degree)})
    assert 45 * degree <= float(result.values[ADDRESS]) < 45.5 * degree


def three(s):
    """The last of them is nothing to the flight, and still a parameter."""
    return s.guidance.bank_angle, s.initial_state.heading, s.vehicle.nose_radius


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_several_leaves_and_one_without_effect():
    result = tuned(where=three, steps=3)
    address = "vehicle.nose_radius"
    shares = {ADDRESS: 1.0, "initial_state.heading": 1.0, address: 0.0}
    assert result.gradient_shares == shares
    assert float(result.values[address]) == float(scenario().vehicle.nose_radius)


def test_fresh_draws_are_judged_by_the_same_ones():
    result = tuned(optax.adam(0.02), steps=12, fresh=True)
    fixed = tuned(optax.adam(0.02), steps=12)
    assert result.course[0].loss == fixed.course[0].loss
    assert result.course[1].loss != fixed.course[1].loss
    assert result.course[result.best].loss < 0.5 * result.course[0].loss
    assert result.course[-1].flights == 2 * fixed.course[-1].flights


def with_peaks(scenario, flight):
    return misses(scenario, flight), flight.peaks, control_effort(flight.history)


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_path_constraints_and_control_effort_enter_the_loss():
    def loss(outputs):
        miss, peaks, effort = outputs
        assert miss.downrange.shape == effort.shape == (RUNS,) or effort.size == 48
        return (
            mean_square(miss.downrange / 1e4)
            + 10.0 * excess(peaks.load_factor, 10.0)
            + jnp.mean(effort)
        )

    result = tuned(loss=loss, outputs=with_peaks, history=5.0, steps=4)
    assert result.course[result.best].loss < result.course[0].loss


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"table": {}}, "nothing is dispersed"),
        ({"runs": 1}, "runs is 1"),
        ({"held_out": 0}, "held_out is 0"),
        ({"steps": 0}, "steps is 0"),
        (
            {"where": lambda s: s.initial_state.latitude},
            "latitude is 0, from which no scale",
        ),
        ({"fresh": True}, "compares points on the same draws"),
        ({"loss": lambda m: m.downrange}, r"the loss has shape \(32,\)"),
        ({"where": lambda s: s.vehicle.mass}, "vehicle.mass is tuned, and"),
        ({"where": lambda s: ()}, "a lens reaches no leaf"),
    ],
)
def test_what_cannot_be_asked_is_an_error(options, message):
    with pytest.raises(ValueError, match=message):
        tuned(**options)


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_training_and_judgement_measure_the_same():
    """On the same draws they agree; also where the entry point itself is tuned."""
    result = tuned(where=three, steps=3)
    best = result.course[result.best].loss
    table = cheap.mass_only()
    judged = judge(scenario(), result.scenario, table, KEY, RUNS, LOSS, SIMULATION)
    assert judged["loss", ""].after.value == pytest.approx(best, rel=1e-9)


def test_it_is_judged_on_draws_that_it_was_not_tuned_on():
    """Those of the key of the judgement, flown here once more."""
    result = tuned(steps=1)
    losses = {}
    for name, key in (("tuned on", KEY), ("judged on", held_out(KEY))):
        given = scenario(), cheap.mass_only(), key, 48
        flown = monte_carlo(*given, solver=cheap.SOLVER)
        losses[name] = np.mean((flown.misses.downrange / 10e3) ** 2)
    assert losses["tuned on"] != pytest.approx(losses["judged on"], rel=1e-6)
    judged = result.judgement["loss", ""].before.value
    assert judged == pytest.approx(losses["judged on"], rel=1e-9)


def to_45_degrees(scenario):
    """A penalty of the scenario alone, which is zero at a bank of 45 degrees."""
    return 1e5 * (scenario.guidance.bank_angle - 45 * degree) ** 2


def test_a_penalty_is_added_to_the_loss_and_to_its_gradient():
    """At the start, by hand; and where it is much, tuning goes where it is none."""
    alone, both = tuned(steps=1), tuned(steps=12, penalty=to_45_degrees)
    first, second = alone.course[0], both.course[0]
    assert alone.penalties is None and both.penalties is not None
    known = 1e5 * (5 * degree) ** 2
    assert both.penalties[0] == pytest.approx(known, rel=1e-12)
    assert second.loss == pytest.approx(first.loss + known, rel=1e-12)
    # Of the free number: the bank is its own scale. The difference of 2 % knows it too.
    bank_angle = 50 * degree
    slope = 2e5 * (5 * degree) * bank_angle
    assert first.difference == pytest.approx(first.gradient_norm, rel=0.05)
    assert abs(second.gradient_norm) == pytest.approx(
        first.gradient_norm + slope, rel=1e-6
    )
    assert second.difference == pytest.approx(second.gradient_norm, rel=0.05)
    assert not both.remarks
    best = float(both.values["guidance.bank_angle"])
    assert best == pytest.approx(45 * degree, abs=1e-3)
    assert both.penalties[1] == pytest.approx(
        1e5 * (best - 45 * degree) ** 2, rel=1e-9, abs=1e-15
    )
    # The judgement is of the flights alone.
    comparison = both.judgement["loss", ""]
    assert comparison.before.value == pytest.approx(
        alone.judgement["loss", ""].before.value, rel=1e-12
    )


def test_a_run_with_a_penalty_is_another_run(tmp_path):
    record = tmp_path / "record.npz"
    tuned(steps=1, path=record)
    with pytest.raises(ValueError, match="holds another tuning run"):
        tuned(steps=2, path=record, penalty=to_45_degrees)


@pytest.mark.parametrize(
    ("penalty", "message"),
    [
        (lambda s: jnp.log(-s.guidance.bank_angle), "is not finite at the start"),
        (lambda s: jnp.sqrt(0.0 * s.guidance.bank_angle), "is not finite at the start"),
        (lambda s: jnp.ones(3) * s.guidance.bank_angle, r"has shape \(3,\)"),
    ],
)
def test_a_penalty_that_cannot_be_used_is_refused(penalty, message):
    with pytest.raises(ValueError, match=message):
        tuned(steps=1, penalty=penalty)


def test_a_point_where_the_penalty_is_not_a_number_is_not_the_best():
    """Below 49 degrees, where the flights are better."""

    def penalty(scenario):
        allowed = scenario.guidance.bank_angle > 49 * degree
        return jnp.where(allowed, 0.0, jnp.nan)

    result = tuned("adam", steps=4, penalty=penalty)
    there = [float(entry.values["guidance.bank_angle"]) for entry in result.course]
    assert there[1] < 49 * degree < there[0]
    for bank_angle, entry in zip(there, result.course, strict=True):
        assert np.isinf(entry.loss) == (bank_angle < 49 * degree)
    assert float(result.values["guidance.bank_angle"]) > 49 * degree
