"""Campaigns of `jentry benchmark`: which laws fly in which cases, and their flights."""

import dataclasses
import json
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .._devices import cores
from .._files import write_whole
from ..addresses import nearest
from ..campaign.batch import LANES
from ..campaign.campaign import fly_in_blocks, monte_carlo
from ..campaign.dispersions import Dispersion, key_of
from ..campaign.errors import CampaignError
from ..campaign.parts import digest_of, read_manifest
from ..campaign.store import open_campaign, run_campaign
from ..flight.scenario import Scenario
from ..flight.solver import FixedStep
from ..missions import find_mission
from ..missions.benchmark_cases import CASES, BenchmarkCase, case_of
from ..missions.choice import Choice
from ..missions.mission import Mission
from ..missions.own import is_file
from ..missions.own_law import OwnLaw
from ..statistics.benchmark import Flown
from .figures import first_of, histories_of, store_histories, stored_histories


COST = "cost.json"
"""File of a campaign with the flights a second of its law"""

HISTORIES = 63
"""Number of dispersed flights with histories; with the nominal flight they fill a batch"""

_LONG_ENOUGH = 0.5
"""Seconds of a measurement that is not repeated"""


@dataclasses.dataclass(frozen=True)
class Entry:
    """A law in a case, ready to fly."""

    law: str
    own: bool
    """Whether the law is from a file of the user"""
    dispersions: str
    table: Mapping[str, Dispersion]
    scenario: Scenario
    labels: Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Prepared:
    """A case with the laws that fly in it."""

    case: BenchmarkCase
    mission: Mission
    entries: list[Entry]
    skipped: dict[str, str]
    """Why a law does not fly, by the name of the law"""


def chosen_cases(names: str | None, files: Sequence[str]) -> list[BenchmarkCase]:
    """Cases of the benchmark and of files of the user; those of `names` if it is given."""
    known = dict(CASES)
    for file in files:
        if not is_file(file):
            raise ValueError(
                f"--case is {file!r}: give a file that defines MISSION, such as "
                "my_case.py; cases of the benchmark are chosen by --cases"
            )
        own = case_of(find_mission(file), file)
        if own.name in known:
            raise ValueError(
                f"mission {own.name} of {file} has the name of another case: rename it"
            )
        known[own.name] = own
    if names is None:
        return list(known.values())
    asked = _names(names, "--cases")
    for name in asked:
        if name not in known:
            raise ValueError(
                f"no case {name!r} to fly; {nearest(name, known)}, of {', '.join(known)}"
            )
    return [known[name] for name in asked]


def _names(text: str, option: str) -> list[str]:
    found = list(dict.fromkeys(name.strip() for name in text.split(",")))
    if not all(found):
        raise ValueError(
            f"{option} is {text!r}: write names, separated by commas without a gap"
        )
    return found


def prepared(
    cases: Sequence[BenchmarkCase],
    laws: str | None,
    own: Sequence[OwnLaw],
    runs: Callable[[BenchmarkCase], int],
    seed: int,
    step: float | None,
) -> list[Prepared]:
    """Every case with its laws; nothing is flown.

    **Arguments:**

    - `laws`: names of laws, separated by commas, in place of those of the cases.
    - `own`: laws of the user, which fly in every case.
    - `runs`: number of runs in a case.

    **Raises:** `ValueError` for a law that no case has, and for a law of the user that can
    fly in no case.
    """
    for twice in [x.name for x in own if [y.name for y in own].count(x.name) > 1][:1]:
        raise ValueError(f"two files give their law the name {twice!r}: rename one")
    asked = None if laws is None else _names(laws, "--laws")
    missions = {case.name: find_mission(case.mission) for case in cases}
    every = {x.name for x in own}.union(
        *(mission.laws for mission in missions.values())
    )
    for name in asked or ():
        if name not in every:
            raise ValueError(f"no case has a law {name!r}; {nearest(name, every)}")
    made = []
    for case in cases:
        mission = missions[case.name]
        for law in own:
            mission = law.joined(mission)
        names = [*case.laws, *(law.name for law in own)]
        if asked is not None:
            names = [name for name in asked if name in mission.laws]
        entries, skipped = [], {}
        for name in names:
            try:
                code = next((x.code for x in own if x.name == name), None)
                entry = _entry(case, mission, name, code, runs(case), seed, step)
                entries.append(entry)
            except ValueError as error:
                skipped[name] = " ".join(str(error).split())
        made.append(Prepared(case, mission, entries, skipped))
    for law in own:
        if any(law.name in x.skipped for x in made) and not any(
            entry.law == law.name for x in made for entry in x.entries
        ):
            case = next(x for x in made if law.name in x.skipped)
            raise ValueError(
                f"the law {law.name} of your file flies in no case; in {case.case.name}: "
                f"{case.skipped[law.name]}"
            )
    if not any(x.entries for x in made):
        reasons = [f"{x.case.name}: {why}" for x in made for why in x.skipped.values()]
        raise ValueError(
            "no law flies in any case" + "".join(f"; {r}" for r in reasons)
        )
    return [x for x in made if x.entries or x.skipped]


def _entry(
    case: BenchmarkCase,
    mission: Mission,
    law: str,
    code: Mapping[str, str] | None,
    runs: int,
    seed: int,
    step: float | None,
) -> Entry:
    choice = Choice.given(law, case.case, case.worlds)
    scenario = mission.scenario_of(choice)
    tables = {name: mission.dispersion_table(name) for name in case.dispersions}
    refused = []
    for name, table in tables.items():
        try:  # This draws all inputs and refuses what cannot be flown. Nothing flies.
            fly_in_blocks(scenario, table, key_of(seed), runs, solver=FixedStep(step))
        except ValueError as error:
            refused.append(f"with dispersions {name}, {error}")
            continue
        labels = {**mission.labels, **choice.labels}
        if code is not None:
            labels["code"] = {**labels.get("code", {}), **code}
        return Entry(law, code is not None, name, table, scenario, labels)
    raise ValueError("; ".join(refused))


def fly(
    folder: Path,
    entry: Entry,
    seed: int,
    runs: int,
    step: float | None,
    report: Callable[[int], None],
) -> Flown:
    """Fly the runs of a law that its folder lacks, and measure its flights a second.

    The first flights, and the nominal one, have their histories stored as `jentry
    monte-carlo` stores those of its figures.
    """
    solver, many = FixedStep(step), min(runs, HISTORIES)
    histories = histories_of(
        entry.scenario, entry.table, seed, None, many, None, solver
    )
    stored_before: list[int] = []

    def count(stored: int) -> None:
        # By now `run_campaign` has checked the folder and what is flown.
        if not stored_before and not _has_histories(folder, many):
            histories.begin()
        stored_before.append(stored)
        report(stored)

    with histories:
        run_campaign(
            folder,
            entry.scenario,
            entry.table,
            seed,
            runs,
            solver=solver,
            report=count,
            **entry.labels,
        )
        campaign = digest_of(read_manifest(folder))
        if not _has_histories(folder, many):
            store_histories(folder, histories.flown(), campaign)
    flown = stored_histories(folder, campaign)
    assert flown is not None
    if not (folder / COST).exists():
        compiled = runs - stored_before[0] > LANES
        measured = _flights_a_second(entry, seed, runs, solver, compiled)
        write_whole(folder / COST, (json.dumps(measured, indent=2) + "\n").encode())
    return Flown(open_campaign(folder, runs), flown.isel(run=first_of(flown, many)))


def _has_histories(folder: Path, many: int) -> bool:
    known = stored_histories(folder, digest_of(read_manifest(folder)))
    return known is not None and known.sizes["run"] > many


def _flights_a_second(
    entry: Entry, seed: int, runs: int, solver: FixedStep, compiled: bool
) -> dict[str, Any]:
    """Flights a second of compiled batches on all cores, the best of several.

    `compiled` says whether the campaign has compiled the program. If it has not, the first
    call does, and another one is needed. A slow law is not repeated more often.
    """
    count = min(runs, LANES * len(cores()))
    seconds: list[float] = []
    least = 1 if compiled else 2
    while len(seconds) < least or (
        sum(seconds[least - 1 :]) < _LONG_ENOUGH and len(seconds) < 6
    ):
        begin = time.perf_counter()
        monte_carlo(entry.scenario, entry.table, key_of(seed), count, solver=solver)
        seconds.append(time.perf_counter() - begin)
    return {
        "flights_per_second": count / min(seconds),
        "flights": count,
        "machine": machine(),
        "measured_on": time.strftime("%Y-%m-%d"),
    }


def cost_of(folder: Path) -> dict[str, Any]:
    """The measured flights a second of a law, with their machine.

    **Raises:** `CampaignError` for a file that cannot be read.
    """
    try:
        found = json.loads((folder / COST).read_text(encoding="utf-8"))
        if not float(found["flights_per_second"]) > 0.0:
            raise ValueError(f"flights_per_second is {found['flights_per_second']}")
        return found
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise CampaignError(
            f"{folder / COST} is not as it was written ({error}): remove it, and the same "
            "command measures again"
        ) from None


def machine() -> str:
    """Name of the processor, and the number of cores that fly."""
    name = platform.processor() or platform.machine()
    try:
        lines: Iterable[str] = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(x.partition(":")[2].strip() for x in lines if "model name" in x)
    except (OSError, StopIteration):
        pass
    count = len(cores())
    return f"{name}, {count} core{'s' if count > 1 else ''}"
