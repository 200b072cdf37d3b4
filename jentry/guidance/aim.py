"""The aim of a law: the target of its scenario, which only the scenario states."""

from typing import TypeVar

import equinox as eqx
import jax

from ..fields import Scalar, scalar
from ..motion.state import EntryState


Law = TypeVar("Law")


class Aim(eqx.Module):
    """The place where guided flight should end, as a law reads it.

    Downrange and crossrange are arcs on the surface from the origin, as in
    `ground_track`. Origin, downrange and crossrange define a place that does not move with
    the start of a flight.
    """

    origin: EntryState
    downrange: Scalar = scalar(unit="m")
    crossrange: Scalar = scalar(unit="m")
    altitude: Scalar = scalar(unit="m")
    velocity: Scalar = scalar(unit="m/s", positive=True)


class TargetOfScenario(eqx.Module):
    """Placeholder in a law for the target of the scenario that contains the law.

    It holds no numbers. A scenario has one target, and `Scenario.law` is the law with that
    target filled in.
    """


def is_aim(node: object) -> bool:
    """Whether a node of a law is an aim, known or a placeholder."""
    return isinstance(node, Aim | TargetOfScenario)


def known(aim: Aim | TargetOfScenario) -> Aim:
    """The aim, if it is known.

    **Raises:** `ValueError` for a placeholder, if the law is used outside of a scenario.
    """
    if isinstance(aim, TargetOfScenario):
        raise ValueError(
            "this law aims at the target of its scenario, and is used outside of one: "
            "take scenario.law in place of scenario.guidance, or give it aim=Aim(...)"
        )
    return aim


def told(law: Law, aim: Aim) -> Law:
    """The law with each placeholder for the target of the scenario replaced by the aim."""

    def know(node):
        return aim if isinstance(node, TargetOfScenario) else node

    return jax.tree.map(know, law, is_leaf=is_aim)
