"""Floor 8: the command `jentry`."""

from importlib import import_module

from .ending import leaving_at_once


def command() -> None:
    """The command `jentry`: see `main.run`."""
    # All that takes long is imported where Ctrl-C leaves at once.
    with leaving_at_once():
        commands = import_module(".main", __name__)
        # As a part of this package the module has taken the place of the function.
        globals().update(main=command)
        commands.run()


main = command
