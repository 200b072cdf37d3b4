"""The figures of a campaign: the flights that they show, and where they are stored."""

import contextlib
import dataclasses
import io
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._files import write_whole
from ..addresses import leaves_by_address
from ..campaign.batch import LANES
from ..campaign.campaign import drawn_inputs, monte_carlo
from ..campaign.dispersions import Dispersion, key_of
from ..campaign.errors import CampaignError
from ..campaign.results import dataset
from ..campaign.samplers import AbstractSampler
from ..flight.cycle import Plan, varies
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..guidance.law import AbstractSampledLaw
from ..missions.mission import Mission


if TYPE_CHECKING:
    import xarray


FIGURES = "figures"
"""Folder of the figures, inside the folder of their campaign"""

OVERVIEW = "overview"
"""Name of the figure that is drawn as soon as a campaign has been flown"""

HISTORIES = "histories.nc"
"""File beside the figures with the flights that they show"""

_DIGEST = "campaign_digest"

_INTERVAL = 0.5
"""s; interval of a history, as long as the longest guidance cycle of a law whose cycle
varies"""

_ENTRIES = 2000
"""Approximate number of entries of a history up to the time limit of its flight. Memory
for all entries is taken at the start, some 50 MB for a batch, and a figure is 1000 pixels
wide."""

_TRAJECTORIES = 2 * LANES - 1
"""Number of runs whose trajectories make the bands, if the campaign has no histories.
With the nominal flight they fill whole batches. Twice as many would reduce the uncertainty
of the edges of a band to seven tenths, which a figure hardly shows, and would take twice
the time."""


class Histories:
    """Flights of a campaign's figures: its first runs with histories, and the nominal.

    They fly in a separate thread while the campaign flies. Each of the two compiles its
    program, or reads a cached program, on one core, which takes both equally long.
    """

    def __init__(self, fly: Callable[[], "xarray.Dataset"]):
        self._fly = fly
        self._flown: Future[xarray.Dataset] | None = None

    def begin(self) -> None:
        """Start the flights, if they have not been started."""
        if self._flown is None:
            self._flown = Future()
            threading.Thread(target=self._run, daemon=True).start()

    def flown(self) -> "xarray.Dataset":
        """All flights, the nominal flight last.

        **Raises:** the exception of the thread, if the flights failed.
        """
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
        """Wait for the thread after an error, so that it ends first; not after Ctrl-C."""
        if kind is None or self._flown is None or issubclass(kind, KeyboardInterrupt):
            return
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
    """Flights for the figures of a campaign, from drawn inputs or from `inputs`.

    If the campaign stores histories itself, only the nominal flight is flown.
    """

    def fly() -> "xarray.Dataset":
        # At least one run is drawn: it gives the addresses.
        first = np.arange(1 if history else min(runs, _TRAJECTORIES))
        if inputs is None:
            assert dispersions is not None
            drawn = drawn_inputs(scenario, dispersions, key_of(seed), first, sampler)
        else:
            drawn = {address: values[first] for address, values in inputs.items()}
        flown = slice(0, 0 if history else None)
        # The nominal flight is one more run, so that one program flies all of them.
        nominal = leaves_by_address(scenario)
        given = {a: np.append(x[flown], nominal[a]) for a, x in drawn.items()}
        return _fly(scenario, given, solver)

    return Histories(fly)


def draw_figures(
    folder: Path,
    mission: Mission,
    scenario: Scenario,
    results: "xarray.Dataset",
    flown: "xarray.Dataset | None",
    formats: Sequence[str] = ("png",),
) -> list[Path]:
    """Draw the figures of stored results into `figures` in their folder.

    `flown` has the histories for the figures, the nominal flight last. Without it, only
    histories of the results are drawn.
    """
    from ..plots import FigureData, campaign_figures, save_figures

    nominal = trajectories = None
    if flown is not None:
        nominal, trajectories = flown.isel(run=[-1]), flown.isel(run=slice(0, -1))
    if "time" in results.dims:
        trajectories = results
    data = FigureData.of(results, trajectories, nominal, scenario, mission.title)
    figures = campaign_figures(data, mission.figures)
    return save_figures(figures, folder / FIGURES, formats)


def with_overview_alone(mission: Mission) -> Mission:
    """The mission with one figure: its overview, or its first if it has no overview."""
    name = (
        OVERVIEW if OVERVIEW in mission.figures else next(iter(mission.figures), None)
    )
    figures = {} if name is None else {name: mission.figures[name]}
    return dataclasses.replace(mission, figures=figures)


def store_histories(folder: Path, flown: "xarray.Dataset", campaign: str) -> None:
    """Store the histories of the figures, so that the figures can be drawn again.

    Stored histories of this campaign with more runs are not replaced. The numbers are in
    single precision, which is enough for figures. The file has the digest of the campaign.
    """
    with contextlib.suppress(CampaignError):
        known = stored_histories(folder, campaign)
        if known is not None and known.sizes["run"] > flown.sizes["run"]:
            return
    over_time = [name for name, x in flown.data_vars.items() if "time" in x.dims]
    stored = flown.assign({name: flown[name].astype(np.float32) for name in over_time})
    stored.attrs[_DIGEST] = campaign
    small = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
    contents = stored.to_netcdf(
        engine="h5netcdf", encoding=dict.fromkeys(over_time, small)
    )
    (folder / FIGURES).mkdir(parents=True, exist_ok=True)
    write_whole(folder / FIGURES / HISTORIES, bytes(contents))


def first_of(flown: "xarray.Dataset", runs: int) -> np.ndarray:
    """Indices of the first `runs` histories, and of the nominal flight."""
    count = flown.sizes["run"]
    return np.append(np.arange(min(count - 1, runs)), count - 1)


def stored_histories(folder: Path, campaign: str) -> "xarray.Dataset | None":
    """Histories that are stored beside the figures of a campaign; None without any.

    **Raises:** `CampaignError` for a file that cannot be read or is of another campaign.
    """
    import xarray

    path = folder / FIGURES / HISTORIES
    if not path.exists():
        return None
    try:
        contents = io.BytesIO(path.read_bytes())
        with xarray.open_dataset(contents, engine="h5netcdf") as stored:
            flown = stored.load()
    except Exception as error:  # HDF5 raises many kinds for a broken file
        raise CampaignError(
            f"{path} cannot be read ({error}): delete it, and run the same campaign again"
        ) from None
    if flown.attrs.get(_DIGEST) != campaign:
        raise CampaignError(
            f"{path} is of another campaign: delete it, and run the same campaign again"
        )
    return flown


def interval_of(
    scenario: Scenario, solver: AbstractSolver, entries: float = _ENTRIES
) -> float:
    """Interval of a history, s: about `_INTERVAL`, commensurate with the guidance cycle.

    It is longer if a flight could have more than `entries` entries. It is a whole number
    of steps: with other steps the flights would differ from those of the campaign.
    """
    plan, law = Plan.of(scenario, solver, None), scenario.guidance
    about = max(_INTERVAL, scenario.termination.time_limit / entries)
    if not isinstance(law, AbstractSampledLaw):
        return plan.step * max(1, round(about / plan.step))
    period = law.cycle.period
    if varies(law):
        return period
    if period > about:
        steps, most = round(period / plan.step), math.ceil(period / about - 1e-9)
        return period / max(n for n in range(1, most + 1) if steps % n == 0)
    return period * max(1, round(about / period))


def _fly(scenario: Scenario, inputs, solver: AbstractSolver):
    interval = interval_of(scenario, solver)
    campaign = monte_carlo(
        scenario,
        runs=len(next(iter(inputs.values()))),
        inputs=inputs,
        solver=solver,
        history=interval,
    )
    flown = dataset(scenario, campaign, interval)
    # Cut at the last end: the time to draw grows with the length of the histories.
    return flown.isel(time=np.isfinite(flown["velocity"].values).any(axis=0))
