"""Synthetic runs, and what their figures show."""

import numpy as np
import xarray

from jentry._printed import in_words
from jentry.campaign.outputs import error_of
from jentry.fields import units_of
from jentry.flight import Flight, Misses
from jentry.flight.termination import Outcome
from jentry.motion import Controls, EntryState
from jentry.motion.constraints import usual_constraints
from jentry.plots import USUAL, FigureData, campaign_figures


RUNS, TIMES = 40, 61
NOT_FINITE = int(Outcome.NOT_FINITE)
LABELS = ["5–95 %", "25–75 %", "median", "nominal"]


UNITS = units_of(EntryState) | units_of(Controls) | {"time": units_of(Flight)["time"]}
UNITS |= {error_of(name): unit for name, unit in units_of(Misses).items()}
UNITS |= {name: each.unit for name, each in usual_constraints().items()}


def described(results):
    """Runs with the attributes that results have."""
    usual = usual_constraints()
    for name, variable in results.variables.items():
        if name in UNITS:
            variable.attrs["units"] = UNITS[name]
            variable.attrs["long_name"] = in_words(name)
        if name in usual and usual[name].shown_unit is not None:
            variable.attrs["shown_units"] = usual[name].shown_unit
    return results


def figures_of(results, trajectories=None, nominal=None, title="", figures=USUAL):
    data = FigureData.of(results, trajectories, nominal, None, title)
    return campaign_figures(data, figures)


def synthetic(runs=RUNS, spread=1.0):
    """Runs that slow from 6 km/s, each with drag and bank linear in velocity.

    Later runs stop earlier: run i flies 61 - i // 4 samples.
    """
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 120.0, TIMES)
    velocity = np.tile(6000.0 - 45.0 * time, (runs, 1))
    samples = TIMES - np.arange(runs) // 4
    velocity[np.arange(TIMES) >= samples[:, None]] = np.nan
    slope = 0.01 + spread * rng.uniform(0.0, 0.01, (runs, 1))
    both = ("run", "time")
    results = xarray.Dataset(
        {
            "velocity": (both, velocity),
            "drag": (both, slope * velocity),
            "altitude": (both, 10.0 * velocity + 1e6 * slope),
            "bank_angle": (both, np.where(np.isnan(velocity), np.nan, -50.0 * slope)),
            "downrange_error": ("run", spread * rng.normal(2e3, 5e3, runs)),
            "crossrange_error": ("run", np.zeros(runs)),
            "altitude_error": ("run", spread * rng.normal(0.0, 800.0, runs)),
            "outcome": ("run", np.zeros(runs, dtype=np.int8)),
            "ended_by": (
                "run",
                (np.arange(runs) % 2).astype(np.int8),
                {
                    "flag_values": np.arange(3, dtype=np.int8),
                    "flag_meanings": "velocity altitude skip_out",
                },
            ),
        },
        {"time": time, "run": np.arange(runs)},
    )
    return described(results)


def line(axes, label):
    (found,) = [line for line in axes.lines if line.get_label() == label]
    return found.get_data()


def band(axes, label):
    """Lower and upper edge of a band over its grid."""
    (found,) = [c for c in axes.collections if c.get_label() == label]
    outline = found.get_paths()[0].vertices
    grid = np.unique(outline[:, 0])
    edges = [outline[outline[:, 0] == at, 1] for at in grid]
    return grid, np.array([(edge.min(), edge.max()) for edge in edges]).T


def counts(axes):
    return [bar.get_height() for bar in axes.patches]
