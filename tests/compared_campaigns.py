"""Synthetic campaigns to compare."""

import numpy as np
import xarray

from jentry.flight import Outcome


def campaign(errors, mass=None, outcomes=None, **more):
    count = len(errors)
    outcomes = np.zeros(count) if outcomes is None else outcomes
    mass = np.arange(float(count)) if mass is None else mass
    columns = {"vehicle.mass": mass, "downrange_error": errors, **more}
    columns["outcome"] = np.asarray(outcomes, np.int8)
    return xarray.Dataset(
        {n: ("run", np.asarray(x), {"units": "m"}) for n, x in columns.items()},
        {"run": np.arange(count)},
    )


def pair(runs=300, seed=0, gain=0.5):
    draws = np.random.default_rng(seed)
    common = draws.normal(0.0, 1e3, runs)
    return common + draws.normal(0, 50, runs), gain * common + draws.normal(0, 50, runs)


def laws(runs=301):
    """Three on the same draws, of which the last fails in two ways."""
    draws = np.random.default_rng(3)
    common = draws.normal(0.0, 1e3, runs)
    errors = [common, 0.5 * common + 40.0, 2.0 * common]
    heat = [draws.uniform(9e5, 1e6, runs) for _ in range(3)]
    outcomes = np.zeros(runs)
    outcomes[:9] = Outcome.NOT_FINITE
    outcomes[9:12] = Outcome.CRASHED
    heat[2][20] = np.nan
    made = {
        name: campaign(errors[i], outcomes=outcomes if i == 2 else None)
        for i, name in enumerate(("paper's", "tuned", "other"))
    }
    for i, results in enumerate(made.values()):
        results["peak_heat_rate"] = "run", heat[i], {"units": "W/m2"}
    lost = (outcomes == Outcome.NOT_FINITE) | np.isnan(heat[2])
    return made, errors, heat, lost
