"""What a mission is: a scenario with a name, its dispersions and its published table."""

import dataclasses
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .._computed_once import known_numbers
from .._setup import needs_float64
from ..addresses import with_leaves
from ..campaign.dispersions import Dispersion
from ..flight.scenario import Scenario
from ..planning.flight_problem import FlightProblem
from ..plots.campaign import USUAL, DrawFigure


_NAME = re.compile(r"\w[\w.-]*")
_EXAMPLES = {
    "variants": "scenario",
    "dispersions": "dispersions",
    "figures": "figure",
    "problems": "problem",
}
_MEANT = {
    "variants": "without arguments that returns a Scenario",
    "dispersions": "without arguments that returns a table of dispersions",
    "figures": "of jentry.plots.FigureData that returns a matplotlib figure, or None",
    "problems": "without arguments that returns a FlightProblem",
}


@dataclasses.dataclass(frozen=True)
class PublishedValue:
    """A number that a paper prints of its runs, and how the same is taken from ours."""

    name: str
    value: float
    unit: str
    statistic: Callable[[Mapping[str, Any]], float]
    """Function of the variables of a result, by name, each of shape (runs,)"""


@dataclasses.dataclass(frozen=True)
class Mission:
    """A system, whole: what flies, what of it is uncertain, what has been published.

    MISSION = Mission(
        name="my-lander",
        title="Lander with a law of my own",
        variants={"nominal": scenario},
        dispersions={"all": dispersions},
    )

    A file that defines `MISSION` is flown by `jentry fly my_lander.py`; a package that
    names its own in the entry-point group `jentry.missions`, by `jentry fly my-lander`.
    """

    name: str
    """Name of letters, digits, dots, dashes and underscores: results go to such a folder"""
    title: str
    variants: Mapping[str, Callable[[], Scenario]]
    """Builders of the scenario; the first is the mission's own"""
    dispersions: Mapping[str, Callable[[], Mapping[str, Dispersion]]] = (
        dataclasses.field(default_factory=dict)
    )
    """Readings of the dispersion table; the first is the mission's own. Functions, so
    that importing a mission makes no array"""
    source: str = ""
    """The paper, if there is one"""
    gains: tuple[str, ...] = ("guidance.gains", "guidance.observer")
    """What `jentry tune` tunes unless told otherwise: addresses, or the beginnings of
    some; those that a variant does not have are left out"""
    tuned_for: tuple[str, ...] = ()
    """What `jentry tune --of` is unless told otherwise, such as `drag_deviation=0.5`; the
    misses where it is empty"""
    modes_faster_than: float | None = None
    """Modes of the closed loop, in rad/s, whose least damping every `jentry tune` tells;
    None for a mission whose tuning does not tell any"""
    problems: Mapping[str, Callable[[], FlightProblem]] = dataclasses.field(
        default_factory=dict
    )
    """What `jentry optimize` can be asked; the first is the mission's own"""
    train: Callable[..., dict[str, dict[str, Any]]] | None = None
    """Function that trains the mission's networks: it takes a folder, a seed and options,
    and returns the model cards by name"""
    figures: Mapping[str, DrawFigure] = dataclasses.field(
        default_factory=lambda: dict(USUAL)
    )
    """What `jentry monte-carlo` draws of its campaigns, by name: functions of
    `jentry.plots.FigureData`, such as those of `jentry.plots.USUAL` and `GLIDE`"""
    published: tuple[PublishedValue, ...] = ()
    published_note: str = ""
    published_variant: str = ""
    published_dispersions: str = ""
    """Reading of the dispersions that the published values belong to"""
    published_runs: int = 1000
    """Number of runs of the published statistics: the size of the sets beside them"""
    code: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Digests of the files of a mission of one's own when it was imported, by name;
    filled in by `find_mission`, stored with results, compared on resumption"""

    def __post_init__(self):
        if not _NAME.fullmatch(self.name):
            raise ValueError(
                f"the name of a mission is {self.name!r}: it must be of letters, digits, "
                "dots, dashes and underscores"
            )
        for what in _EXAMPLES:
            named = getattr(self, what)
            if not isinstance(named, Mapping) or (what == "variants" and not named):
                raise ValueError(
                    f"mission {self.name} has {what} {named!r}: they must be functions "
                    f'by name, such as {{"nominal": {_EXAMPLES[what]}}}'
                )
            for name, function in named.items():
                if not callable(function):
                    raise ValueError(
                        f"{what} {name!r} of mission {self.name} is a "
                        f"{type(function).__name__}: it must be a function {_MEANT[what]}"
                    )
        if isinstance(self.gains, str):
            raise ValueError(
                f"gains of mission {self.name} is {self.gains!r}: it must be a tuple, "
                f"({self.gains!r},)"
            )

    def problem(self, name: str | None = None) -> FlightProblem:
        """What `jentry optimize` is asked by a name. Raises `ValueError` if unknown."""
        return _build(self.problems, name, "problem", self.name)

    @property
    def labels(self) -> dict[str, Any]:
        """What the results are known by: the mission's name, and its code if any."""
        return {"mission": self.name} | ({"code": dict(self.code)} if self.code else {})

    @needs_float64
    def scenario(self, variant: str | None = None) -> Scenario:
        """The nominal scenario of a variant.

        Raises `ValueError` for an unknown variant, and for one that is no scenario.
        """
        scenario = _build(self.variants, variant, "variant", self.name)
        if not isinstance(scenario, Scenario):
            raise ValueError(
                f"a variant of mission {self.name} is a {type(scenario).__name__}: it "
                "must be a function that returns a Scenario"
            )
        with known_numbers():
            return with_leaves(scenario)

    def dispersion_table(self, reading: str | None = None) -> Mapping[str, Dispersion]:
        """The table of dispersions of a reading.

        Raises `ValueError` for an unknown reading, and for what is no dispersion.
        """
        table = _build(self.dispersions, reading, "dispersions", self.name)
        for name, dispersion in table.items():
            if not isinstance(dispersion, Dispersion):
                raise ValueError(
                    f"dispersion {name!r} of mission {self.name} is a "
                    f"{type(dispersion).__name__}: it must be a Dispersion"
                )
        return table


def _build(
    options: Mapping[str, Callable[[], Any]], name: str | None, what: str, mission: str
) -> Any:
    """What is built under a name, or under the first."""
    build = _choose(options, name, what, mission)
    with known_numbers():
        return build()


def _choose(
    options: Mapping[str, Any], name: str | None, what: str, mission: str
) -> Any:
    if not options:
        raise ValueError(f"mission {mission} has no {what}")
    if name is None:
        return next(iter(options.values()))
    if name not in options:
        raise ValueError(
            f"mission {mission} has no {what} {name!r}: choose from {', '.join(options)}"
        )
    return options[name]


def standard_deviation(values: Any) -> float:
    """Standard deviation of a sample: divided by the number less one."""
    return float(np.std(values, ddof=1))
