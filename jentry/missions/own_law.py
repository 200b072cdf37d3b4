"""A guidance law from a file of the user, as a law of a mission."""

import dataclasses
import re
from pathlib import Path
from typing import Any, NamedTuple

from ..flight.scenario import Scenario
from ..guidance.law import AbstractLaw
from .mission import Mission
from .own import is_file, law_in_file


class OwnLaw(NamedTuple):
    """A law of the user."""

    name: str
    """Name of its file, without the ending"""
    law: Any
    """A law, or a function of a scenario that returns a law or a scenario"""
    code: dict[str, str]
    """Digests of its files by name"""

    def joined(self, mission: Mission) -> Mission:
        """The mission with this law beside its own laws.

        The scenario is that of the first law of the mission, with this law in its place.

        **Raises:** `ValueError` for a mission that has a law with this name.
        """
        if self.name in mission.laws:
            raise ValueError(
                f"the law {self.name} of your file has the name of a law of mission "
                f"{mission.name}: rename the file"
            )
        first = next(iter(mission.laws.values()))
        return dataclasses.replace(
            mission, laws={**mission.laws, self.name: lambda: self._scenario(first())}
        )

    def _scenario(self, scenario: Scenario) -> Scenario:
        made = self.law
        if not isinstance(made, AbstractLaw):
            made = made(scenario)
        if isinstance(made, Scenario):
            return made
        if not isinstance(made, AbstractLaw):
            raise ValueError(
                f"LAW of {self.name} makes a {type(made).__name__}: it must return a "
                "guidance law, such as a subclass of jentry.AbstractSampledLaw"
            )
        return dataclasses.replace(scenario, guidance=made)


def law_of_file(name: str) -> OwnLaw:
    """The law of a file that defines `LAW`.

    `LAW` is a law, or a function of a `Scenario` that returns one. The scenario is that of
    a mission under its first law: planet, vehicle, start and target are there.

    **Raises:** `ValueError` for a name that does not end in `.py`, for the reasons of
    `law_in_file`, and for something else than a law or a function.
    """
    if not is_file(name):
        raise ValueError(
            f"the law is {name!r}: give a file that defines LAW, such as my_law.py; laws "
            "of the missions are chosen by --laws"
        )
    path = Path(name)
    if not re.fullmatch(r"\w[\w-]*", path.stem):
        raise ValueError(
            f"the file {path} gives its law the name {path.stem!r}: name it by letters, "
            "digits, dashes and underscores"
        )
    law, code = law_in_file(path)
    if isinstance(law, type) or not (isinstance(law, AbstractLaw) or callable(law)):
        what = f"the class {law.__name__}" if isinstance(law, type) else repr(law)
        raise ValueError(
            f"LAW of {path} is {what}: it must be a law, or a function of a Scenario that "
            "returns one"
        )
    return OwnLaw(path.stem, law, code)
