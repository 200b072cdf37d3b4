"""Choice of a law, a case and worlds of a mission."""

import dataclasses
import re
from collections.abc import Iterable
from typing import Any


AXES = "law", "case", "world"
"""Independent choices that define a flight of a mission"""


@dataclasses.dataclass(frozen=True)
class Choice:
    """A law, a case and worlds of a mission by their names.

    If no law is given, it is the first law of the mission. Without a case, start and target
    are those of the mission. Without a world, planet, vehicle and sensors are those of the
    mission.
    """

    law: str | None = None
    case: str | None = None
    worlds: tuple[str, ...] = ()
    """Names of the worlds, in the order in which they are applied"""

    @classmethod
    def given(
        cls,
        law: Any = None,
        case: Any = None,
        world: Any = None,
    ) -> "Choice":
        """The choice from names; `world` may be one name or several.

        Raises `ValueError` for an argument that is not a name, and for a world that is
        given twice.
        """
        several = world is None or isinstance(world, str)
        worlds = (() if world is None else (world,)) if several else world
        if not isinstance(worlds, Iterable):
            raise ValueError(
                f"world is {world!r}: it must be a name, or a list of names"
            )
        worlds = tuple(worlds)
        for axis, names in (("law", (law,)), ("case", (case,)), ("world", worlds)):
            for name in names:
                if name is not None and not isinstance(name, str):
                    raise ValueError(f"{axis} is {name!r}: it must be a name")
        for name in worlds:
            if worlds.count(name) > 1:
                raise ValueError(f"world {name} is given twice: once is enough")
        return cls(law, case, worlds)

    @classmethod
    def of(cls, text: str) -> "Choice":
        """The choice from its text, such as `tracking case 3 world us-1976`.

        This is the inverse of `str`. Raises `ValueError` for a text of another form.
        """
        form = r"(?P<law>\S+)?(?: ?case (?P<case>\S+))?(?P<worlds>(?: ?world \S+)*)"
        found = re.fullmatch(form, text)
        if found is None:
            raise ValueError(
                f"{text!r} names no flight of a mission: write LAW, LAW case CASE or LAW "
                "case CASE world WORLD"
            )
        worlds = tuple(found["worlds"].split()[1::2])
        return cls(found["law"], found["case"], worlds)

    def __str__(self) -> str:
        words = [self.law or ""]
        words += [] if self.case is None else [f"case {self.case}"]
        words += [f"world {name}" for name in self.worlds]
        return " ".join(word for word in words if word)

    @property
    def folder(self) -> str:
        """Name of the choice for a folder."""
        return str(self).replace(" ", "-")

    @property
    def labels(self) -> dict[str, Any]:
        """The choice as results and configuration files store it, without open choices."""
        told = {"law": self.law, "case": self.case, "world": list(self.worlds) or None}
        return {axis: names for axis, names in told.items() if names is not None}

    def over(self, other: "Choice") -> "Choice":
        """This choice, completed by the other one where it leaves something open."""
        return Choice(
            other.law if self.law is None else self.law,
            other.case if self.case is None else self.case,
            self.worlds or other.worlds,
        )
