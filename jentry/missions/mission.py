"""What a mission is: a scenario with a name, its dispersions and its published table."""

import dataclasses
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from .._computed_once import known_numbers
from .._setup import needs_float64
from ..addresses import with_leaves
from ..campaign.dispersions import Dispersion
from ..flight.scenario import Scenario
from ..planning.flight_problem import FlightProblem
from ..plots.campaign import USUAL, DrawFigure
from .choice import Choice


Change = Callable[[Scenario], Scenario]

_NAME = re.compile(r"\w[\w.-]*")
_RESERVED = "all", "case", "world"
"""What no law, case or world is called, since commands mean something else by it"""

_EXAMPLES = {
    "laws": "scenario",
    "cases": "start_higher",
    "worlds": "in_thin_air",
    "dispersions": "dispersions",
    "figures": "figure",
    "problems": "problem",
}
_MEANT = {
    "laws": "without arguments that returns a Scenario",
    "cases": "of a Scenario that returns a Scenario",
    "worlds": "of a Scenario that returns a Scenario",
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
        laws={"nominal": scenario},
        dispersions={"all": dispersions},
    )

    A file that defines `MISSION` is flown by `jentry fly my_lander.py`; a package that
    names its own in the entry-point group `jentry.missions`, by `jentry fly my-lander`.
    """

    name: str
    """Name of letters, digits, dots, dashes and underscores: results go to such a folder"""
    title: str
    laws: Mapping[str, Callable[[], Scenario]]
    """The scenario under each guidance law; the first is the mission's own"""
    cases: Mapping[str, Change] = dataclasses.field(default_factory=dict)
    """Other starts and targets: each a function of a scenario, whatever its law"""
    worlds: Mapping[str, Change] = dataclasses.field(default_factory=dict)
    """Other planets, vehicles and sensors: likewise. Where a law's model is to know of
    it, the function changes that as well"""
    dispersions: Mapping[str, Callable[[], Mapping[str, Dispersion]]] = (
        dataclasses.field(default_factory=dict)
    )
    """Readings of the dispersion table; the first is the mission's own. Functions, so
    that importing a mission makes no array"""
    source: str = ""
    """The paper, if there is one"""
    gains: tuple[str, ...] = ("guidance.gains", "guidance.observer")
    """What `jentry tune` tunes unless told otherwise: addresses, or the beginnings of
    some; those that a law does not have are left out"""
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
    published_law: str = ""
    published_dispersions: str = ""
    """Reading of the dispersions that the published values belong to"""
    published_runs: int = 1000
    """Number of runs of the published statistics: the size of the sets beside them"""
    former_variants: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """How what earlier versions called a variant is chosen now, as `Choice.of` reads it,
    where that is not the law of the same name: for stored campaigns"""
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
            if not isinstance(named, Mapping) or (what == "laws" and not named):
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
        for axis in ("laws", "cases", "worlds"):
            for name in getattr(self, axis):
                if not re.fullmatch(r"\S+", name) or name in _RESERVED:
                    raise ValueError(
                        f"{axis} of mission {self.name} have the name {name!r}: write it "
                        f"without spaces, and not as {', '.join(_RESERVED)}"
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
    def scenario(
        self,
        law: str | None = None,
        case: str | None = None,
        world: str | Iterable[str] | None = None,
    ) -> Scenario:
        """The nominal scenario under a law, in a case and in a world, or in several.

        The mission's own law if none is given.

        Raises `ValueError` for an unknown name, for what is no scenario, and for a law, a
        case and worlds that do not go together.

            find_mission("x-33").scenario("with-range", case="3")
        """
        return self.scenario_of(Choice.given(law, case, world))

    @needs_float64
    def scenario_of(self, choice: Choice | str) -> Scenario:
        """That of a choice, or of what `Choice.of` reads; see `scenario`."""
        choice = Choice.of(choice) if isinstance(choice, str) else choice
        law = _choose(self.laws, choice.law, "law", self.name)
        changes = [("case", choice.case, self.cases)] if choice.case is not None else []
        changes += [("world", name, self.worlds) for name in choice.worlds]
        functions = [_choose(of, name, axis, self.name) for axis, name, of in changes]
        with known_numbers():
            scenario = self._scenario(law(), "law")
            for (axis, name, _), change in zip(changes, functions, strict=True):
                try:
                    scenario = self._scenario(change(scenario), axis)
                except (ValueError, AttributeError) as error:
                    raise ValueError(
                        f"{axis} {name} of mission {self.name} does not go with what it "
                        f"is applied to, {self.complete(choice)}: {error}"
                    ) from error
            return with_leaves(scenario)

    def complete(self, choice: Choice) -> Choice:
        """The choice with the mission's own law where it has none."""
        return choice.over(Choice(next(iter(self.laws))))

    def _scenario(self, made: Any, axis: str) -> Scenario:
        if not isinstance(made, Scenario):
            raise ValueError(
                f"a {axis} of mission {self.name} makes a {type(made).__name__}: it must "
                "be a function that returns a Scenario"
            )
        return made

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
