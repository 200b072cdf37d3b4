"""What of a mission is flown: its law, one of its cases, in some of its worlds."""

import dataclasses
import re
from collections.abc import Iterable
from typing import Any


AXES = "law", "case", "world"
"""What is chosen of a mission, independently of each other"""


@dataclasses.dataclass(frozen=True)
class Choice:
    """A law, a case and worlds of a mission by their names.

    A law that is not given is the mission's own. Without a case the flight starts as the
    mission says, and without a world planet, vehicle and sensors are as it says.
    """

    law: str | None = None
    case: str | None = None
    worlds: tuple[str, ...] = ()
    """In the order in which they are applied"""

    @classmethod
    def given(
        cls,
        law: Any = None,
        case: Any = None,
        world: Any = None,
    ) -> "Choice":
        """Of names; a world may be one name, or several.

        Raises `ValueError` for what is no name, and for a world that is given twice.
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
        """As it is written: `tracking case 3 world us-1976`. The inverse of `str`.

        Raises `ValueError` for what is written otherwise.
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
        """Its name as one of a folder."""
        return str(self).replace(" ", "-")

    @property
    def labels(self) -> dict[str, Any]:
        """What results and configuration files say of it: what is chosen, and no more."""
        told = {"law": self.law, "case": self.case, "world": list(self.worlds) or None}
        return {axis: names for axis, names in told.items() if names is not None}

    def over(self, other: "Choice") -> "Choice":
        """This, and where it leaves something open the other one."""
        return Choice(
            other.law if self.law is None else self.law,
            other.case if self.case is None else self.case,
            self.worlds or other.worlds,
        )
