"""Campaigns on disk: written part by part, resumed after a kill, read as one dataset.

A campaign is a folder: `campaign.json` says what is flown, and each `runs-*.nc` holds a
range of runs. A part is written under another name, flushed to the disk and then renamed,
so that whatever stands there is whole.
"""

import contextlib
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ..flight.fly import Flight
from ..flight.misses import misses
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver, FixedStep
from .description import describe, first_difference
from .dispersions import Dispersion, key_of
from .errors import CampaignError
from .monte_carlo import Campaign, fly_in_blocks
from .results import dataset


if TYPE_CHECKING:
    import xarray

MANIFEST = "campaign.json"
_PART = re.compile(r"runs-(\d{9})-(\d{9})\.nc")
_ESSENTIAL = {"scenario", "seed", "versions"}


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
    report: Callable[[int], None] = lambda stored: None,
    **labels: str,
) -> None:
    """Fly a campaign into a folder, or what of it is not there yet.

    Interrupted at any moment, it is resumed by the same call and ends with the same
    numbers. More runs of the same campaign are added by a larger `runs`.

    **Arguments:**

    - `out`: folder; made if it does not exist.
    - `inputs`: in place of dispersions, values by address.
    - `report`: is told how many runs are stored, whenever that changes.
    - `labels`: such as the mission; kept in the results.

    **Raises:** `CampaignError` for a folder with another campaign or with something else,
    `ValueError` for what cannot be flown.
    """
    out = Path(out)
    key = None if inputs is not None else key_of(seed)

    def blocks_of(runs: int | np.ndarray) -> Iterator[Campaign]:
        return fly_in_blocks(
            scenario,
            dispersions,
            key,
            runs,
            inputs=inputs,
            solver=solver,
            history=history,
        )

    blocks_of(runs)  # flies nothing yet, and refuses what cannot be flown
    description = describe(
        scenario, dispersions, seed, solver, history, inputs, **labels
    )
    if out.exists() and not out.is_dir():
        raise CampaignError(f"{out} is a file: give a folder for the campaign")
    out.mkdir(parents=True, exist_ok=True)
    with _alone_in(out):
        _claim(out, description)
        stored = _stored(out, runs)
        done = int(np.sum(stored))
        report(done)
        for missing in _unbroken(np.flatnonzero(~stored)):
            for block in blocks_of(missing):
                _write_part(out, scenario, block, description)
                done += len(block.runs)
                report(done)


def write_flight(
    path: Path | str,
    scenario: Scenario,
    flight: Flight,
    solver: AbstractSolver,
    history: float | None,
    **labels: str,
) -> None:
    """Write one flight as a campaign of one run, a netCDF file."""
    flown = flight, misses(scenario, flight)
    block = Campaign(
        np.arange(1), {}, *jax.tree.map(lambda x: np.asarray(x)[None], flown)
    )
    part = dataset(scenario, block, history)
    description = describe(scenario, None, 0, solver, history, None, **labels)
    part.attrs["campaign"] = json.dumps(description)
    _write_whole(Path(path), _netcdf(part))


def open_campaign(out: Path | str, runs: int | None = None) -> "xarray.Dataset":
    """The stored runs as one `xarray.Dataset`, in the order of the runs.

    **Arguments:**

    - `out`: folder of a campaign.
    - `runs`: the first so many only.

    **Raises:** `CampaignError` for a folder that holds no campaign, or a part that cannot
    be read.
    """
    import xarray

    out = Path(out)
    description = _read_manifest(out)
    parts = _parts(out)
    if not parts:
        raise CampaignError(f"{out} holds no runs yet: run its campaign first")
    opened: list[xarray.Dataset] = []
    for _, _, path in parts:
        try:
            with xarray.open_dataset(path, engine="h5netcdf") as part:
                opened.append(part.load())
        except (OSError, ValueError, KeyError) as error:
            raise CampaignError(
                f"{path} cannot be read ({error}): delete it and run the same campaign "
                "again, which flies what is missing"
            ) from error
    result = xarray.concat(
        opened, dim="run", data_vars="minimal", combine_attrs="drop_conflicts"
    )
    # Parts overlap where a campaign was resumed after another division into parts.
    indices, places = np.unique(result["run"].values, return_index=True)
    if runs is not None:
        places = places[indices < runs]
    result = result.isel(run=places)
    if not np.array_equal(result["run"], np.arange(len(places))):
        raise CampaignError(
            f"{out} lacks some of its runs: run the same campaign again, which flies them"
        )
    result.attrs["campaign"] = json.dumps(description)
    return result


@contextlib.contextmanager
def _alone_in(out: Path) -> Iterator[None]:
    """Keep other processes from flying into a folder at the same time."""
    try:
        import fcntl
    except ImportError:  # Windows has no such lock
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


def _claim(out: Path, description: Mapping[str, Any]) -> None:
    """Make the folder this campaign's, or find that it is already.

    A folder of another campaign that has no runs yet holds nothing, and is taken over.
    """
    manifest = out / MANIFEST
    has_runs = bool(_parts(out))
    if has_runs and not manifest.exists():
        raise CampaignError(
            f"{out} has runs but no {MANIFEST}: it is not known what was flown; give "
            "another folder"
        )
    text = json.dumps(description)
    known = _read_manifest(out) if manifest.exists() else None
    different = known and first_difference(known, json.loads(text))
    if known is None or (different and not has_runs):
        _write_whole(manifest, text.encode())
    elif different:
        raise CampaignError(
            f"{out} holds another campaign: {different}. Give another folder, or the "
            "same options as before"
        )


def _read_manifest(out: Path) -> dict[str, Any]:
    manifest = out / MANIFEST
    if not manifest.exists():
        raise CampaignError(f"{out} holds no campaign: there is no {MANIFEST} in it")
    try:
        known = json.loads(manifest.read_text())
    except (OSError, ValueError) as error:
        raise CampaignError(f"{manifest} is no campaign of jentry ({error})") from error
    if not isinstance(known, dict) or not _ESSENTIAL <= set(known):
        raise CampaignError(f"{manifest} is no campaign of jentry: give another folder")
    return known


def _parts(out: Path) -> list[tuple[int, int, Path]]:
    """First run, last run and file of each part, in order."""
    found = []
    for path in out.iterdir():
        match = _PART.fullmatch(path.name)
        if match:
            found.append((int(match[1]), int(match[2]), path))
    return sorted(found)


def _stored(out: Path, runs: int) -> np.ndarray:
    """Which of the first runs are stored."""
    stored = np.zeros(runs, dtype=bool)
    for first, last, _ in _parts(out):
        stored[first : last + 1] = True
    return stored


def _unbroken(indices: np.ndarray) -> list[np.ndarray]:
    """Indices in rising order, split where they are not consecutive."""
    if not indices.size:
        return []
    return np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1)


def _write_part(
    out: Path, scenario: Scenario, block: Campaign, description: Mapping[str, Any]
) -> None:
    part = dataset(scenario, block, description["history_interval"])
    for name in ("seed", "versions"):
        part.attrs[name] = json.dumps(description[name])
    scalars = {
        address: leaf
        for address, leaf in description["scenario"].items()
        if not isinstance(leaf["value"], list)
    }
    part.attrs["scenario"] = json.dumps(scalars)
    name = f"runs-{block.runs[0]:09d}-{block.runs[-1]:09d}.nc"
    _write_whole(out / name, _netcdf(part))


def _netcdf(part: "xarray.Dataset") -> bytes:
    """A netCDF file in memory. HDF5 itself dies of a full disk; Python only raises."""
    return bytes(part.to_netcdf(engine="h5netcdf"))


def _write_whole(path: Path, contents: bytes) -> None:
    """Write a file so that it is there whole or not at all, also after a crash."""
    unfinished = path.with_name(f".{path.name}.unfinished")
    try:
        with open(unfinished, "wb") as file:
            file.write(contents)
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
