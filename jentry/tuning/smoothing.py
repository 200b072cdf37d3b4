"""Smooth surrogates of a law, whose gradients include the effects of its switches."""

import jax

from ..flight.scenario import Scenario
from ..guidance.switching import AbstractSwitching, Smooth, SmoothReversals


def smooth_switching(
    scenario: Scenario, switching: AbstractSwitching | None = None
) -> Scenario:
    """The scenario with smooth switches in its law, those of `Smooth` by default.

    It is the surrogate of `AutomaticDifferentiation(surrogate=smooth_switching)`: `tune`
    then uses its gradients, and computes the loss with the exact law.

    **Raises:** `ValueError` for a law without a switching that can be replaced.
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
    """The scenario with bank reversals that are distributed over guidance cycles.

    It is the surrogate of `AutomaticDifferentiation(surrogate=smooth_reversals)`; see
    `SmoothReversals`.
    """
    return smooth_switching(scenario, SmoothReversals())
