"""Output of `jentry tune`: steps, values, judgement on held-out draws, course."""

import csv
import io
from pathlib import Path

import numpy as np
from rich.console import Console

from .._files import write_whole
from .._printed import in_words
from ..addresses import unit_of
from ..analysis.frozen_loop import linearize
from ..campaign.outputs import error_of, peak_of
from ..fields import units_of
from ..flight.miss import Misses
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..missions.mission import Mission
from ..tuning.judgement import Comparison
from ..tuning.record import NUMBERS, Entry
from ..tuning.tuning import Tuned
from ..units import at_edge
from .tables import in_digits, new_console, new_table, print_under
from .tuning_options import DAMPING_POINTS


_SAME = 1e-4
"""Relative change of a statistic below which a significant change is of no interest"""


def report_step(course: list[Entry], best: int) -> None:
    """Print a line for a step on standard error."""
    entry = course[-1]
    line = f"step {len(course):4}  loss {entry.loss:.6g}  best {course[best].loss:.6g}"
    line += f"  gradient {entry.gradient_norm:.3g}"
    if np.isfinite(entry.gradient_error):
        line += f" +- {entry.gradient_error:.2g}"
    line += f"  {entry.seconds:.0f} s"
    if entry.failed:
        line += f"  {entry.failed} not finite"
    if entry.gradients_failed:
        line += f"  {entry.gradients_failed} without gradient"
    Console(stderr=True, highlight=False).print(line)


def print_tuned(mission: Mission, before: Scenario, tuned: Tuned) -> None:
    """Print tuned values, the flights behind their gradient, and the judgement."""
    console = new_console()
    first, best = tuned.course[0], tuned.course[tuned.best]
    console.print(
        f"stopped: {tuned.stopped}; best of {len(tuned.course)} steps is number "
        f"{tuned.best + 1}, loss {first.loss:.6g} -> {best.loss:.6g}"
    )
    if tuned.penalties is not None:
        was, is_ = tuned.penalties
        console.print(f"penalty within the loss {was:.4g} -> {is_:.4g}")
    for remark in tuned.remarks:
        console.print(f"NOTE: {remark}")
    most = max(tuned.course, key=lambda entry: entry.gradients_failed)
    if most.gradients_failed:
        console.print(
            "flights left out of the gradient, since theirs was not finite or too large: "
            f"{best.gradients_failed} at the best step, at most {most.gradients_failed} "
            "at any step"
        )
    table = new_table("address", "unit", "before", "tuned", "felt by")
    for address, value in tuned.values.items():
        unit, share = (
            unit_of(before, address),
            f"{100.0 * tuned.gradient_shares[address]:.0f} %",
        )
        old = first.values[address]
        if value.shape == ():
            table.add_row(
                address, unit, f"{float(old):.6g}", f"{float(value):.6g}", share
            )
        else:
            size = " x ".join(str(n) for n in value.shape)
            change = np.max(np.abs(value - old))
            table.add_row(
                address, unit, f"table of {size}", f"{change:.3g} at most", share
            )
    title = f"{mission.name}: share of the flights whose gradient feels each number"
    print_under(console, title, table)
    unfelt = [a for a, share in tuned.gradient_shares.items() if share == 0.0]
    if unfelt:
        console.print(
            f"no flight's gradient feels {', '.join(unfelt)}: it acts through a "
            "discrete choice or behind a limit, and "
            + ("is unchanged" if tuned.penalties is None else "is left to the penalty")
        )
    print_judgement(before, tuned)


def print_judgement(scenario: Scenario, tuned: Tuned) -> None:
    """Print statistics before and after tuning on held-out draws, with 95 % intervals."""
    console, judgement = new_console(), tuned.judgement
    lost = judgement.not_finite_before, judgement.not_finite_after
    if any(lost):
        console.print(
            f"held-out flights left out, not finite: {lost[0]} before, {lost[1]} tuned"
        )
    if not judgement.comparisons:
        console.print("no two held-out flights are finite: the result is NOT judged")
        return
    table = new_table("", "unit", "before", "tuned", "change", "95 % interval", "")
    for comparison in judgement.comparisons:
        if _is_nothing(comparison):
            continue
        name, unit = comparison.quantity, "1"
        if name != "loss":
            unit, words = _quantity(name, scenario)
            name = f"{words}, {comparison.statistic}"
        numbers = [comparison.before.value, comparison.after.value]
        change = comparison.change
        numbers += [change.value, change.low, change.high]
        (before, after, moved, low, high), unit = at_edge(np.array(numbers), unit)
        table.add_row(
            name,
            unit,
            in_digits(before),
            in_digits(after),
            in_digits(moved, "+"),
            f"{in_digits(low, '+')} to {in_digits(high, '+')}",
            _verdict(comparison),
        )
    title = f"{judgement.runs} held-out draws, exact law, the same for both"
    print_under(console, title, table)
    if not judgement["loss", ""].lower:
        console.print(
            "the loss is NOT significantly lower on held-out draws: tune on more runs, or "
            "discard the result"
            + ("" if tuned.penalties is None else "; the penalty is not in this loss")
        )


def _quantity(name: str, scenario: Scenario) -> tuple[str, str]:
    """Unit and name in words of an output of `Misses` or `MissesAndPeaks`."""
    if name not in units_of(Misses):
        constraint = scenario.constraints[name]
        return constraint.shown_unit or constraint.unit, in_words(peak_of(name))
    return units_of(Misses)[name], in_words(error_of(name))


def print_damping(
    faster_than: float, before: Scenario, tuned: Tuned, solver: AbstractSolver
) -> None:
    """Print the least damping before and after tuning, along the nominal flights."""
    told = []
    for scenario in (before, tuned.scenario):
        try:
            loop = linearize(scenario, points=DAMPING_POINTS, solver=solver)
        except ValueError as error:
            told.append(f"not known ({error})")
            continue
        least = loop.least_damping_of(faster_than)
        none = np.isnan(least.value)
        told.append("none" if none else f"{least.value:.3f} at {least.time:.0f} s")
    new_console().print(
        f"least damping of modes faster than {faster_than:g} rad/s, frozen: "
        f"{told[0]} -> {told[1]}"
    )


def _is_nothing(comparison: Comparison) -> bool:
    """Whether a quantity is zero, such as the crossrange of a flight in a plane."""
    largest = max(abs(comparison.before.value), abs(comparison.after.value))
    return comparison.quantity != "loss" and largest < 1e-6


def _verdict(comparison: Comparison) -> str:
    change = comparison.change
    if change.low <= 0.0 <= change.high:
        return "even"
    if abs(change.value) < _SAME * abs(comparison.before.value):
        return "same"
    if comparison.statistic == "mean":
        return "higher" if change.low > 0.0 else "lower"
    return "lower" if comparison.lower else "HIGHER"


def write_course(path: Path, tuned: Tuned) -> None:
    """Write loss, gradient norm and parameters of every step as csv."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = []
    for address, value in tuned.values.items():
        one = np.shape(value) == ()
        names += [address if one else f"{address}[{i}]" for i in range(value.size)]
    lines = io.StringIO()
    writer = csv.writer(lines)
    writer.writerow(["step", *NUMBERS, *names])
    for number, entry in enumerate(tuned.course, start=1):
        row = [getattr(entry, field) for field in NUMBERS]
        values = [x for a in tuned.values for x in np.ravel(entry.values[a])]
        writer.writerow([number, *row, *map(float, values)])
    write_whole(path, lines.getvalue().encode())
