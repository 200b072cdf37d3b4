"""Output of `jentry optimize` and `jentry footprint`: tables, files and figures."""

import shlex
from pathlib import Path

import numpy as np

from .._files import write_toml, write_whole
from .._printed import in_words
from ..addresses import leaves_by_address, unit_of
from ..campaign.store import write_flight
from ..fields import units_of
from ..flight.flight import Flight
from ..flight.solver import FixedStep
from ..missions.choice import Choice
from ..missions.mission import Mission
from ..motion.state import EntryState
from ..planning.flight_problem import AtEnd, FlightProblem, Peak
from ..planning.landing_footprint import Footprint
from ..planning.optimization import Optimized
from ..plots import save_figures
from ..plots.footprint import draw_footprint
from ..plots.one_flight import draw_flight
from ..tuning.saving import with_unit
from ..units import at_edge, km
from .free_controls_table import table_of
from .overrides import Overrides
from .tables import new_console, new_table, print_under


def print_optimized(
    mission: Mission, choice: Choice, problem: FlightProblem, best: Optimized
) -> None:
    """Print the objective, the end of the flight, and the constraints."""
    console = new_console()
    sign = -1.0 if problem.largest else 1.0
    words, unit = _described(problem, best)
    rows = [("at the start", sign * best.at_start), ("at best", sign * best.objective)]
    if str(choice) in problem.published:
        rows.append(("published", problem.published[str(choice)]))
    aim = "largest" if problem.largest else "smallest"
    table = new_table(f"{aim} {words}", "value", "unit")
    for name, value in rows:
        number, shown = at_edge(value, unit)
        table.add_row(name, f"{float(number):.6f}", shown)
    table.add_section()
    table.add_row("time", f"{float(best.flight.time):.4f}", units_of(Flight)["time"])
    for name, its_unit in units_of(EntryState).items():
        number, shown = at_edge(getattr(best.flight.state, name), its_unit)
        table.add_row(in_words(name), f"{float(number):z.6f}", shown)
    print_under(console, f"{mission.name}, {choice}", table)
    if best.constraints:
        print_under(console, "constraints", _constraints(problem, best))
    console.print(
        f"{best.iterations} iterations, {best.flights} flights with derivatives; "
        f"{best.slope_left:.1e} of the slope is left"
    )
    for remark in best.remarks:
        console.print(f"note: {remark}")


def _described(problem: FlightProblem, best: Optimized) -> tuple[str, str]:
    """The objective in words, and its SI unit."""
    objective = problem.objective
    if isinstance(objective, AtEnd):
        return f"{in_words(objective.name)} at the end", objective.unit
    if isinstance(objective, Peak):
        constraint = best.scenario.constraints[objective.name]
        words = f"peak of the {in_words(objective.name)}"
        return words, constraint.shown_unit or constraint.unit
    return getattr(objective, "__name__", type(objective).__name__), "1"


def _constraints(problem: FlightProblem, best: Optimized):
    """Table with extremes and limit of each quantity, and how many entries bind."""
    table = new_table("quantity", "least", "largest", "to keep", "unit", "binding")
    for name, values in best.constraints.items():
        known = values[np.isfinite(values)]
        stated = problem.constraints.get(name)
        if stated is not None:
            quantity = stated.quantity
            unit = quantity.unit if isinstance(quantity, AtEnd) else "1"
            low, high = stated.least, stated.most
        else:
            constraint = best.scenario.constraints[name]
            unit = constraint.shown_unit or constraint.unit
            assert constraint.limit is not None
            low, high = -np.inf, float(constraint.limit)
        sides = [x for x in (low, high) if np.isfinite(x)]
        shown, _ = at_edge([*known, *sides], unit)
        word = at_edge([*known, *sides], unit)[1]
        limits = [f"{x:.6g}" for x in shown[len(known) :]]
        kept = limits[0] if low == high else " to ".join(limits)
        if np.isinf(low):
            kept = f"at most {kept}"
        elif np.isinf(high):
            kept = f"at least {kept}"
        of = "" if known.size == 1 else f" of {known.size}"
        binding = f"{len(best.active.get(name, ()))}{of}"
        own = shown[: len(known)]
        table.add_row(
            in_words(name), f"{own.min():.6g}", f"{own.max():.6g}", kept, word, binding
        )
    return table


def write_optimized(
    folder: Path,
    given: str,
    mission: Mission,
    choice: Choice,
    problem: FlightProblem,
    best: Optimized,
    overrides: Overrides,
    step: float | None,
) -> list[Path]:
    """Write the best flight as a configuration, as a history, and as a figure.

    `given` is the mission as the command line names it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    configuration, history = folder / "optimized.toml", folder / "flight.nc"
    scenario = best.scenario
    leaves = leaves_by_address(scenario)
    breakpoints = [
        address.replace("coefficients", "breakpoints") for address in best.values
    ]
    set_to = {
        **overrides.values,
        **{a: leaves[a] for a in (*breakpoints, *best.values)},
    }
    sign = -1.0 if problem.largest else 1.0
    contents = {
        **choice.labels,
        "set": {a: with_unit(x, unit_of(scenario, a)) for a, x in set_to.items()},
        "free_controls": overrides.free_controls or table_of(problem),
        "optimized": {
            "objective": sign * best.objective,
            "objective_at_start": sign * best.at_start,
            "slope_left": best.slope_left,
            "iterations": best.iterations,
            "remarks": list(best.remarks),
        },
    }
    stepped = "" if step is None else f" --step {step:g}"
    write_toml(
        configuration,
        f"{mission.name}, the best flight found by jentry optimize. Fly it:\n"
        f"jentry fly {shlex.quote(given)} --config FILE{stepped}",
        contents,
    )
    solver = FixedStep(step)
    write_flight(
        history,
        scenario,
        best.flight,
        solver,
        problem.history,
        **mission.labels,
        **choice.labels,
    )
    words, _ = _described(problem, best)
    aim = "largest" if problem.largest else "smallest"
    figure = draw_flight(best.scenario, best.flight, f"{mission.title}: {aim} {words}")
    save_figures({"best-flight": figure}, folder / "figures")
    return [configuration, history, folder / "figures" / "best-flight.png"]


def print_footprint(mission: Mission, choice: Choice, found: Footprint) -> None:
    """Print the points on the outline of the footprint, in order around it."""
    console = new_console()
    table = new_table("downrange", "crossrange", "time", "iterations", "slope left")
    for number, best in enumerate(found.flights):
        table.add_row(
            f"{found.downrange[number] / km:.3f} km",
            f"{found.crossrange[number] / km:.3f} km",
            f"{float(best.flight.time):.2f} s",
            f"{best.iterations}",
            f"{best.slope_left:.1e}",
        )
    title = f"{mission.name}, {choice}: landing footprint, crossrange to the left"
    print_under(console, title, table)
    for reason in found.failed:
        console.print(f"no flight at {reason}")
    for remark in dict.fromkeys(r for best in found.flights for r in best.remarks):
        console.print(f"note: {remark}")


def write_footprint(
    folder: Path, mission: Mission, choice: Choice, found: Footprint
) -> list[Path]:
    """Write the points as a table, and the figure."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["downrange_m,crossrange_m,time_s"]
    for number, best in enumerate(found.flights):
        point = found.downrange[number], found.crossrange[number], best.flight.time
        lines.append(",".join(repr(float(x)) for x in point))
    table = folder / "footprint.csv"
    write_whole(table, ("\n".join(lines) + "\n").encode())
    figure = draw_footprint(found, f"{mission.title}: {choice}")
    return [table, *save_figures({"footprint": figure}, folder / "figures")]
