"""Pages with what the program and its results say, in place of what asks for it."""

import re

from described import choices_of, errors_of, options_of
from tables import table


_TABLE = re.compile(r"^```table\n(.*?)^```$", re.M | re.S)
_FROM_PROGRAM = re.compile(r"^\{\{ (options|choices|errors) (\S+) \}\}$", re.M)
_MADE = {"options": options_of, "choices": choices_of, "errors": errors_of}


def filled(text: str) -> str:
    """A page with its tables, options and choices.

    A block ```` ```table ```` becomes a table (see `table`), and a line `{{ options fly }}`
    or `{{ choices x-33 }}` the options of a command or the choices of a mission. A line
    `{{ errors sx-2 }}` becomes the errors of the inertial navigation of a mission.

    **Raises:** `ValueError` or `KeyError` for what does not exist.
    """
    text = _TABLE.sub(lambda found: table(found[1]), text)
    return _FROM_PROGRAM.sub(lambda found: _MADE[found[1]](found[2]), text)
