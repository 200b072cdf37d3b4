"""Guided atmospheric entry as one pure, differentiable function.

import jentry

jentry.setup()
scenario = jentry.find_mission("mars-drag-tracking").scenario()
flight = jentry.fly(scenario)
campaign = jentry.monte_carlo(scenario, dispersions, key)
tuned = jentry.tune(scenario, where, loss, optimizer, dispersions, key)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any


if TYPE_CHECKING:
    from ._api import *  # noqa: F403


def __getattr__(name: str) -> Any:
    """Imported when first asked for: JAX takes seconds, and a command may be `--help`."""
    if not name.startswith("_"):
        api = import_module("._api", __name__)
        if name in globals():  # a module of ours, which is there by now
            return globals()[name]
        if hasattr(api, name):
            return getattr(api, name)
    raise AttributeError(f"module 'jentry' has no attribute {name!r}")


def __dir__() -> list[str]:
    api = import_module("._api", __name__)
    return sorted({*globals(), *(name for name in vars(api) if name[0] != "_")})
