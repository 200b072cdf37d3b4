"""Tables of `jentry sensitivity`: derivatives; predicted and flown spreads."""

from typing import Any

import numpy as np

from ..addresses import unit_of
from ..analysis.covariance import LinearCovariance
from ..analysis.sensitivities import Sensitivity
from ..fields import units_of
from ..flight.miss import Misses
from ..flight.scenario import Scenario
from ..units import at_edge
from .tables import new_console, new_table, print_under


_UNITS = units_of(Misses)

_SIDE_BY_SIDE = 3
"""Number of misses whose effects fit side by side"""


_HOLDS_WITHIN = 0.1
"""Share of the flown standard deviation within which a prediction holds"""


def print_sensitivity(scenario: Scenario, found: Sensitivity) -> None:
    """Print the Jacobian in SI units."""
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
    return output != "crossrange" or scenario.dynamics.has_crossrange


def print_covariance(
    scenario: Scenario, analysis: LinearCovariance, factor: float
) -> None:
    """Print predicted and flown spreads, and how linear each dispersion acts."""
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
        edge, unit = at_edge(np.array(numbers), _UNITS[name])
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
            f"NOTHING is predicted for the flights that end by {name}, {share:.1%}: the "
            "nominal flight does not meet it"
        )
    if analysis.choosing:
        console.print(
            f"no slopes by what only chooses: {', '.join(analysis.choosing)}; the "
            "prediction leaves the effect of this out"
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
                edge, _ = at_edge(numbers, _UNITS[name])
                cells += [f"{x:z.4f}" for x in edge]
            table.add_row(dispersion, *cells)
        print_under(console, "effect of one standard deviation, same units", table)
