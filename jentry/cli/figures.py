"""The figures of a campaign: what is flown for them, and where they go."""

import atexit
import math
import os
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import TYPE_CHECKING

import numpy as np

from ..addresses import leaves_by_address
from ..campaign.batch import LANES
from ..campaign.campaign import drawn_inputs, monte_carlo
from ..campaign.dispersions import Dispersion, key_of
from ..campaign.results import dataset
from ..campaign.samplers import AbstractSampler
from ..flight.cycle import varies
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..guidance.law import AbstractLaw, AbstractSampledLaw
from ..missions.mission import Mission


if TYPE_CHECKING:
    import xarray


_INTERVAL = 0.5
"""s; the longest guidance cycle of a law whose cycle varies"""

_TRAJECTORIES = 4 * LANES - 1
"""Runs whose trajectories make the bands, if the campaign has not kept them. With the
nominal flight they are whole batches."""


class Histories:
    """The flights of a campaign's figures: its first runs, with histories, and the nominal.

    They fly in a thread of their own beside the campaign. What compiles, or reads what has
    been compiled, keeps one core busy, and each of the two does so for as long.
    """

    def __init__(self, fly: Callable[[], "xarray.Dataset"]):
        self._fly = fly
        self._flown: Future[xarray.Dataset] | None = None

    def begin(self) -> None:
        """Let them begin, if they have not."""
        if self._flown is None:
            self._flown = Future()
            threading.Thread(target=self._run, daemon=True).start()

    def flown(self) -> "xarray.Dataset":
        """All of them, the nominal flight last. Raises what flying has raised."""
        self.begin()
        assert self._flown is not None
        return self._flown.result()

    def _run(self) -> None:
        assert self._flown is not None
        try:
            self._flown.set_result(self._fly())
        except BaseException as error:
            self._flown.set_exception(error)

    def __enter__(self) -> "Histories":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_) -> None:
        """An error waits for them: XLA must not be torn down while it works. Ctrl-C does
        not wait, and tears nothing down."""
        if kind is None or self._flown is None or self._flown.done():
            return
        if issubclass(kind, KeyboardInterrupt):
            atexit.register(os._exit, 130)
        else:
            self._flown.exception()


def histories_of(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion] | None,
    seed: int,
    inputs: Mapping[str, np.ndarray] | None,
    runs: int,
    history: float | None,
    solver: AbstractSolver,
    sampler: AbstractSampler | None = None,
) -> Histories:
    """Those of a campaign of given or drawn inputs.

    Where the campaign keeps histories itself only the nominal flight is flown.
    """

    def fly() -> "xarray.Dataset":
        # One run at least is drawn, for the addresses.
        first = np.arange(1 if history else min(runs, _TRAJECTORIES))
        if inputs is None:
            assert dispersions is not None
            drawn = drawn_inputs(scenario, dispersions, key_of(seed), first, sampler)
        else:
            drawn = {address: values[first] for address, values in inputs.items()}
        flown = slice(0, 0 if history else None)
        # The nominal flight is one more run, so that one program flies them all.
        nominal = leaves_by_address(scenario)
        given = {a: np.append(x[flown], nominal[a]) for a, x in drawn.items()}
        return _fly(scenario, given, solver)

    return Histories(fly)


def draw_figures(
    folder, mission: Mission, scenario: Scenario, results, histories: Histories
):
    """Draw the figures of stored results into `figures` below their folder."""
    from ..plots import FigureData, campaign_figures, save_figures

    flown = histories.flown()
    nominal = flown.isel(run=[-1])
    trajectories = results if "time" in results.dims else flown.isel(run=slice(0, -1))
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
