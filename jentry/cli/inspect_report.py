"""Tables of `jentry inspect`, and the run that it flies again."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from .._printed import in_words
from ..addresses import unit_of
from ..analysis.sensitivities import sensitivity
from ..campaign.campaign import monte_carlo
from ..campaign.outputs import edge_of
from ..campaign.results import OutputNamed, dataset
from ..campaign.store import write_campaign
from ..flight.cycle import Plan
from ..flight.scenario import Scenario
from ..flight.solver import FixedStep
from ..flight.termination import Outcome
from ..missions.mission import Mission
from ..plots import save_figures
from ..plots.one_flight import flight_figures
from ..statistics.intervals import CONFIDENCE, Interval
from ..statistics.ranking import WorstRun, inputs_of
from .figures import interval_of
from .tables import in_digits, new_console, print_in_pieces


if TYPE_CHECKING:
    import xarray


FOLDER = "inspect"
"""Folder for the run, inside the folder of the campaign"""


def print_worst(
    results: "xarray.Dataset", name: str, worst: Sequence[WorstRun], count: int
) -> None:
    """Print the worst runs. Each input is given by the share of runs that are below it."""
    unit, size = edge_of(results[name], results[name].values)
    addresses = list(inputs_of(results))
    heads = ["run", f"{in_words(name)} ({unit})", "outcome", *addresses]
    rows = []
    for each in worst:
        outcome = Outcome(int(results["outcome"].values[each.run]))
        shares = (f"{100.0 * each.ranks[address]:.1f} %" for address in addresses)
        value = in_digits(each.value / size)
        rows.append((str(each.run), value, outcome.name.lower(), *shares))
    title = (
        f"the worst {len(worst)} of {count} runs by {in_words(name)}; inputs: share of "
        "the runs that are below, equal ones counted half"
    )
    print_in_pieces(new_console(), title, heads, rows, repeated=3)


def print_correlations(
    results: "xarray.Dataset", asked: str, found: dict[str, Interval], flights: int
) -> None:
    """Print the rank correlations of an output with the inputs."""
    heads = ("input", "rank correlation", f"interval of {CONFIDENCE:.0%}")
    rows = [
        (
            address,
            f"{correlation.value:+.3f}",
            "-"
            if np.isnan(correlation.lower)
            else f"{correlation.lower:+.3f} … {correlation.upper:+.3f}",
        )
        for address, correlation in found.items()
    ]
    console = new_console()
    if not rows:
        console.print(f"no input of {flights} finite flights varies with {asked}")
        return
    title = f"{in_words(asked)}: rank correlation with the inputs, {flights} flights"
    print_in_pieces(console, title, heads, rows)


def print_gradient(
    scenario: Scenario,
    solver: FixedStep,
    results: "xarray.Dataset",
    name: str,
    run: int,
    inputs: Mapping[str, float],
) -> None:
    """Print the effect of one standard deviation of each input on an output of a run."""
    console = new_console()
    choices = [address for address in inputs if results[address].attrs.get("choice")]
    if choices:
        console.print(f"no derivatives by discrete choices: {', '.join(choices)}")
    if len(choices) == len(inputs):
        return
    try:
        found = sensitivity(
            scenario, outputs=OutputNamed(name), solver=solver, inputs=inputs
        )
    except ValueError as error:
        console.print(f"run {run} has no derivatives of {in_words(name)}: {error}")
        return
    (slopes,) = found.jacobian.values()
    population = inputs_of(results)
    effects = {
        address: float(slope) * _spread(population[address])
        for address, slope in slopes.items()
        if address not in choices
    }
    shown_unit, size = edge_of(results[name], list(effects.values()))
    shown = np.array(list(effects.values())) / size
    rows = []
    order = np.argsort(-np.abs(shown), kind="stable")
    for place in order:
        address = list(effects)[place]
        rows.append(
            (
                address,
                f"{float(slopes[address]):.6g}",
                unit_of(scenario, address),
                in_digits(float(shown[place]), "+"),
                shown_unit,
            )
        )
    heads = ("input", "derivative, SI", "of", "by one std of the runs", "unit")
    title = f"run {run}: exact derivatives of the {in_words(name)}, while it ends by "
    print_in_pieces(console, title + found.ended_by, heads, rows)


def _spread(values: np.ndarray) -> float:
    return float(np.std(values, ddof=1)) if values.size > 1 else float("nan")


def fly_again(
    folder: Path,
    mission: Mission,
    scenario: Scenario,
    results: "xarray.Dataset",
    run: int,
    solver: FixedStep,
    description: Mapping[str, Any],
    history: float | None,
) -> None:
    """Fly a stored run again, compare all bits of its numbers, store and draw it."""
    inputs = {address: values for address, values in inputs_of(results).items()}
    kept = description["history_interval"]
    same = monte_carlo(scenario, runs=[run], inputs=inputs, solver=solver, history=kept)
    console = new_console()
    stored = results.isel(run=[run])
    different = _different(stored, dataset(scenario, same, kept))
    if different:
        named = ", ".join(f"{name} by {by:.1e}" for name, by in different.items())
        console.print(
            f"run {run} flown again differs from what is stored: {named}. It was flown on "
            "another processor, or by another version of jentry or of its dependencies"
        )
    else:
        console.print(
            f"run {run} flown again: every stored number agrees, to the last bit"
        )
    if history is None:
        # The usual interval of a history, with the steps of the campaign.
        solver = FixedStep(Plan.of(scenario, solver, kept).step)
        interval = interval_of(scenario, solver, math.inf)
    else:
        interval = history
    flown = monte_carlo(
        scenario, runs=[run], inputs=inputs, solver=solver, history=interval
    )
    flight = jax.tree.map(lambda x: x[0], flown.flights)
    again = dataset(scenario, flown, interval)
    ends = _different(stored.drop_dims("time", errors="ignore"), again)
    if ends and not different:
        name, largest = max(ends.items(), key=lambda pair: pair[1])
        console.print(
            f"with its history it takes other steps and differs: {name} by {largest:.1e}"
        )
    target = folder / FOLDER
    target.mkdir(parents=True, exist_ok=True)
    path = target / f"run-{run:09d}.nc"
    as_flown = {**description, "history_interval": interval}
    write_campaign(path, scenario, flown, as_flown)
    title = f"{mission.title}, run {run}"
    figures = flight_figures(scenario, flight, title, path.stem)
    console.print(f"written: {path}")
    for drawn in save_figures(figures, target):
        console.print(f"figure: {drawn}")


def _different(stored: "xarray.Dataset", flown: "xarray.Dataset") -> dict[str, float]:
    """Largest differences of outputs that are not equal to the last bit, by name."""
    found = {}
    for name in map(str, stored.data_vars):
        one, other = stored[name].values, flown[name].values
        if one.shape != other.shape:
            found[name] = float("inf")
        elif not np.array_equal(one, other, equal_nan=one.dtype.kind == "f"):
            found[name] = float(np.nanmax(np.abs(one.astype(float) - other)))
    return found
