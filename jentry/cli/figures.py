"""The figures of a campaign: what is flown for them, and where they go."""

import math

import jax
import numpy as np

from ..addresses import leaves_by_address
from ..campaign.campaign import monte_carlo
from ..campaign.results import dataset
from ..flight.cycle import varies
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..guidance.law import AbstractLaw, AbstractSampledLaw
from ..missions.mission import Mission


_INTERVAL = 0.5
"""s; the longest guidance cycle of a law whose cycle varies"""

_TRAJECTORIES = 256
"""Runs whose trajectories make the bands, if the campaign has not kept them."""


def draw_figures(folder, mission: Mission, scenario: Scenario, results, solver):
    """Draw the figures of stored results into `figures` below their folder."""
    from ..plots import campaign_figures, overview, save_figures

    addresses = [name for name in results.data_vars if name in _addresses(scenario)]
    if "time" in results.dims:
        trajectories = results
    else:
        first = results.isel(run=slice(0, _TRAJECTORIES))
        inputs = {str(name): first[name].values for name in addresses}
        trajectories = _fly(scenario, inputs, solver)
    nominal_inputs = {
        str(a): np.atleast_1d(leaves_by_address(scenario)[str(a)]) for a in addresses
    }
    nominal = _fly(scenario, nominal_inputs, solver)
    figures = campaign_figures(results, trajectories, nominal, mission.title)
    figures["overview"] = overview(results, trajectories, nominal)
    target = folder / "figures"
    save_figures(figures, target)
    return target


def _addresses(scenario: Scenario) -> dict[str, jax.Array]:
    return leaves_by_address(scenario)


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
    return dataset(scenario, campaign, interval)
