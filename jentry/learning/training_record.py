"""The course of a training of a neural law, and the file from which it resumes."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..campaign.resumed_file import (
    part_of,
    read_with_description,
    write_with_description,
)
from .flight_residuals import Weights
from .weight_steps import State


_KIND = "jentry law training 2"

PERCENTILES = 50.0, 95.0, 99.0, 99.9
"""Percentiles of the distance in a judgement"""


class HeldOut(NamedTuple):
    """Distances of flights that no step uses."""

    distances: tuple[float, ...]
    """`PERCENTILES` of the distance"""
    without_end: int
    """Number of flights without an end"""


@dataclasses.dataclass(frozen=True)
class Judged:
    """Weights at one place of a training, on flights that no step uses."""

    method: int
    """Position of the method"""
    step: int
    """Number of steps of this method so far"""
    flights: int
    """Number of flights with derivatives so far, of all methods"""
    seconds: float
    """Time since the start of the training, s, with compilation"""
    loss: float
    """Loss of the last step; NaN before the first"""
    distances: tuple[float, ...]
    """`PERCENTILES` of the distance"""
    without_end: int
    """Number of judged flights without an end"""
    left_out: int
    """Number of flights, of all steps so far, that had no end or no finite derivatives"""
    clipped: int
    """Number of flights, of all steps so far, that counted less than half, since their
    derivatives are large"""

    def better_than(self, other: "Judged", percentile: float) -> bool:
        """Fewer flights without an end or, if equal, a smaller percentile of the distance.

        The percentile is one of `PERCENTILES`.
        """
        place = PERCENTILES.index(percentile)
        mine, theirs = ((x.without_end, x.distances[place]) for x in (self, other))
        return mine < theirs


def best_of(course: Sequence[Judged], percentile: float) -> int | None:
    """Position of the best weights in a course, by a percentile; None in an empty one."""
    best = None
    for place, judged in enumerate(course):
        if best is None or judged.better_than(course[best], percentile):
            best = place
    return best


@dataclasses.dataclass
class Progress:
    """All that a training needs to go on."""

    method: int
    step: int
    weights: Weights
    state: State
    best: Weights
    course: list[Judged]
    flights: int = 0
    left_out: int = 0
    clipped: int = 0
    seconds: float = 0.0
    loss: float = np.nan
    value: State = dataclasses.field(default_factory=dict)
    """Arrays of the value of a training through segments; empty without them"""


_ARRAYS = "weights", "best"
_NUMBERS = (
    "method",
    "step",
    "flights",
    "left_out",
    "clipped",
    "seconds",
    "loss",
)


@dataclasses.dataclass(frozen=True)
class TrainingFile:
    """The file from which a training resumes, and the description of the training."""

    path: Path
    description: dict[str, Any]
    """Description in plain values, which can be written as JSON"""

    def write(self, progress: Progress) -> None:
        """Write all that is needed to resume."""
        course = [dataclasses.asdict(judged) for judged in progress.course]
        arrays = {n: np.asarray(getattr(progress, n)) for n in (*_NUMBERS, *_ARRAYS)}
        arrays |= {f"state/{n}": x for n, x in progress.state.items()}
        arrays |= {f"value/{n}": x for n, x in progress.value.items()}
        arrays["course"] = np.array(json.dumps(course))
        write_with_description(self.path, arrays, self.description, _KIND)

    def read(self) -> Progress | None:
        """The stored progress, or None if there is no file.

        **Raises:** `ValueError` for a file that is no record of a training, or that belongs
        to another one.
        """
        if not self.path.exists():
            return None
        arrays = read_with_description(self.path, self.description, _KIND, "training")
        course = [
            Judged(**{**each, "distances": tuple(each["distances"])})
            for each in json.loads(str(arrays["course"]))
        ]
        numbers: dict[str, Any] = {n: arrays[n].item() for n in _NUMBERS}
        numbers |= {n: arrays[n] for n in _ARRAYS}
        state, value = (part_of(arrays, name) for name in ("state", "value"))
        return Progress(state=state, course=course, value=value, **numbers)
