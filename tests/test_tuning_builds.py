"""Tuning of the numbers from which a function builds the scenario."""

import cheap
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cheap_tuning import ADDRESS, BEST, RUNS, SIMULATION, bank, scenario, tuned
from helpers import mars_scenario, with_leaf

from jentry.parameters.parameters import Parameters
from jentry.planning.reference_flight import plan_bank_profile
from jentry.tuning import AutomaticDifferentiation, Bounds, Scale, mean_square
from jentry.tuning.batch_gradients import Problem
from jentry.tuning.gradients import batch_loss
from jentry.units import degree, km


pytestmark = pytest.mark.optimized  # of few programs each flies thousands of flights

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
        (HALF, None, lambda p: p, "the scenario is a dict: give a Scenario"),
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
