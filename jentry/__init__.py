"""Guided atmospheric entry as one pure, differentiable function.

import jentry

jentry.setup()
scenario = jentry.find_mission("mars-drag-tracking").scenario()
flight = jentry.fly(scenario)
campaign = jentry.monte_carlo(scenario, dispersions, key)
tuned = jentry.tune(scenario, where, loss, optimizer, dispersions, key)
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any


if TYPE_CHECKING:
    from ._api import *  # noqa: F403

    __version__: str


def __getattr__(name: str) -> Any:
    """Imported when first asked for: JAX takes seconds, and a command may be `--help`."""
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)
    if name == "__all__":
        return _names()
    if not name.startswith("_"):
        api = import_module("._api", __name__)
        if name in globals():  # a module of ours, which is there by now
            return globals()[name]
        if hasattr(api, name):
            return getattr(api, name)
    raise AttributeError(f"module 'jentry' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_names(), "__all__", "__version__"})


def _names() -> list[str]:
    """What is offered: `__all__`. A module in it would be there for another reason."""
    api = vars(import_module("._api", __name__))
    return sorted(
        name
        for name, value in api.items()
        if not name.startswith("_") and not isinstance(value, ModuleType)
    )
