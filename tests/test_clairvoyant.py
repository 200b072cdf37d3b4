"""The floor of each draw is the best constant bank that a root finder finds for it."""

import functools

import cheap
import equinox as eqx
import jax
import pytest
from helpers import fly_compiled, mars_scenario, with_leaf
from scipy import optimize

from jentry.analysis import clairvoyant_floor
from jentry.campaign import Dispersion, Uniform, monte_carlo
from jentry.flight import misses
from jentry.guidance import BankProfile
from jentry.onboard import PolynomialProfile
from jentry.tuning import MeanSquare
from jentry.units import km


KEY = jax.random.key(11)

RUNS, END = 3, 503.0

TABLE = {"density": Dispersion(lambda s: s.planet.density_scale, Uniform(0.9, 1.1))}


def downrange(misses):
    return misses.downrange / km


def given(**changes):
    known = {"runs": RUNS, "end_velocity": END, "coefficients": 1}
    return known | {"solver": cheap.SOLVER} | changes


@functools.cache
def floor():
    return clairvoyant_floor(
        mars_scenario(), MeanSquare(downrange), TABLE, KEY, **given()
    )


@functools.cache
def drawn():
    flown = monte_carlo(mars_scenario(), TABLE, KEY, RUNS, solver=cheap.SOLVER)
    return flown.inputs["planet.density_scale"], flown.misses.downrange


def missed(density, cos_bank):
    """By a constant bank, through this density."""
    profile = PolynomialProfile([cos_bank], END, 6750.0 - END)
    law = BankProfile(profile, mars_scenario().vehicle.trim_angle_of_attack)
    scenario = eqx.tree_at(lambda s: s.guidance, mars_scenario(), law)
    scenario = with_leaf(scenario, lambda s: s.planet.density_scale, density)
    return misses(scenario, fly_compiled(scenario, cheap.SOLVER))


@pytest.mark.slow
@pytest.mark.parametrize("run", range(RUNS))
def test_the_best_bank_of_a_draw_is_where_the_miss_changes_its_sign(run):
    best, coefficients = floor()
    density = drawn()[0][run]
    expected = optimize.brentq(
        lambda c: float(missed(density, c).downrange), 0.2, 0.95, xtol=1e-10
    )
    # Levenberg-Marquardt stops at steps of 1e-6, behind which it is quadratic.
    assert coefficients[run] == pytest.approx([expected], abs=1e-6)
    there = missed(density, expected)
    assert float(best.altitude[run]) == pytest.approx(float(there.altitude), abs=1.0)
    assert abs(best.downrange[run]) < 1.0
    # And far from what the same profile does for all draws.
    assert abs(drawn()[1][run]) > 1e3


@pytest.mark.slow
def test_the_floor_has_the_shape_of_its_runs():
    best, coefficients = floor()
    assert coefficients.shape == (RUNS, 1)
    assert best.downrange.shape == best.altitude.shape == (RUNS,)


def test_what_has_no_floor_is_refused():
    loss = MeanSquare(downrange)
    with pytest.raises(ValueError, match="a bank profile to one side cannot meet"):
        clairvoyant_floor(cheap.scenario(), loss, TABLE, KEY, **given())
    with pytest.raises(ValueError, match="coefficients is 0: it must be at least 1"):
        clairvoyant_floor(mars_scenario(), loss, TABLE, KEY, **given(coefficients=0))
    unreached = {"x": Dispersion(lambda s: s.termination.names, Uniform(0.9, 1.1))}
    with pytest.raises(ValueError, match="dispersion 'x'"):
        clairvoyant_floor(mars_scenario(), loss, unreached, KEY, **given())
