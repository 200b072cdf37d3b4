"""A draw that cannot be flown is refused before the first flight."""

import sys

import cheap
import jax
import numpy as np
import optax
import optimistix
import pytest

from jentry import linear_covariance, tune
from jentry.campaign import (
    Dispersion,
    Normal,
    Uniform,
    batch,
    draw,
    monte_carlo,
    multiply,
)
from jentry.campaign.batch import LANES
from jentry.campaign.campaign import fly_in_blocks
from jentry.campaign.dispersions import check_dispersions
from jentry.campaign.distributions import Constant
from jentry.tuning import Budget, Draws
from jentry.tuning.draws import held_out
from jentry.tuning.losses import MeanSquare


# Compiled as the runs of `test_monte_carlo` are.
pytestmark = [pytest.mark.optimized, pytest.mark.batches]


@jax.jit
def shares_of(key, runs):
    """Of the unit interval, what runs draw for their mass."""
    unit = {"mass": Dispersion(lambda s: s.vehicle.mass, Uniform(0.0, 1.0))}
    return jax.vmap(lambda run: draw(unit, key, run)["mass"])(runs)


@pytest.fixture(scope="module")
def late():
    """A key whose smallest mass is drawn by a run that is not among the first 64."""
    keys = map(jax.random.key, range(20))
    return next(k for k in keys if np.argmin(shares_of(k, FEW)) >= LANES)


def below_zero_once(key, runs):
    """A uniform mass of which one run of these draws a negative one: also which, and it."""
    shares = np.asarray(shares_of(key, runs))
    least, next_to_it = np.sort(shares)[:2]
    border = 0.5 * (least + next_to_it)
    lower = -1000.0 * border / (1.0 - border)
    mass = Dispersion(lambda s: s.vehicle.mass, Uniform(lower, 1000.0))
    table = cheap.dispersions() | {"mass": mass}
    run = int(np.argmin(shares))
    return table, run, lower + (1000.0 - lower) * least


@pytest.fixture
def nothing_flies(monkeypatch):
    def flies(*given):
        raise AssertionError("a flight was flown")

    for name in ("over_blocks", "fly_run"):
        monkeypatch.setattr(sys.modules[fly_in_blocks.__module__], name, flies)


def refusal(run, value):
    """Names dispersion, run, address, value, and what was expected."""
    return (
        f"dispersions.mass, run {run}: vehicle.mass is {value:g} kg: it must be greater "
        "than zero"
    )


FEW = np.arange(3 * LANES)


def test_all_draws_are_looked_at_before_the_first_flight(
    late, nothing_flies, monkeypatch
):
    """Also those of later blocks than the first."""
    monkeypatch.setattr(batch, "_CHUNKS", 1)
    key = late
    table, run, value = below_zero_once(key, FEW)
    assert run >= LANES  # in another block than the first
    message = refusal(run, value)
    with pytest.raises(ValueError, match=message):
        monte_carlo(cheap.scenario(), table, key, len(FEW), solver=cheap.SOLVER)
    # Not one that iterates, either: the blocks are made when they are asked for.
    with pytest.raises(ValueError, match=message):
        fly_in_blocks(cheap.scenario(), table, key, len(FEW), solver=cheap.SOLVER)
    with pytest.raises(ValueError, match=message):
        monte_carlo(cheap.scenario(), table, key, [0, run, 1], solver=cheap.SOLVER)


def test_runs_without_the_draw_that_cannot_be_flown_are_flown(key):
    table, run, _ = below_zero_once(key, FEW)
    flown = monte_carlo(cheap.scenario(), table, key, run, solver=cheap.SOLVER)
    assert len(flown.runs) == run and np.all(flown.inputs["vehicle.mass"] > 0.0)


def test_every_dispersion_that_moves_the_leaf_is_named(key, nothing_flies):
    table, run, value = below_zero_once(key, FEW)
    table["factor"] = Dispersion(
        lambda s: s.vehicle.mass, Constant(2.0), apply=multiply
    )
    message = rf"dispersions.mass and dispersions.factor, run {run}: vehicle.mass is "
    with pytest.raises(ValueError, match=f"{message}{2.0 * value:g} kg"):
        monte_carlo(cheap.scenario(), table, key, len(FEW), solver=cheap.SOLVER)


def test_draws_of_infinity_are_refused(key, nothing_flies):
    table = {"mass": Dispersion(lambda s: s.vehicle.mass, Normal(1.7e308, 1e307))}
    with pytest.raises(
        ValueError, match=r"mass, run \d+: vehicle.mass is inf: it must"
    ):
        monte_carlo(cheap.scenario(), table, key, len(FEW), solver=cheap.SOLVER)


def test_a_given_input_that_cannot_be_flown_is_named_with_its_run():
    masses = np.full(100, 900.0)
    masses[[40, 70]] = -3.0, np.nan
    with pytest.raises(ValueError, match="the inputs, run 40: vehicle.mass is -3 kg"):
        monte_carlo(cheap.scenario(), inputs={"vehicle.mass": masses})


def test_a_campaign_of_which_a_draw_cannot_be_flown_is_not_begun(tmp_path):
    """And one that is stored is not gone on with; fewer runs are."""
    seed = cheap.SEED
    table, run, value = below_zero_once(jax.random.key(seed), FEW)
    message = refusal(run, value)
    out = tmp_path / "out"
    with pytest.raises(ValueError, match=message):
        cheap.campaign(out, len(FEW), table=table)
    assert not out.exists()
    cheap.campaign(out, min(run, 5), table=table)
    before = {path: path.read_bytes() for path in out.iterdir()}
    with pytest.raises(ValueError, match=message):
        cheap.campaign(out, len(FEW), table=table)
    assert {path: path.read_bytes() for path in out.iterdir()} == before


@pytest.mark.parametrize("fresh", [False, True], ids=["held out", "later steps"])
def test_tuning_looks_at_all_its_draws_first(late, fresh, nothing_flies):
    """Of the runs that it is judged by, and of the fresh draws of later steps."""
    runs, steps, key = LANES, 3, late
    table, run, value = below_zero_once(key if fresh else held_out(key), FEW)
    assert run >= runs or not fresh  # not in the first step
    with pytest.raises(ValueError, match=refusal(run, value)):
        tune(
            cheap.scenario(),
            lambda s: s.guidance.bank_angle,
            MeanSquare(lambda misses: misses.downrange),
            optax.adam(0.1) if fresh else optimistix.LBFGS(rtol=1e-6, atol=1e-6),
            Draws(table, key, runs, 16 if fresh else len(FEW), fresh),
            budget=Budget(steps),
            solver=cheap.SOLVER,
        )


def test_linear_covariance_looks_at_its_draws_first(key, nothing_flies):
    table, run, value = below_zero_once(key, FEW)
    with pytest.raises(ValueError, match=refusal(run, value)):
        linear_covariance(
            cheap.scenario(), table, key=key, runs=len(FEW), solver=cheap.SOLVER
        )


@pytest.mark.parametrize(
    ("distribution", "refused"),
    [(Normal(1.0, 0.1), True), (Uniform(0.9, 1.1), True), (Normal(990.0, 9.0), False)],
)
def test_a_factor_that_would_replace_a_mass_is_refused(distribution, refused):
    table = {"mass": Dispersion(lambda s: s.vehicle.mass, distribution)}
    if not refused:
        check_dispersions(cheap.scenario(), table)
        return
    said = (
        r"'mass' replaces vehicle.mass, which is 992 kg, by draws about 1 kg.*multiply"
    )
    with pytest.raises(ValueError, match=said):
        check_dispersions(cheap.scenario(), table)


def test_the_number_of_a_seed_is_a_key():
    table = cheap.mass_only()
    runs = [
        monte_carlo(cheap.scenario(), table, key, 3) for key in (7, jax.random.key(7))
    ]
    np.testing.assert_array_equal(*(run.inputs["vehicle.mass"] for run in runs))
