"""Guided atmospheric entry as one pure, differentiable function.

import jentry

jentry.setup()
scenario = jentry.find_mission("mars-drag-tracking").scenario()
flight = jentry.fly(scenario)
campaign = jentry.monte_carlo(scenario, dispersions, key)
tuned = jentry.tune(scenario, where, loss, optimizer, dispersions, key)
"""

from typing import TYPE_CHECKING, Any


if TYPE_CHECKING:
    from ._api import *  # noqa: F403


def __getattr__(name: str) -> Any:
    """Imported when first asked for: JAX takes seconds, and a command may be `--help`."""
    from . import _api

    if name in globals():  # a module of ours, which is there by now
        return globals()[name]
    if name.startswith("_") or not hasattr(_api, name):
        raise AttributeError(f"module 'jentry' has no attribute {name!r}")
    return getattr(_api, name)


def __dir__() -> list[str]:
    from . import _api

    return sorted({*globals(), *(name for name in vars(_api) if name[0] != "_")})
