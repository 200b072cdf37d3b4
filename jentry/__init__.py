"""Guided atmospheric entry as one pure, differentiable function.

import jentry

jentry.setup()
scenario = jentry.find_mission("mars-drag-tracking").scenario()
flight = jentry.fly(scenario)
campaign = jentry.monte_carlo(scenario, dispersions, key)
tuned = jentry.tune(scenario, where, loss, optimizer, jentry.Draws(dispersions, key))
best = jentry.optimize(scenario, where, objective, constraints)
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any


if TYPE_CHECKING:
    from ._api import *  # noqa: F403

    __version__: str


def __getattr__(name: str) -> Any:
    """A public name, imported at its first use: `--help` must not wait for JAX."""
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)
    if name == "__all__" or not name.startswith("_"):
        _import_all()
        if name in globals():
            return globals()[name]
    raise AttributeError(f"module 'jentry' has no attribute {name!r}")


def __dir__() -> list[str]:
    _import_all()
    return sorted({*globals(), "__version__"})


def _import_all() -> None:
    """Import all public names into this module, and set `__all__`."""
    api = vars(import_module("._api", __name__))
    offered = {
        name: x
        for name, x in api.items()
        if not name.startswith("_") and not isinstance(x, ModuleType)
    }
    globals().update(offered, __all__=sorted(offered))
