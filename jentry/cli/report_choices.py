"""Choices for a report: requirements, percentiles, formats; and its exit code."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import typer

from ..statistics.acceptance import EXAMPLE, Decision, Requirement, Verdict, overall
from ..statistics.summary import PERCENTILES
from .overrides import read_toml, require_keys


_EXIT_CODES = {Decision.PASSES: 0, Decision.FAILS: 5, Decision.NOT_ENOUGH_RUNS: 6}


def chosen_requirements(
    given: Iterable[str] | None, file: Path | None
) -> list[Requirement]:
    """Requirements of the command line and of a file, each once."""
    texts = list(given or ())
    if file is not None:
        contents = read_toml(file)
        require_keys(contents, ("require",), "")
        listed = contents.get("require")
        if not isinstance(listed, list) or not all(isinstance(x, str) for x in listed):
            raise ValueError(
                f"{file} has require {listed!r}: write a list of strings, "
                f"require = [{EXAMPLE!r}]"
            )
        texts += listed
        if not listed:
            raise ValueError(
                f"{file} has no requirement: write one, or leave the file out"
            )
    return list(dict.fromkeys(map(Requirement.of, texts)))


def chosen_slice(given: str) -> tuple[int, int]:
    """Number of the slice and number of slices, from a text such as 3/10."""
    place, bar, count = given.partition("/")
    try:
        part = int(place), int(count)
    except ValueError:
        part = 0, 0
    if not bar or not 1 <= part[0] <= part[1]:
        raise ValueError(
            f"--slice is {given!r}: write a slice of the runs, such as 3/10"
        )
    return part


def chosen_percentiles(
    given: str | None, usual: Sequence[float] = PERCENTILES
) -> Sequence[float]:
    """Percentiles of the option in rising order, each once; `usual` if it is None."""
    if given is None:
        return usual
    try:
        found = [float(text) for text in given.split(",")]
    except ValueError:
        raise ValueError(
            f"--percentiles is {given!r}: write numbers separated by commas, 50,99,99.87"
        ) from None
    for wrong in [p for p in found if not 0.0 < p < 100.0][:1]:
        raise ValueError(
            f"--percentiles has {wrong:g}: each must be above 0 and below 100"
        )
    return sorted(set(found))


def chosen_formats(given: str) -> list[str]:
    """Formats of figures, each once."""
    from ..plots.campaign import FORMATS

    found = list(dict.fromkeys(name.strip() for name in given.split(",")))
    for unknown in [name for name in found if name not in FORMATS][:1]:
        raise ValueError(f"--format has {unknown!r}: choose from {', '.join(FORMATS)}")
    return found


def refuse_both(json: bool, quiet: bool) -> None:
    """Refuse `--json` with `--quiet`."""
    if json and quiet:
        raise ValueError("--json prints, and --quiet prints nothing: give one of them")


def require_runs(runs: int | None, known: int, place: object) -> None:
    """Refuse more runs than a campaign or a file has."""
    if runs is not None and runs > known:
        raise ValueError(f"--runs is {runs}, and {place} has {known}: give no more")


def leave(verdicts: Iterable[Verdict]) -> None:
    """End the command with the exit code of its requirements."""
    code = _EXIT_CODES[overall(verdicts)]
    if code:
        raise typer.Exit(code)
