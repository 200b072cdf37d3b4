"""Campaigns on disk: written in parts, resumed after an interruption, read as one dataset.

A campaign is a folder. Its `campaign.json` describes the campaign, and each `runs-*.nc` has
a range of runs. Each file is written whole or not at all, and sealed with a digest: see
`parts`.
"""

import contextlib
import io
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._files import remove_unfinished, write_whole
from .._setup import needs_float64
from ..flight.flight import Flight
from ..flight.scenario import Scenario
from ..flight.scenario_checks import checked
from ..flight.solver import AbstractSolver, FixedStep
from .batch import device_of
from .campaign import Campaign, campaign_of_one, fly_in_blocks
from .description import describe, scalars_of
from .dispersions import Dispersion, key_of, numbers_of_streams
from .errors import CampaignError
from .parts import (
    AGAIN,
    MANIFEST,
    Part,
    Slices,
    claim,
    digest_of,
    name_of_part,
    not_as_written,
    note_slices,
    parts_of,
    read_manifest,
)
from .results import dataset
from .samplers import AbstractSampler, check_sampler


if TYPE_CHECKING:
    import xarray


@needs_float64
def run_campaign(
    out: Path | str,
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion] | None,
    seed: int,
    runs: int,
    *,
    inputs: Mapping[str, Any] | None = None,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
    sampler: AbstractSampler | None = None,
    report: Callable[[int], None] = lambda stored: None,
    part: tuple[int, int] | None = None,
    **labels: Any,
) -> None:
    """Fly the runs of a campaign that are not in a folder yet, and store them there.

    After an interruption at any moment, the same call resumes the campaign and ends with
    the same numbers. A larger `runs` adds runs to the campaign. Stored runs count only if
    they are, to the last bit, what this campaign has written.

    **Arguments:**

    - `out`: folder, created if needed.
    - `inputs`: values by address instead of dispersions.
    - `sampler`: as for `monte_carlo`. A `LatinHypercube` cannot be extended.
    - `report`: is called with the number of stored runs whenever it changes.
    - `part`: (3, 10) for the third of ten slices of the runs. Each machine flies one slice
      into a separate folder: see `merge_campaigns`.
    - `labels`: attributes of the results, such as the mission.

    **Raises:** `CampaignError` for a folder with another campaign or with other files, and
    for a damaged part. `ValueError` for inputs that cannot be flown, before the first
    flight. This includes the draws of all runs.
    """
    out = Path(out)
    scenario = checked(scenario)
    key = None if inputs is not None else key_of(seed)

    # One device flies all runs, also those that are missing after an interruption.
    device = device_of(int(runs))

    def blocks_of(runs: int | np.ndarray) -> Iterator[tuple[int, Campaign]]:
        return fly_in_blocks(
            scenario,
            dispersions,
            key,
            runs,
            inputs=inputs,
            solver=solver,
            history=history,
            sampler=sampler,
            device=device,
        )

    # This refuses inputs that cannot be flown, and flies nothing yet.
    if part is not None and dispersions and sampler is not None:
        check_sampler(sampler, numbers_of_streams(dispersions), runs)
    blocks_of(runs if part is None else runs_of_part(runs, part))
    mine = runs_of_part(runs, part)
    if device == "gpu":
        labels["device"] = device
    description = describe(
        scenario, dispersions, seed, solver, history, inputs, sampler, **labels
    )
    if out.exists() and not out.is_dir():
        raise CampaignError(f"{out} is a file: give a folder for the campaign")
    out.mkdir(parents=True, exist_ok=True)
    with alone_in(out):
        _check_device(out, device)
        description, parts = claim(out, description)
        for pattern in (MANIFEST, "runs-*"):
            remove_unfinished(out, pattern)
        campaign = digest_of(description)
        if part is not None:
            note_slices(out, Slices(campaign, int(runs), part[1]))
        stored = _stored(parts, runs)[mine]
        done = int(np.sum(stored))
        report(done)
        for missing in _unbroken(mine[~stored]):
            for _, block in blocks_of(missing):
                _write_part(out, scenario, block, description, campaign)
                done += len(block.runs)
                report(done)


def _check_device(out: Path, device: str) -> None:
    """Refuse to continue on another device: its flights differ by rounding."""
    if not (out / MANIFEST).exists() or not parts_of(out):
        return
    known = read_manifest(out).get("device", "cpu")
    if known != device:
        named = {"cpu": "the processor", "gpu": "a GPU"}
        raise CampaignError(
            f"{out} was flown on {named[known]}, and {named[device]} would fly the rest, "
            f"which rounds otherwise: give --device {known}, or "
            f'jentry.setup(device="{known}"), or another folder'
        )


def runs_of_part(runs: int, part: tuple[int, int] | None) -> np.ndarray:
    """Indices of the runs of a slice, (3, 10) for the third of ten, or of all for None.

    **Raises:** `ValueError` for a slice that does not exist or has no runs.
    """
    if part is None:
        return np.arange(max(int(runs), 0))
    place, count = part
    if not 1 <= place <= count:
        raise ValueError(
            f"the part is {place} of {count}: it must be from 1 to {count}"
        )
    if count > runs:
        raise ValueError(f"{runs} runs have no {count} parts: give fewer")
    return np.asarray(Slices("", int(runs), count).runs_of(place))


def write_flight(
    path: Path | str,
    scenario: Scenario,
    flight: Flight,
    solver: AbstractSolver,
    history: float | None,
    **labels: Any,
) -> None:
    """Write one flight as a campaign of one run, a netCDF file."""
    block = campaign_of_one(scenario, flight)
    description = describe(scenario, None, 0, solver, history, None, **labels)
    write_campaign(path, scenario, block, description)


def write_campaign(
    path: Path | str,
    scenario: Scenario,
    campaign: Campaign,
    description: Mapping[str, Any],
) -> None:
    """Write flown runs with their inputs and their description as one netCDF file."""
    part = dataset(scenario, campaign, description["history_interval"])
    part.attrs["campaign"] = json.dumps(description)
    write_whole(path, _netcdf(part))


def open_campaign(out: Path | str, runs: int | None = None) -> "xarray.Dataset":
    """The stored runs as one `xarray.Dataset`, in the order of the runs.

    **Arguments:**

    - `out`: folder of a campaign.
    - `runs`: number of runs to read, from the first. By default all.

    **Raises:** `CampaignError` for a folder without a campaign, and for a part that has
    changed since the campaign wrote it.
    """
    import xarray

    out = Path(out)
    description = read_manifest(out)
    campaign = digest_of(description)
    parts = parts_of(out)
    if not parts:
        raise CampaignError(f"{out} holds no runs yet: run its campaign first")
    opened: list[xarray.Dataset] = []
    for part in parts:
        contents = part.contents_of(campaign)
        if contents is None:
            raise not_as_written([part.path])
        # The verified bytes are opened, since the file may change meanwhile.
        with xarray.open_dataset(io.BytesIO(contents), engine="h5netcdf") as runs_of:
            opened.append(runs_of.load())
    result = xarray.concat(
        opened, dim="run", data_vars="minimal", combine_attrs="drop_conflicts"
    )
    # Parts overlap if a campaign was resumed with another division into parts.
    indices, places = np.unique(result["run"].values, return_index=True)
    if runs is not None:
        places = places[indices < runs]
    result = result.isel(run=places)
    if not np.array_equal(result["run"], np.arange(len(places))):
        raise CampaignError(
            f"{out} lacks some of its runs: {AGAIN}, or merge the parts of --slice"
        )
    result.attrs["campaign"] = json.dumps(description)
    return result


@contextlib.contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Context in which no other process can fly into the folder."""
    try:
        import fcntl
    except ImportError:  # Windows has no locks of folders
        yield
        return
    folder = os.open(out, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(folder)
        raise CampaignError(
            f"another process flies a campaign into {out}: wait for it, or give another "
            "folder"
        ) from None
    try:
        yield
    finally:
        os.close(folder)


def _stored(parts: list[Part], runs: int) -> np.ndarray:
    """Which of the first `runs` runs are stored, as bools."""
    stored = np.zeros(runs, dtype=bool)
    for part in parts:
        stored[part.first : part.last + 1] = True
    return stored


def _unbroken(indices: np.ndarray) -> list[np.ndarray]:
    """Increasing indices, split where they are not consecutive."""
    if not indices.size:
        return []
    return np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1)


def _write_part(
    out: Path,
    scenario: Scenario,
    block: Campaign,
    description: Mapping[str, Any],
    campaign: str,
) -> None:
    part = dataset(scenario, block, description["history_interval"])
    for name in ("seed", "versions"):
        part.attrs[name] = json.dumps(description[name])
    part.attrs["scenario"] = json.dumps(scalars_of(description))
    part.attrs["campaign_digest"] = campaign
    if block.flown_on:
        part.attrs["flown_on"] = block.flown_on
    contents = _netcdf(part)
    first, last = int(block.runs[0]), int(block.runs[-1])
    write_whole(out / name_of_part(campaign, first, last, contents), contents)


def _netcdf(part: "xarray.Dataset") -> bytes:
    """A netCDF file in memory. On a full disk HDF5 would crash, where Python raises."""
    return bytes(part.to_netcdf(engine="h5netcdf"))
