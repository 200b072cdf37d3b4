"""`benchmark.json`: all statistics of a benchmark, sealed, and read to lay it beside."""

import json
import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from .._files import write_whole
from ..campaign.parts import digest_of
from ..statistics.benchmark import FACTORS, RANKED, LawStatistics, Statistic
from ..statistics.intervals import CONFIDENCE, Interval
from .benchmark_runs import Entry, Prepared, machine


JSON = "benchmark.json"

_KIND = "jentry benchmark 1"
_DIGEST = "digest"
_LOST = "lost"
"""An infinite error in the file: that of a lost flight"""

Record = dict[str, Any]


def record_of(
    cases: Sequence[tuple[Prepared, int, Sequence[LawStatistics]]],
    seed: int,
    sets: int,
    step: float | None,
) -> Record:
    """All numbers of a benchmark as plain values, SI, without what time was taken.

    **Arguments:**

    - `cases`: every case with the runs of a set and the statistics of its laws.
    """
    record = {
        "kind": _KIND,
        "versions": {name: version(name) for name in ("jentry", "jax")},
        "machine": machine(),
        "seed": seed,
        "sets": sets,
        "step": step,
        "confidence": CONFIDENCE,
        "ranked_by_percentile": RANKED,
        "profile_factors": [float(x) for x in FACTORS],
        "cases": [_case(*each) for each in cases],
        "skipped": [
            {"case": made.case.name, "law": law, "why": why}
            for made, _, _ in cases
            for law, why in made.skipped.items()
        ],
    }
    return {**record, _DIGEST: digest_of(record)}


def _case(made: Prepared, size: int, laws: Sequence[LawStatistics]) -> Record:
    case = made.case
    return {
        "name": case.name,
        "mission": made.mission.name,
        "title": made.mission.title,
        "case": case.case,
        "worlds": list(case.worlds),
        "measure": case.measure,
        "resolution": case.resolution,
        "runs_in_a_set": size,
        "laws": [
            _law(entry, law) for entry, law in zip(made.entries, laws, strict=True)
        ],
    }


def _law(entry: Entry, law: LawStatistics) -> Record:
    return {
        "name": law.name,
        "own": entry.own,
        "dispersions": entry.dispersions,
        "draws": law.draws,
        "other_draws": law.other_draws,
        "rank": _interval(law.rank),
        "profile": list(law.shares),
        "statistics": {name: _plain(x) for name, x in law.statistics.items()},
    }


def _plain(statistic: Statistic) -> Record:
    return {
        "unit": statistic.unit,
        **_interval(statistic.all_runs),
        "needs_runs": statistic.needs,
        "mean_of_sets": _number(statistic.mean),
        "deviation_of_sets": _number(statistic.deviation),
        "sets": [_number(x) for x in statistic.sets],
    }


def _interval(interval: Interval) -> Record:
    return {name: _number(x) for name, x in interval._asdict().items()}


def _number(value: float) -> float | str | None:
    """A number for JSON: null if it is not known."""
    if math.isinf(value):
        return _LOST
    return None if math.isnan(value) else float(value)


def number_of(plain: float | str | None) -> float:
    """The inverse: a number of the file, infinite for a lost flight, NaN if not known."""
    if plain is None:
        return math.nan
    return math.inf if plain == _LOST else float(plain)


def write_record(folder: Path, record: Record) -> Path:
    """Write `benchmark.json` into a folder."""
    text = json.dumps(record, indent=2, allow_nan=False) + "\n"
    write_whole(folder / JSON, text.encode())
    return folder / JSON


def read_record(path: Path) -> Record:
    """A benchmark that `write_record` has written.

    **Raises:** `ValueError` for another file, and for one that was changed since.
    """
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(
            f"{path} is no result of jentry benchmark: {error}; give the {JSON} of its "
            "folder"
        ) from None
    kind = record.get("kind") if isinstance(record, dict) else None
    if kind != _KIND:
        raise ValueError(
            f"{path} is of the kind {kind!r}, not {_KIND!r}: give the {JSON} of a folder "
            "of jentry benchmark"
        )
    sealed = {name: x for name, x in record.items() if name != _DIGEST}
    if record.get(_DIGEST) != digest_of(sealed):
        raise ValueError(
            f"{path} was changed since it was written: its digest is not that of its "
            "numbers; run that benchmark again"
        )
    return record


def beside(path: Path, settings: Mapping[str, Any]) -> Record:
    """A stored benchmark with the seed, the sets and the runs of this one.

    **Arguments:**

    - `settings`: `seed`, `sets`, `step`, and `cases` with the runs of a set by name.

    **Raises:** `ValueError` for the reasons of `read_record`, for other settings, and if
    there is no case in common.
    """
    record = read_record(path)
    for name in ("seed", "sets", "step"):
        if record[name] != settings[name]:
            raise ValueError(
                f"{path} has {name} {record[name]}, and this benchmark {settings[name]}: "
                f"lay a result with equal {name} beside it"
            )
    common = 0
    for case in record["cases"]:
        runs = settings["cases"].get(case["name"])
        if runs is None:
            continue
        common += 1
        if case["runs_in_a_set"] != runs:
            raise ValueError(
                f"{path} has sets of {case['runs_in_a_set']} runs in {case['name']}, and "
                f"this benchmark of {runs}: lay a result with equal sets beside it"
            )
    if not common:
        raise ValueError(
            f"{path} has none of these cases: {', '.join(settings['cases'])}"
        )
    return record


def refuse_other_settings(folder: Path, settings: Mapping[str, Any]) -> None:
    """Refuse a folder with a benchmark of another seed or of another step.

    Its campaigns cannot be continued. Other numbers of sets and runs can.
    """
    if not (folder / JSON).exists():
        return
    known = read_record(folder / JSON)
    for name in ("seed", "step"):
        if known[name] != settings[name]:
            raise ValueError(
                f"{folder} holds a benchmark with {name} {known[name]}, and now it is "
                f"{settings[name]}: give another folder by --out"
            )
