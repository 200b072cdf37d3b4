"""Modules: to whom they belong and what they hold."""

import enum
import functools
import os
import sys
import sysconfig
import types
from pathlib import Path
from typing import Any


MAIN = "__main__"

_JENTRY = __name__.split(".")[0]
_PACKAGES = "site-packages", "dist-packages"
"""Folders of installed packages"""

_PYTHON = (
    os.path.dirname(os.__file__),
    *(sysconfig.get_path(kind) for kind in ("stdlib", "platstdlib")),
)
"""Folders of Python's own modules"""


class Owner(enum.Enum):
    """To whom a module belongs."""

    JENTRY = enum.auto()
    PYTHON = enum.auto()
    PACKAGE = enum.auto()
    """An installed package, whose version identifies its code"""
    USER = enum.auto()
    """The user: scripts, modules beside them, and packages in editable mode"""
    UNKNOWN = enum.auto()
    """A module that has no file or is not imported"""


def owner_of(module: str | None) -> Owner:
    """To whom a module belongs, by the file from which it was imported."""
    name = module or ""
    if package_of(name) == _JENTRY:
        return Owner.JENTRY
    if name == MAIN:  # a prompt or a notebook has no file
        return Owner.USER
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is not None:
        return _owner_of_file(file)
    builtin = package_of(name) in sys.stdlib_module_names
    return Owner.PYTHON if builtin else Owner.UNKNOWN


@functools.cache
def _owner_of_file(file: str) -> Owner:
    path = Path(file)
    if any(part in _PACKAGES for part in path.parts):
        return Owner.PACKAGE
    if any(path.is_relative_to(folder) for folder in _PYTHON):
        return Owner.PYTHON
    return Owner.USER


def package_of(module: str) -> str:
    """The first name of a dotted name."""
    return module.split(".")[0]


def home_of(function: types.FunctionType) -> str:
    """The module in which a function was written.

    `functools.wraps` copies `__module__` from another function, but not the globals.
    """
    return function.__globals__.get("__name__", "")


def find(module: str, name: str) -> Any:
    """The object that an imported module holds under a qualified name, or None."""
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found
