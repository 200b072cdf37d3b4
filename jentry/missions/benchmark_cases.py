"""Cases of `jentry benchmark`: missions, each in a world and with dispersions."""

import dataclasses

from ..campaign.outputs import MISS_DISTANCE
from ..statistics.lost_flights import MISS_OVER_GROUND
from .mission import Mission


@dataclasses.dataclass(frozen=True)
class BenchmarkCase:
    """A mission in a world, with dispersions that are equal for all laws."""

    name: str
    mission: str
    """Name of the mission, or your own file"""
    laws: tuple[str, ...]
    """Laws that fly unless others are chosen: few, since each compiles two programs"""
    dispersions: tuple[str, ...]
    """Names of dispersions. A law flies with the first of them that goes with it: those
    of a sensor need a law with that sensor. They draw equal numbers for equal names"""
    case: str | None = None
    worlds: tuple[str, ...] = ()
    measure: str = MISS_OVER_GROUND
    """Error by which the laws are ranked"""
    resolution: float = 10.0
    """Error, SI, below which flights are equally good in profiles of performance"""
    runs: int = 50
    """Runs of a set of the long form"""


_DRAG = "table-3", "state-feedback", "observer-feedback", "pseudospectral-with-range"
_VELOCITY = "velocity_error"

CASES = {
    case.name: case
    for case in (
        BenchmarkCase(
            "mars-drag-tracking",
            "mars-drag-tracking",
            _DRAG,
            ("lift-to-drag-held",),
            runs=1000,
        ),
        BenchmarkCase(
            "mars-range-tracking",
            "mars-range-tracking",
            ("range-tracking", "predictor-corrector", "terminal-point", "neural"),
            ("lift-to-drag-held",),
            runs=1000,
        ),
        BenchmarkCase(
            "mars-range-tracking-hard-air",
            "mars-range-tracking",
            ("range-tracking", "predictor-corrector", "neural"),
            ("hard-air", "hard-air-without-noise"),
            worlds=("hard-air",),
            runs=1000,
        ),
        BenchmarkCase(
            "mars-range-tracking-inertial",
            "mars-range-tracking",
            ("range-tracking", "predictor-corrector", "neural"),
            ("lift-to-drag-held-and-knowledge",),
            worlds=("inertial",),
            runs=1000,
        ),
        BenchmarkCase(
            "mars-range-tracking-aided",
            "mars-range-tracking",
            ("range-tracking", "neural"),
            ("lift-to-drag-held-and-knowledge",),
            worlds=("aided",),
            runs=1000,
        ),
        BenchmarkCase(
            "cav-h",
            "cav-h",
            ("newton", "learning", "stored", "neural"),
            ("normal-sensed", "normal"),
            measure=_VELOCITY,
            resolution=0.1,
            runs=500,
        ),
        BenchmarkCase(
            "cav-h-waves",
            "cav-h",
            ("newton", "learning", "neural"),
            ("waves-sensed",),
            measure=_VELOCITY,
            resolution=0.1,
            runs=500,
        ),
        BenchmarkCase(
            "sx-2", "sx-2", ("full", "predictor-corrector"), ("everything",), runs=100
        ),
        BenchmarkCase(
            "rlv",
            "rlv",
            ("modulation", "predictor-corrector"),
            ("table-1",),
            runs=25,
        ),
        BenchmarkCase(
            "x-33",
            "x-33",
            ("with-range", "predictor-corrector", "shuttle"),
            ("everything",),
            runs=50,
        ),
        BenchmarkCase(
            "apollo-10",
            "apollo-10",
            ("predictor-corrector", "apollo-steered", "neural"),
            ("everything",),
            runs=50,
        ),
        BenchmarkCase(
            "cav-h-glide",
            "cav-h-glide",
            ("predictor-corrector", "undamped"),
            ("everything",),
            runs=50,
        ),
    )
}
"""The cases by name"""


def case_of(mission: Mission, file: str) -> BenchmarkCase:
    """The case of your own mission: all of its laws, with its first dispersions.

    **Raises:** `ValueError` for a mission without dispersions, and for one with the name of
    another case.
    """
    if not mission.dispersions:
        raise ValueError(
            f"mission {mission.name} of {file} has no dispersions: a benchmark flies "
            "dispersed flights, so give it some"
        )
    return BenchmarkCase(
        name=mission.name,
        mission=file,
        laws=tuple(mission.laws),
        dispersions=tuple(mission.dispersions)[:1],
        measure=MISS_DISTANCE,
        resolution=1.0,
    )
