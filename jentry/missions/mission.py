"""A mission: scenarios with a name, dispersions and published values."""

import dataclasses
import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from .._computed_once import known_numbers
from .._setup import needs_float64
from ..addresses import with_leaves
from ..campaign.dispersions import Dispersion
from ..flight.scenario import Scenario
from ..planning.flight_problem import FlightProblem
from ..plots.campaign import USUAL, DrawFigure
from .choice import Choice


if TYPE_CHECKING:
    from ..learning.law_training import LawTraining


Change = Callable[[Scenario], Scenario]

_NAME = re.compile(r"\w[\w.-]*")
_RESERVED = "all", "case", "world"
"""Names that no law, case or world may have, since commands use them otherwise"""

_EXAMPLES = {
    "laws": "scenario",
    "cases": "start_higher",
    "worlds": "in_thin_air",
    "dispersions": "dispersions",
    "figures": "figure",
    "problems": "problem",
    "law_trainings": "training",
}
_MEANT = {
    "laws": "without arguments that returns a Scenario",
    "cases": "of a Scenario that returns a Scenario",
    "worlds": "of a Scenario that returns a Scenario",
    "dispersions": "without arguments that returns a table of dispersions",
    "figures": "of jentry.plots.FigureData that returns a matplotlib figure, or None",
    "problems": "without arguments that returns a FlightProblem",
    "law_trainings": "without arguments that returns a LawTraining",
}


@dataclasses.dataclass(frozen=True)
class PublishedValue:
    """A number that a paper prints for its runs, and the statistic that computes it."""

    name: str
    value: float
    unit: str
    statistic: Callable[[Mapping[str, Any]], float]
    """Function of the variables of a result, by name, each of shape (runs,)"""


@dataclasses.dataclass(frozen=True)
class Mission:
    """A vehicle, an entry and a target, with laws, cases, worlds and dispersions.

    MISSION = Mission(
        name="my-lander",
        title="Lander with a law of my own",
        laws={"nominal": scenario},
        dispersions={"all": dispersions},
    )

    `jentry fly my_lander.py` flies a file that defines `MISSION`. `jentry fly my-lander`
    flies the mission of a package that names it in the entry-point group
    `jentry.missions`.
    """

    name: str
    """Name of letters, digits, dots, dashes and underscores; a folder of results has it"""
    title: str
    laws: Mapping[str, Callable[[], Scenario]]
    """Functions that return the scenario under each law; the first is the default"""
    cases: Mapping[str, Change] = dataclasses.field(default_factory=dict)
    """Functions that change the start or the target of a scenario with any law"""
    worlds: Mapping[str, Change] = dataclasses.field(default_factory=dict)
    """Functions that change planet, vehicle or sensors of a scenario with any law. If the
    onboard model shall include the change, the function changes that model too"""
    dispersions: Mapping[str, Callable[[], Mapping[str, Dispersion]]] = (
        dataclasses.field(default_factory=dict)
    )
    """Functions that return tables of dispersions; the first is the default. They are
    functions so that importing a mission makes no array"""
    source: str = ""
    """The paper, if there is one"""
    gains: tuple[str, ...] = ("guidance.gains", "guidance.observer")
    """Default gains of `jentry tune`: addresses, or beginnings of addresses; those that a
    law does not have are left out"""
    tuned_for: tuple[str, ...] = ()
    """Default of `jentry tune --of`, such as `drag_deviation=0.5`; empty for the misses"""
    modes_faster_than: float | None = None
    """Frequency, rad/s, above which `jentry tune` reports the least damping of the modes of
    the closed loop; None if it reports none"""
    problems: Mapping[str, Callable[[], FlightProblem]] = dataclasses.field(
        default_factory=dict
    )
    """Functions that return problems for `jentry optimize`; the first is the default"""
    train: Callable[..., dict[str, dict[str, Any]]] | None = None
    """Function that trains the networks of the mission. It takes a folder, a seed and
    options, and returns the model cards by name"""
    law_trainings: Mapping[str, Callable[[], "LawTraining"]] = dataclasses.field(
        default_factory=dict
    )
    """Functions that return how a neural law is trained, by the name of the law"""
    figures: Mapping[str, DrawFigure] = dataclasses.field(
        default_factory=lambda: dict(USUAL)
    )
    """Figures that `jentry monte-carlo` draws of campaigns, by name: functions of
    `jentry.plots.FigureData`, such as those of `jentry.plots.USUAL` and `GLIDE`"""
    published: tuple[PublishedValue, ...] = ()
    published_note: str = ""
    published_law: str = ""
    published_dispersions: str = ""
    """Name of the dispersions of the published values"""
    published_runs: int = 1000
    """Number of runs of the published statistics, and size of the sets beside them"""
    former_variants: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Present choices, as texts for `Choice.of`, by the names that earlier versions called
    variants. They serve stored campaigns; a variant that is now a law with its name is
    left out"""
    code: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Digests of the files of your own mission when it was imported, by name.
    `find_mission` sets them; they are stored with results and compared on resumption"""

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
        """The problem of `jentry optimize` with a name, or the first one.

        Raises `ValueError` for an unknown name.
        """
        return _build(self.problems, name, "problem", self.name)

    def law_training(self, law: str) -> "LawTraining":
        """How a neural law of the mission is trained.

        Raises `ValueError` for a law without a network.
        """
        return _build(self.law_trainings, law, "training of a law", self.name)

    @property
    def labels(self) -> dict[str, Any]:
        """Labels of the results: the name of the mission, and its code if there is any."""
        return {"mission": self.name} | ({"code": dict(self.code)} if self.code else {})

    @needs_float64
    def scenario(
        self,
        law: str | None = None,
        case: str | None = None,
        world: str | Iterable[str] | None = None,
    ) -> Scenario:
        """The nominal scenario under a law, in a case and in one or several worlds.

        The default is the first law of the mission, without a case and a world.

        Raises `ValueError` for an unknown name, for a function that does not return a
        scenario, and for a law, a case and worlds that cannot be combined.

            find_mission("x-33").scenario("with-range", case="3")
        """
        return self.scenario_of(Choice.given(law, case, world))

    @needs_float64
    def scenario_of(self, choice: Choice | str) -> Scenario:
        """The nominal scenario of a choice or of its text (`Choice.of`); see `scenario`."""
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
        """The choice, with the first law of the mission if it has none."""
        return choice.over(Choice(next(iter(self.laws))))

    def _scenario(self, made: Any, axis: str) -> Scenario:
        if not isinstance(made, Scenario):
            raise ValueError(
                f"a {axis} of mission {self.name} makes a {type(made).__name__}: it must "
                "be a function that returns a Scenario"
            )
        return made

    def dispersion_table(self, name: str | None = None) -> Mapping[str, Dispersion]:
        """The table of dispersions with a name, or the first one.

        Raises `ValueError` for an unknown name, and for an entry that is not a dispersion.
        """
        table = _build(self.dispersions, name, "dispersions", self.name)
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
    """The result of the function with a name, or of the first function."""
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
    """Standard deviation of a sample, with the divisor n - 1."""
    return float(np.std(values, ddof=1))
