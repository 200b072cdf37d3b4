"""Tuning, whole: of a scenario that is cheap to fly, towards a known best bank angle."""

import functools

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
import pytest
from helpers import mars_scenario, with_leaf

from jentry._computed_once import computed_once
from jentry.campaign import Dispersion, Uniform, monte_carlo
from jentry.flight import FixedStep, misses
from jentry.guidance import AbstractContinuousLaw
from jentry.missions import find_mission
from jentry.motion import Controls
from jentry.parameters.parameters import Parameters
from jentry.planning.reference_flight import plan_bank_profile
from jentry.tuning import (
    AutomaticDifferentiation,
    Bounds,
    Budget,
    CentralDifferences,
    Draws,
    MeanSquare,
    Record,
    Scale,
    control_effort,
    excess,
    mean_square,
    tune,
)
from jentry.tuning.batch_gradients import (
    Problem,
    Simulation,
    batch_gradient,
    batch_outputs,
)
from jentry.tuning.draws import held_out
from jentry.tuning.gradients import batch_loss
from jentry.tuning.judgement import judge
from jentry.units import degree, km


KEY = jax.random.key(5)
RUNS = 32

SIMULATION = Simulation(misses, cheap.SOLVER)

pytestmark = pytest.mark.optimized  # of few programs each flies thousands of flights

BEST = 40 * degree
"""Bank of the nominal flight that ends at the target, see `scenario`"""


@computed_once
def scenario():
    """Banked at 50 degrees, with the target where 40 degrees lead to."""
    banked = with_leaf(cheap.scenario(), lambda s: s.guidance.bank_angle, BEST)
    inputs = {"vehicle.mass": np.array([992.0])}
    there = monte_carlo(banked, inputs=inputs, solver=cheap.SOLVER)
    beyond = float(there.misses.downrange[0]) + float(banked.target.downrange)
    return with_leaf(cheap.scenario(), lambda s: s.target.downrange, beyond)


def bank(s):
    return s.guidance.bank_angle


def downrange(misses):
    return misses.downrange / (10 * km)


LOSS = MeanSquare(downrange)

OPTIMIZERS = {
    "L-BFGS": optimistix.LBFGS(rtol=1e-8, atol=1e-8),
    "adam": optax.adam(0.05),
}


BUDGET = {"steps", "patience", "tolerance", "seconds"}
DRAWN = {"runs", "held_out", "fresh"}
RECORDED = {"path", "labels", "report"}


def tuned(optimizer="L-BFGS", where=bank, loss=LOSS, table=None, start=None, **options):
    """`tune`, with the fields of its draws, its budget and its record as options."""
    table = cheap.mass_only() if table is None else table
    how = OPTIMIZERS[optimizer] if isinstance(optimizer, str) else optimizer
    given = {"runs": RUNS, "steps": 40, "held_out": 48, "solver": cheap.SOLVER}
    given |= options
    start = scenario() if start is None else start
    parts = [
        {n: given.pop(n) for n in names & set(given)}
        for names in (DRAWN, BUDGET, RECORDED)
    ]
    draws, budget, record = parts
    return tune(
        start,
        where,
        loss,
        how,
        Draws(table, KEY, **draws),
        budget=Budget(**budget),
        record=Record(**record),
        **given,
    )


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


# What is not finite.


class Fragile(AbstractContinuousLaw[None]):
    """A bank angle (rad) that is no number for a light or an overloaded vehicle."""

    bank_angle: jax.Array
    limit: jax.Array

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        broken = measurement.drag > self.limit
        bank_angle = jnp.where(broken, jnp.nan, self.bank_angle)
        return Controls(
            0.0 * self.bank_angle, jnp.cos(bank_angle), jnp.sin(bank_angle)
        ), None


def fragile(most):
    law = Fragile(jnp.asarray(50 * degree), jnp.asarray(most))
    return eqx.tree_at(lambda s: s.guidance, scenario(), law)


def density():
    where = lambda s: s.planet.density_scale
    return {"density": Dispersion(where, Uniform(0.8, 1.2))}


@functools.cache
def limit():
    """m/s2, which half of the flights exceed"""
    campaign = monte_carlo(scenario(), density(), KEY, RUNS, solver=cheap.SOLVER)
    return float(np.median(campaign.flights.peaks.drag))


@pytest.mark.optimized(False)
@pytest.mark.slow
@pytest.mark.parametrize("forward", [True, False])
def test_flights_that_fail_do_not_poison_the_gradient(forward):
    """It is the gradient of the others alone."""
    start = fragile(limit())
    parameters = Parameters.of(start, bank)
    problem = Problem(parameters, SIMULATION)
    free = parameters.zeros()
    inputs = {"planet.density_scale": jnp.linspace(0.8, 1.2, 64)}
    outputs, finite = batch_outputs(SIMULATION, start, inputs)
    assert 4 < int(jnp.sum(finite)) < 60
    nothing = jax.tree.map(jnp.zeros_like, outputs)
    weights = eqx.tree_at(lambda w: w.downrange, nothing, jnp.where(finite, 1.0, 0.0))
    found = batch_gradient(problem, free, inputs, weights, forward)

    others = jnp.where(finite, inputs["planet.density_scale"], 0.8)
    sound = {"planet.density_scale": others}
    expected = batch_gradient(problem, free, sound, weights, forward)
    np.testing.assert_allclose(
        found.total[ADDRESS], expected.total[ADDRESS], rtol=1e-12
    )
    assert int(found.counted) == int(jnp.sum(finite))
    assert int(found.failed) == int(expected.failed) == 0


ADDRESS = "guidance.bank_angle"


@pytest.mark.optimized(False)
@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name == "adam" else pytest.mark.slow)
        for name in OPTIMIZERS
    ],
)
def test_flights_that_fail_are_counted_and_left_out(name):
    start = fragile(limit())
    result = tuned(name, start=start, table=density(), steps=5)
    failed = [entry.failed for entry in result.course]
    assert 0 < failed[0] < RUNS
    assert failed[result.best] == min(failed)
    assert np.isfinite(result.course[0].loss)
    assert result.judgement.not_finite_before > 0


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_none_that_flies_is_an_error():
    with pytest.raises(ValueError, match="32 flights of which an output is not finite"):
        tuned(start=fragile(1e-6), table=density())


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


# What a gradient means.


class Stepped(AbstractContinuousLaw[None]):
    """A bank angle (rad) of which half is rounded to milliradians, as jumps do it: its
    derivative is half of what it does."""

    bank_angle: jax.Array

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        rounded = jax.lax.stop_gradient(jnp.round(self.bank_angle * 1e3) / 1e3)
        bank_angle = 0.5 * (self.bank_angle + rounded)
        controls = 0.0 * bank_angle, jnp.cos(bank_angle), jnp.sin(bank_angle)
        return Controls(*controls), None


def stepped():
    law = Stepped(jnp.asarray(50 * degree))
    return eqx.tree_at(lambda s: s.guidance, scenario(), law)


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_a_gradient_that_a_difference_contradicts_is_warned_of(tmp_path):
    record = tmp_path / "record.npz"
    with pytest.warns(UserWarning, match="a difference of the loss along it"):
        result = tuned(start=stepped(), steps=1, path=record)
    (entry,) = result.course
    # By the width of its differences: 35 steps, give or take one at each end.
    assert entry.difference == pytest.approx(2.0 * entry.gradient_norm, rel=0.05)
    assert len(result.remarks) == 1 and "difference" in result.remarks[0]
    # A run that is resumed knows it still, and does not warn again.
    again = tuned(start=stepped(), steps=1, path=record)
    assert again.remarks == result.remarks
    smooth = tuned(steps=1)
    first = smooth.course[0]
    # Of a third derivative, times the square of a step of 2 %.
    assert first.difference == pytest.approx(first.gradient_norm, rel=1e-2)
    assert smooth.remarks == ()


@pytest.mark.slow
def test_differences_see_the_jumps():
    """Twice the gradient that the derivatives have; and no one warns."""
    result = tuned(start=stepped(), gradient=CentralDifferences(), steps=25)
    exact = tuned(steps=1).course[0]
    first = result.course[0]
    # The law without steps, of which one more or less is in 35.
    assert first.gradient_norm == pytest.approx(exact.gradient_norm, rel=0.05)
    assert 0.0 < first.gradient_error < first.gradient_norm
    assert result.remarks == ()
    assert float(result.values[ADDRESS]) == pytest.approx(BEST, abs=0.01)


def test_differences_agree_with_derivatives_where_nothing_jumps():
    given = {"gradient": CentralDifferences(1e-5), "steps": 1}
    first, exact = tuned(**given).course[0], tuned(steps=1).course[0]
    # A third derivative, times the square of the step, and rounding over the step.
    assert first.gradient_norm == pytest.approx(exact.gradient_norm, rel=1e-5)
    assert first.gradient_shares == exact.gradient_shares == {ADDRESS: 1.0}


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_a_start_next_to_a_bound_is_warned_of():
    bounds = Bounds(50 * degree - 1e-5, 60 * degree)
    with pytest.warns(UserWarning, match="starts within 0.0057 % of one of its bounds"):
        result = tuned(ranges={ADDRESS: bounds}, steps=1)
    assert len(result.remarks) == 1


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


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_forward_and_reverse_take_the_same_steps():
    forward, reverse = (
        tuned("adam", steps=4, gradient=AutomaticDifferentiation(forward))
        for forward in (True, False)
    )
    losses = [[e.loss for e in r.course] for r in (forward, reverse)]
    np.testing.assert_allclose(*losses, rtol=1e-9)  # rounding, through four steps


def test_fresh_draws_are_judged_by_the_same_ones():
    result = tuned(optax.adam(0.02), steps=12, fresh=True)
    fixed = tuned(optax.adam(0.02), steps=12)
    assert result.course[0].loss == fixed.course[0].loss
    assert result.course[1].loss != fixed.course[1].loss
    assert result.course[result.best].loss < 0.5 * result.course[0].loss
    assert result.course[-1].flights == 2 * fixed.course[-1].flights


def twice_as_far(scenario):
    """A surrogate that is not like the law at all: its gradient points elsewhere."""
    return with_leaf(
        scenario, lambda s: s.target.downrange, 2.0 * scenario.target.downrange
    )


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_a_surrogate_is_followed_and_the_exact_law_judges():
    result = tuned(
        "adam", steps=8, gradient=AutomaticDifferentiation(surrogate=twice_as_far)
    )
    exact = tuned("adam", steps=8)
    assert result.course[0].loss == exact.course[0].loss
    assert result.course[0].gradient_norm != exact.course[0].gradient_norm
    losses = [entry.loss for entry in result.course]
    assert losses[result.best] == min(losses)


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
            "latitude is 0, which does not",
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


# What a scenario is built of.

HALF = {"half": 25 * degree}


def twice(parameters):
    """The scenario, banked at twice a number."""
    return with_leaf(scenario(), bank, 2.0 * parameters["half"])


@pytest.mark.slow
def test_a_build_is_tuned_as_its_leaf_is():
    """Of twice a number, each being its own scale: the same points but for rounding."""
    result, direct = tuned(start=HALF, where=None, build=twice), tuned()
    losses = [[e.loss for e in r.course[:5]] for r in (result, direct)]
    np.testing.assert_allclose(*losses, rtol=1e-9)
    assert result.values.keys() == {"half"} and result.moved == (ADDRESS,)
    half = float(result.values["half"])
    assert half == float(result.parameters["half"])
    assert half == pytest.approx(0.5 * BEST, abs=0.005)
    assert float(bank(result.scenario)) == 2.0 * half
    assert result.gradient_shares == {"half": 1.0}
    after = [r.judgement["loss", ""].after.value for r in (result, direct)]
    assert after[0] == pytest.approx(after[1], rel=1e-6)


@pytest.mark.slow
def test_a_build_is_resumed_and_another_one_is_not(tmp_path):
    given = {"start": HALF, "where": None, "path": tmp_path / "record.npz"}
    tuned(**given, build=twice, steps=1)
    resumed = tuned(**given, build=twice, steps=2)
    whole = tuned(start=HALF, where=None, build=twice, steps=2)
    assert [e.loss for e in resumed.course] == [e.loss for e in whole.course]
    with pytest.raises(ValueError, match="build is .*twice there and .*half_of"):
        tuned(**given, build=half_of, steps=3)


def half_of(parameters):
    return twice(parameters)


@pytest.mark.slow
def test_bounds_hold_for_what_is_built():
    ranges = {"half": Bounds(22.5 * degree, 30 * degree)}
    result = tuned(start=HALF, where=None, build=twice, ranges=ranges)
    assert 45 * degree <= float(bank(result.scenario)) < 45.5 * degree


def heavy(parameters):
    return with_leaf(twice(parameters), lambda s: s.vehicle.mass, parameters["mass"])


def not_traced(parameters):
    return twice({"half": float(parameters["half"])})


@pytest.mark.parametrize(
    ("start", "where", "build", "message"),
    [
        (HALF | {"mass": 992.0}, None, heavy, "vehicle.mass is tuned, and the disp"),
        (HALF, None, not_traced, "build needs the values of the parameters"),
        (HALF, lambda p: p["haf"], twice, "the lens of what to tune: 'haf'"),
        (HALF, None, lambda p: p, "what is flown is a dict: it must be a Scenario"),
        (HALF, None, lambda p: scenario(), "no number of the scenario depends on"),
        (25 * degree, None, twice, "one array without a name"),
    ],
)
def test_what_cannot_be_built_is_an_error(start, where, build, message):
    with pytest.raises(ValueError, match=message):
        tuned(start=start, where=where, build=build)


def nose_first(parameters):
    """A build that leaves what can be flown when its number falls below 0.4."""
    radius = parameters["half"] - 0.4
    return with_leaf(twice(parameters), lambda s: s.vehicle.nose_radius, radius)


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_a_point_that_cannot_be_flown_is_turned_back_from():
    """Though its flights would be finite."""
    result = tuned(start=HALF, where=None, build=nose_first, steps=8)
    fell = [e for e in result.course if float(e.values["half"]) <= 0.4]
    assert fell and all(e.failed == RUNS and e.loss == np.inf for e in fell)
    assert float(result.values["half"]) > 0.4


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_the_gradient_goes_through_a_planner():
    """Of a curvature from which a reference is planned by flights of its own: the
    derivative of the whole is that of its differences."""
    start = {"curvature": jnp.asarray(0.02)}
    parameters = Parameters.of(start, None, {"curvature": Scale(0.1)}, planned_anew)
    problem = Problem(parameters, SIMULATION)
    free = parameters.zeros()
    inputs = {"vehicle.mass": jnp.linspace(950.0, 1040.0, 64)}

    def loss(outputs):
        return mean_square(outputs.downrange / (10 * km))

    up, down = (
        batch_loss(problem, loss, {"curvature": jnp.asarray(h)}, inputs)[0]
        for h in (1e-4, -1e-4)
    )
    for forward in (True, False):
        how = AutomaticDifferentiation(forward)
        found = how(problem, loss, free, inputs).gradient["curvature"]
        # The third derivative over that step, and rounding.
        assert float(found) == pytest.approx((up - down) / 2e-4, rel=1e-5)
    # Little is left to the curvature, since the plan meets the target with any.
    assert abs(float(found)) > 1e-5


def planned_anew(parameters):
    given = mars_scenario(), 503.0, parameters["curvature"]
    profile = plan_bank_profile(*given, solver=cheap.SOLVER)
    return eqx.tree_at(lambda s: s.guidance.cos_bank, mars_scenario(), profile)


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_training_and_judgement_measure_the_same():
    """On the same draws they agree; also where the entry point itself is tuned."""
    result = tuned(where=three, steps=3)
    best = result.course[result.best].loss
    table = cheap.mass_only()
    judged = judge(scenario(), result.scenario, table, KEY, RUNS, LOSS, SIMULATION)
    assert judged["loss", ""].after.value == pytest.approx(best, rel=1e-9)


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_reversals_contradict_their_gradient_and_differences_do_not_need_it():
    """Of the crossrange, which is what they are for: over 1536 flights the mean of the
    derivatives is 14.5 +- 1.7, and a difference of 10 % is 0.3 +- 0.7; to the floor of
    the corridor it is 0 and 15.1 +- 1.1, and by the smooth reversals 14.0 +- 0.9."""
    mission = find_mission("mars-range-tracking")
    given = (
        mission.scenario("range-tracking"),
        lambda s: (s.guidance.gains.epsilon0, s.guidance.lateral.floor),
        MeanSquare(lambda misses: misses.crossrange / 100.0),
        optimistix.LBFGS(rtol=1e-6, atol=1e-6),
        Draws(mission.dispersion_table(), jax.random.key(1), held_out=64),
    )
    how = {"budget": Budget(steps=1), "solver": FixedStep(0.25)}
    with pytest.warns(UserWarning, match="a difference of the loss along it"):
        result = tune(*given, **how)
    assert result.gradient_shares["guidance.lateral.floor"] == 0.0
    result = tune(*given, **how, gradient=CentralDifferences(0.1))
    (entry,) = result.course
    assert (
        result.remarks == () and result.gradient_shares["guidance.lateral.floor"] > 0.5
    )
    # That of the floor, which is most of it, within four standard errors.
    assert abs(entry.gradient_norm - 15.1) < 4.0 * np.hypot(1.1, entry.gradient_error)


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "unit"), [("mars-drag-tracking", km), ("mars-range-tracking", 20.0)]
)
def test_gains_of_the_missions_are_better_on_draws_they_have_not_seen(name, unit):
    """Tuned on 256 draws: the spread of the range is less, beyond the confidence interval,
    and the altitude no worse."""
    mission = find_mission(name)
    result = tune(
        mission.scenario(),
        lambda s: (s.guidance.gains, s.guidance.observer),
        MeanSquare(lambda misses: misses.downrange / unit),
        optimistix.LBFGS(rtol=1e-6, atol=1e-6),
        Draws(mission.dispersion_table(), jax.random.key(0), held_out=2000),
        budget=Budget(steps=4),
    )
    judgement = result.judgement
    assert judgement.runs == 2000
    for statistic in ("std", "95 % of |.|"):
        assert judgement["downrange", statistic].lower
        altitude = judgement["altitude", statistic]
        assert altitude.change.value < 1e-4 * altitude.before.value
    assert set(result.gradient_shares.values()) == {1.0}


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
