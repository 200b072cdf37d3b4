"""The figures of a campaign: what is flown for them, and where they go."""

import math

import numpy as np

from ..addresses import leaves_by_address
from ..campaign.batch import LANES
from ..campaign.campaign import monte_carlo
from ..campaign.results import dataset
from ..flight.cycle import varies
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..guidance.law import AbstractLaw, AbstractSampledLaw
from ..missions.mission import Mission


_INTERVAL = 0.5
"""s; the longest guidance cycle of a law whose cycle varies"""

_TRAJECTORIES = 4 * LANES - 1
"""Runs whose trajectories make the bands, if the campaign has not kept them. With the
nominal flight they are whole batches."""


def draw_figures(folder, mission: Mission, scenario: Scenario, results, solver):
    """Draw the figures of stored results into `figures` below their folder."""
    from ..plots import FigureData, campaign_figures, save_figures

    known = leaves_by_address(scenario)
    addresses = [str(name) for name in results.data_vars if name in known]
    # The nominal flight is one more run, so that one program flies them all.
    few = 0 if "time" in results.dims else _TRAJECTORIES
    first = results.isel(run=slice(0, few))
    inputs = {a: np.append(first[a].values, known[a]) for a in addresses}
    flown = _fly(scenario, inputs, solver)
    nominal = flown.isel(run=[-1])
    trajectories = flown.isel(run=slice(0, -1)) if few else results
    data = FigureData.of(results, trajectories, nominal, scenario, mission.title)
    figures = campaign_figures(data, mission.figures)
    target = folder / "figures"
    save_figures(figures, target)
    return target


def _interval(law: AbstractLaw) -> float:
    """At which a history can be kept, s: about `_INTERVAL`, in step with the cycle."""
    if not isinstance(law, AbstractSampledLaw):
        return _INTERVAL
    period = law.cycle.period
    if varies(law):
        return period
    if period > _INTERVAL:
        return period / math.ceil(period / _INTERVAL - 1e-9)
    return period * max(1, round(_INTERVAL / period))


def _fly(scenario: Scenario, inputs, solver: AbstractSolver):
    interval = _interval(scenario.guidance)
    campaign = monte_carlo(
        scenario,
        runs=len(next(iter(inputs.values()))),
        inputs=inputs,
        solver=solver,
        history=interval,
    )
    flown = dataset(scenario, campaign, interval)
    # Up to the last end: a figure takes as long as its histories are, flying or not.
    return flown.isel(time=np.isfinite(flown["velocity"].values).any(axis=0))
