"""Where a law is to bring the vehicle: the target of its scenario, stated there alone."""

from typing import TypeVar

import equinox as eqx
import jax

from ..fields import Scalar, scalar
from ..motion.state import EntryState


Law = TypeVar("Law")


class Aim(eqx.Module):
    """The place where guided flight should end, as a law reads it.

    Downrange and crossrange are arcs on the surface from the origin, as in
    `ground_track`: the three together are a place, which does not move with the start of
    a flight.
    """

    origin: EntryState
    downrange: Scalar = scalar(unit="m")
    crossrange: Scalar = scalar(unit="m")
    altitude: Scalar = scalar(unit="m")
    velocity: Scalar = scalar(unit="m/s", positive=True)


class TargetOfScenario(eqx.Module):
    """Stands in a law for the target of the scenario in which the law flies.

    It holds no number: a scenario has one target, and `Scenario.law` is the law that knows
    it.
    """


def is_aim(node: object) -> bool:
    """Whether a node of a law is an aim, known or to be taken from a scenario."""
    return isinstance(node, Aim | TargetOfScenario)


def known(aim: Aim | TargetOfScenario) -> Aim:
    """An aim that is known.

    Raises `ValueError` for that of a scenario, where the law is not asked in one.
    """
    if isinstance(aim, TargetOfScenario):
        raise ValueError(
            "this law flies to the target of its scenario, and is asked outside of one: "
            "take scenario.law in place of scenario.guidance, or give it aim=Aim(...)"
        )
    return aim


def told(law: Law, aim: Aim) -> Law:
    """The law, each part of which that flies to the target of the scenario knows it."""

    def know(node):
        return aim if isinstance(node, TargetOfScenario) else node

    return jax.tree.map(know, law, is_leaf=is_aim)
