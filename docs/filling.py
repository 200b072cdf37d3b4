"""Pages with what the program and its results say, in place of what asks for it."""

import re

from described import choices_of, options_of
from tables import table


_TABLE = re.compile(r"^```table\n(.*?)^```$", re.M | re.S)
_FROM_PROGRAM = re.compile(r"^\{\{ (options|choices) (\S+) \}\}$", re.M)
_MADE = {"options": options_of, "choices": choices_of}


def filled(text: str) -> str:
    """A page with its tables, options and choices.

    A block ```` ```table ```` becomes a table (see `table`), and a line `{{ options fly }}`
    or `{{ choices x-33 }}` the options of a command or the choices of a mission.

    **Raises:** `ValueError` or `KeyError` for what does not exist.
    """
    text = _TABLE.sub(lambda found: table(found[1]), text)
    return _FROM_PROGRAM.sub(lambda found: _MADE[found[1]](found[2]), text)
