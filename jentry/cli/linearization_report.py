"""Output of `jentry linearize`: a table, a figure and a file of all numbers."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from .._files import write_whole
from .._printed import quantity_in_words
from ..analysis.frozen_loop import FrozenLoop, Worst
from ..fields import units_of
from ..flight.flight import Flight
from ..missions.choice import Choice
from ..missions.mission import Mission
from ..plots import save_figures
from ..plots.eigenvalues import draw_eigenvalues
from ..units import at_edge
from .tables import new_console, new_table, print_under


def print_loop(mission: Mission, loop: FrozenLoop, faster_than: float = 0.0) -> None:
    """Print eigenvalues and zeros at each point of the flight, and the worst of all.

    The damping counts only modes with eigenvalues larger than `faster_than`, per unit of
    the index.
    """
    console = new_console()
    index, unit = at_edge(loop.index, loop.unit)
    seconds = units_of(Flight)["time"]
    over = loop.over if unit == "1" else f"{loop.over}, {unit}"
    heads = [f"time, {seconds}", "largest real part", "least damping", "eigenvalues"]
    heads += ["zeros"] if loop.zeros is not None else []
    table = new_table(over, *heads)
    counts = (np.abs(loop.eigenvalues) > faster_than) | (faster_than == 0.0)
    damping = np.where(counts, loop.damping, np.inf)
    for point, value in enumerate(index):
        eigenvalues = loop.per_span[point]
        cells = [f"{loop.time[point]:.1f}"]
        cells += [_shown(np.max(np.real(eigenvalues), initial=-np.inf))]
        least = np.min(damping[point], initial=np.inf)
        cells += [f"{least:z.3f}" if np.isfinite(least) else "-"]
        cells += [_in_short(eigenvalues)]
        if loop.zeros is not None:
            cells += [_in_short(loop.zeros[point] * loop.span)]
        table.add_row(f"{value:.6g}", *cells)
    span = quantity_in_words(loop.span, loop.unit)
    title = f"{mission.name}: closed loop at equal {loop.over}, rates per {span} passed"
    print_under(console, title, table)
    console.print(
        "with negative real parts errors decay. The loop is frozen: a guide where it "
        "changes slowly, not a proof"
    )
    console.print(f"deviations: {', '.join(loop.coordinates)}")
    for names, why in (
        (loop.ignorable, "nothing depends on them"),
        (loop.forgotten, "each decision replaces them, which is deadbeat"),
    ):
        if names:
            console.print(f"left out, since {why}: {', '.join(names)}")
    if np.isinf(loop.eigenvalues).any():
        console.print(
            "deadbeat: an error vanishes within one guidance cycle. Its multiplier is "
            "zero, which has no finite eigenvalue"
        )
    grows, swings = loop.largest_real_part, _least(loop, faster_than)
    largest = _shown(grows.value * loop.span)
    console.print(f"largest real part {largest}, {_place(loop, grows)}")
    per = "1" if loop.unit == "1" else f"1/{loop.unit}"
    which = (
        "" if faster_than == 0.0 else f" of eigenvalues beyond {faster_than:g} {per}"
    )
    if np.isnan(swings.value):
        console.print(f"least damping{which}: there are none")
    else:
        console.print(
            f"least damping{which} {swings.value:z.3f}, {_place(loop, swings)}"
        )
    if loop.without_zeros:
        console.print(f"no zeros: {loop.without_zeros}")


def _least(loop: FrozenLoop, faster_than: float) -> Worst:
    return loop.least_damping_of(faster_than) if faster_than else loop.least_damping


def _place(loop: FrozenLoop, worst: Worst) -> str:
    where = quantity_in_words(worst.index, loop.unit)
    seconds = units_of(Flight)["time"]
    return f"at {loop.over} {where}, {worst.time:.1f} {seconds} after the start"


def _shown(number: float) -> str:
    return "deadbeat" if np.isneginf(number) else f"{number:z.3g}"


def _in_short(numbers: np.ndarray) -> str:
    """Text of complex numbers in rising order; a conjugate pair is one entry."""
    said = []
    for number in np.sort_complex(numbers[~np.isnan(numbers)]):
        real = _shown(number.real)
        if number.imag == 0.0 or np.isinf(number):
            said.append(real)
        elif number.imag > 0.0:
            pair = np.any(np.isclose(numbers, np.conj(number), rtol=1e-9, atol=0.0))
            said.append(f"{real}{'±' if pair else '+'}{number.imag:.3g}i")
        elif not np.any(np.isclose(numbers, np.conj(number), rtol=1e-9, atol=0.0)):
            said.append(f"{real}{number.imag:.3g}i")
    return "  ".join(said) or "none"


def write_loop(
    path: Path,
    mission: Mission,
    choice: Choice,
    loop: FrozenLoop,
    faster_than: float = 0.0,
) -> tuple[Path, Path]:
    """Write the figure, and beside it a JSON file with all digits of every number."""
    title = f"{mission.name} {choice}: closed loop at equal {loop.over}"
    (figure,) = save_figures({path.stem: draw_eigenvalues(loop, title)}, path.parent)
    numbers = figure.with_suffix(".json")
    told = {"mission": mission.name, **choice.labels} | {
        name: _plain(value) for name, value in vars(loop).items()
    }
    least = _least(loop, faster_than).value
    told["faster_than"] = faster_than
    told["least_damping"] = None if np.isnan(least) else least
    write_whole(numbers, (json.dumps(told, indent=1, allow_nan=False) + "\n").encode())
    return figure, numbers


def _plain(value: Any) -> Any:
    """Plain value for JSON: a complex number is a pair, or null if it is not finite."""
    if isinstance(value, np.ndarray):
        if np.iscomplexobj(value):
            pairs = np.stack([value.real, value.imag], axis=-1)
            finite = np.isfinite(value)
            return _complex(pairs.tolist(), finite.tolist())
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def _complex(pairs: list, finite: list) -> list:
    return [
        _complex(pair, known) if isinstance(known, list) else (pair if known else None)
        for pair, known in zip(pairs, finite, strict=True)
    ]
