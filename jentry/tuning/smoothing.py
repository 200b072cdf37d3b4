"""Smooth stand-ins for a law, through which gradients reach what its switches hide."""

import jax

from ..flight.scenario import Scenario
from ..guidance.switching import AbstractSwitching, Smooth, SmoothReversals


def smooth_switching(
    scenario: Scenario, switching: AbstractSwitching | None = None
) -> Scenario:
    """The scenario with the smooth switches of `Smooth` in its law.

    For `AutomaticDifferentiation(surrogate=smooth_switching)` of `tune`, which follows its
    gradients and judges by the exact law. Raises `ValueError` for a law that has no
    switching to replace.
    """
    wanted = Smooth() if switching is None else switching
    found = []

    def replaced(node):
        if not isinstance(node, AbstractSwitching):
            return node
        found.append(node)
        return wanted

    def stop(node) -> bool:
        return isinstance(node, AbstractSwitching)

    smooth = jax.tree.map(replaced, scenario, is_leaf=stop)
    if not found:
        raise ValueError(
            f"{type(scenario.guidance).__name__} has no field of the type "
            "AbstractSwitching that could be made smooth"
        )
    return smooth


def smooth_reversals(scenario: Scenario) -> Scenario:
    """The scenario with reversals of its bank that are shared out between cycles.

    For `AutomaticDifferentiation(surrogate=smooth_reversals)`, see `SmoothReversals`.
    """
    return smooth_switching(scenario, SmoothReversals())
