"""What the commands that design read from their options and print."""

import csv
import io
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from .._addresses import leaves_by_address, nearest, require_address, unit_of
from .._files import write_whole
from ..design.judgement import Comparison
from ..design.linear_covariance import LinearCovariance
from ..design.losses import ScaledMisses
from ..design.sensitivity import Sensitivity
from ..design.tuning import Tuned
from ..design.tuning_record import NUMBERS, Entry
from ..flight.misses import Misses
from ..flight.scenario import Scenario
from ..missions.mission import Mission
from ..units import km, parse_quantity
from .tables import at_edge, new_console, new_table, print_under, unit_of_output


_MISSES = tuple(Misses.__dataclass_fields__)

_SAME = 1e-4
"""Of a statistic: a change that is real, and of no interest"""

_SIDE_BY_SIDE = 3
"""Misses whose effects fit beside one another"""

_HOLDS_WITHIN = 0.1
"""Of the flown standard deviation"""


def parse_scales(options: Iterable[str], in_plane: bool) -> ScaledMisses:
    """`MISS=SCALE` of the command line. Raises `ValueError` for what is no miss."""
    scales = {}
    for option in options:
        name, equals, scale = option.partition("=")
        if name not in _MISSES:
            raise ValueError(
                f"--of {option}: no miss {name!r}; {nearest(name, _MISSES)}"
            )
        unit = unit_of_output(None, name)
        if name in scales:
            raise ValueError(f"--of {name} is given twice: once")
        if not equals and unit != "m":
            raise ValueError(f"--of {option}: write {name}=SCALE")
        try:
            scales[name] = parse_quantity(scale, unit) if equals else km
        except ValueError as error:
            raise ValueError(f"--of {option}: {error}") from None
        if not 0.0 < scales[name] < math.inf:
            raise ValueError(f"--of {option}: the scale must be greater than zero")
    if not scales:
        scales = {"downrange": km} if in_plane else {"downrange": km, "crossrange": km}
    return ScaledMisses(tuple(scales.items()))


def parse_bounds(
    options: Iterable[str], scenario: Scenario
) -> dict[str, tuple[float, float]]:
    """`ADDRESS=LOW:HIGH` of the command line."""
    bounds = {}
    known = leaves_by_address(scenario)
    for option in options:
        address, equals, interval = option.partition("=")
        low, colon, high = interval.partition(":")
        if not equals or not colon:
            raise ValueError(f"--bounds {option}: write ADDRESS=LOW:HIGH")
        require_address(known, address)
        if address in bounds:
            raise ValueError(f"--bounds {address} is given twice: once")
        unit = unit_of(scenario, address)
        try:
            bounds[address] = parse_quantity(low, unit), parse_quantity(high, unit)
        except ValueError as error:
            raise ValueError(f"--bounds {option}: {error}") from None
    return bounds


def parse_leaf_scales(options: Iterable[str], scenario: Scenario) -> dict[str, float]:
    """`ADDRESS=VALUE` of the command line."""
    scales = {}
    known = leaves_by_address(scenario)
    for option in options:
        address, equals, value = option.partition("=")
        if not equals:
            raise ValueError(f"--scale {option}: write ADDRESS=VALUE")
        require_address(known, address)
        if address in scales:
            raise ValueError(f"--scale {address} is given twice: once")
        try:
            scales[address] = parse_quantity(value, unit_of(scenario, address))
        except ValueError as error:
            raise ValueError(f"--scale {option}: {error}") from None
    return scales


def report_step(history: list[Entry], best: int) -> None:
    """A line for each step, on standard error."""
    entry = history[-1]
    line = (
        f"step {len(history):4}  loss {entry.loss:.6g}  best {history[best].loss:.6g}"
    )
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
    """Values, what reached them, and the judgement on held-out draws."""
    console = new_console()
    first, best = tuned.history[0], tuned.history[tuned.best]
    console.print(
        f"stopped: {tuned.stopped}; best of {len(tuned.history)} steps is number "
        f"{tuned.best + 1}, loss {first.loss:.6g} -> {best.loss:.6g}"
    )
    for remark in tuned.remarks:
        console.print(f"NOTE: {remark}")
    most = max(tuned.history, key=lambda entry: entry.gradients_failed)
    if most.gradients_failed:
        console.print(
            f"left out of a gradient, which was not finite or beyond all measure: "
            f"{best.gradients_failed} flights at the best step, and "
            f"{most.gradients_failed} in the step with most of them"
        )
    table = new_table("address", "unit", "before", "tuned", "reached by")
    for address, value in tuned.values.items():
        unit, share = (
            unit_of(before, address),
            f"{100.0 * tuned.reached[address]:.0f} %",
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
    title = f"{mission.name}: share of the flights whose gradient reaches each number"
    print_under(console, title, table)
    unreached = [a for a, share in tuned.reached.items() if share == 0.0]
    if unreached:
        console.print(
            f"no gradient reaches {', '.join(unreached)}: it acts through a discrete "
            "choice or behind a limit, and stays as it was"
        )
    print_judgement(tuned)


def print_judgement(tuned: Tuned) -> None:
    """Before and after on held-out draws, with 95 % intervals."""
    console, judgement = new_console(), tuned.judgement
    lost = judgement.not_finite_before, judgement.not_finite_after
    if any(lost):
        console.print(
            f"held-out flights not finite and left out: {lost[0]} before, {lost[1]} tuned"
        )
    if not judgement.comparisons:
        console.print("no two held-out flights are finite: the result is NOT judged")
        return
    table = new_table("", "unit", "before", "tuned", "change", "95 % interval", "")
    for comparison in judgement.comparisons:
        if _is_nothing(comparison):
            continue
        name = comparison.quantity.replace("_", " ")
        unit = "1"
        if comparison.quantity != "loss":
            unit = unit_of_output(None, comparison.quantity)
            name += f" error, {comparison.statistic}"
        numbers = [comparison.before.value, comparison.after.value]
        change = comparison.change
        numbers += [change.value, change.low, change.high]
        (before, after, moved, low, high), unit = at_edge(np.array(numbers), unit)
        table.add_row(
            name,
            unit,
            f"{before:z.4f}",
            f"{after:z.4f}",
            f"{moved:+z.4f}",
            f"{low:+z.4f} to {high:+z.4f}",
            _verdict(comparison),
        )
    title = f"{judgement.runs} held-out draws, exact law, the same for both"
    print_under(console, title, table)
    if not judgement["loss", ""].lower:
        console.print(
            "the loss is NOT lower on held-out draws, beyond the interval: tune on more "
            "runs, or leave it as it was"
        )


def _is_nothing(comparison: Comparison) -> bool:
    """A quantity that is not there, such as the crossrange of a flight in its plane."""
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


def write_history(path: Path, tuned: Tuned) -> None:
    """Loss, gradient norm and parameters of every step, as csv."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = []
    for address, value in tuned.values.items():
        one = np.shape(value) == ()
        names += [address if one else f"{address}[{i}]" for i in range(value.size)]
    lines = io.StringIO()
    writer = csv.writer(lines)
    writer.writerow(["step", *NUMBERS, *names])
    for number, entry in enumerate(tuned.history, start=1):
        row = [getattr(entry, field) for field in NUMBERS]
        values = [x for a in tuned.values for x in np.ravel(entry.values[a])]
        writer.writerow([number, *row, *map(float, values)])
    write_whole(path, lines.getvalue().encode())


def print_sensitivity(scenario: Scenario, found: Sensitivity) -> None:
    """The Jacobian, in SI units."""
    outputs = [name for name in found.values if _is_shown(scenario, name)]
    table = new_table("d(output) / d(leaf), SI", "unit", *outputs)
    for address in next(iter(found.jacobian.values())):
        rows = [np.ravel(found.jacobian[name][address]) for name in outputs]
        for place, numbers in enumerate(zip(*rows, strict=True)):
            label = address if len(rows[0]) == 1 else f"{address}[{place}]"
            cells = [f"{number:.6g}" for number in numbers]
            table.add_row(label, unit_of(scenario, address), *cells)
    title = f"derivatives of the misses, while the flight ends by {found.ended_by}"
    print_under(new_console(), title, table)


def _is_shown(scenario: Scenario, output: str) -> bool:
    return not (scenario.in_plane and output == "crossrange")


def print_covariance(
    scenario: Scenario, analysis: LinearCovariance, factor: float
) -> None:
    """Predicted beside flown spreads, and how linear each dispersion is."""
    console = new_console()
    outputs = [name for name in analysis.spreads if _is_shown(scenario, name)]
    table = new_table(
        "miss",
        "unit",
        "nominal",
        "mean",
        "std",
        "flown mean",
        "flown std",
        "same draws",
        "",
    )
    for name in outputs:
        spread = analysis.spreads[name]
        numbers = [spread.nominal, spread.mean, spread.standard_deviation]
        numbers += [spread.flown_mean, spread.flown_standard_deviation]
        edge, unit = at_edge(np.array(numbers), unit_of_output(None, name))
        cells = ["" if np.isnan(x) else f"{x:z.4f}" for x in edge]
        ratio, verdict = "", ""
        if np.isfinite(spread.ratio):
            ratio = f"{spread.ratio:.3f}"
            verdict = "holds" if abs(spread.ratio - 1.0) < _HOLDS_WITHIN else "DEPARTS"
        table.add_row(name, unit, *cells, ratio, verdict)
    ends = ", ".join(analysis.models)
    models = list(analysis.models.values())
    means = any(e for m in models for row in m.errors.values() for e in row.values())
    source = "mean differences" if means else "one flight"
    title = f"dispersions x {factor:g}: predicted from {source} for each end ({ends})"
    if analysis.runs:
        title += f", beside {analysis.runs} runs"
    print_under(console, title, table)
    if analysis.failed:
        console.print(f"runs not finite or without an end, left out: {analysis.failed}")
    for name, share in analysis.without_model.items():
        console.print(
            f"NOTHING is predicted of the flights that end by {name}, {share:.1%}: the "
            "nominal flight does not meet it"
        )
    for few in (
        outputs[i : i + _SIDE_BY_SIDE] for i in range(0, len(outputs), _SIDE_BY_SIDE)
    ):
        heads = ("+-", "flown", "bend") if means else ("flown", "bend")
        table = new_table("one std of", *(x for name in few for x in (name, *heads)))
        for dispersion in next(iter(analysis.effects.values())):
            cells: list[Any] = []
            for name in few:
                effect = analysis.effects[name][dispersion]
                numbers = np.array([effect.linear, effect.flown, effect.bend])
                if means:
                    numbers = np.insert(numbers, 1, effect.error)
                edge, _ = at_edge(numbers, unit_of_output(None, name))
                cells += [f"{x:z.4f}" for x in edge]
            table.add_row(dispersion, *cells)
        print_under(console, "effect of one standard deviation, same units", table)


def print_cards(mission: Mission, cards: Mapping[str, Mapping[str, Any]]) -> None:
    """What each trained network is for, and how well it does on flights held out.

    At the entry, where a flight is adjusted first, beside the mean over all times to go;
    and what a prediction of the median would miss by there.
    """
    keys = {
        "mean error at the entry": "held out mean error at the entry, m/s",
        "of the median there": "mean deviation at the entry from the median, m/s",
        "mean, all times to go": "held out mean error, m/s",
        "95 %, all times to go": "held out 95 % error, m/s",
    }
    table = new_table("network", *(f"{title}, m/s" for title in keys))
    for name, card in cards.items():
        table.add_row(name, *(f"{card[key]:.3f}" for key in keys.values()))
    console = new_console()
    print_under(console, f"{mission.name}: trained networks, held-out errors", table)
    for name, card in cards.items():
        console.print(
            f"{name}: {card['purpose']}; trained on {card['samples']} samples"
        )
        for reason, count in card["left out"].items():
            console.print(f"  left out: {count} of flights that {reason}")
        count = card["held out samples outside of the ranges"]
        console.print(f"  held out and outside of the ranges: {count}")
