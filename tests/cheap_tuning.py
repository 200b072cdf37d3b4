"""Tuning of the cheap scenario, with a target that one bank angle reaches."""

import cheap
import jax
import numpy as np
import optax
import optimistix
from helpers import with_leaf

from jentry._computed_once import computed_once
from jentry.campaign import monte_carlo
from jentry.flight import misses
from jentry.tuning import Budget, Draws, MeanSquare, Record, tune
from jentry.tuning.batch_gradients import Simulation
from jentry.units import degree, km


KEY = jax.random.key(5)
RUNS = 32

SIMULATION = Simulation(misses, cheap.SOLVER)

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


ADDRESS = "guidance.bank_angle"
