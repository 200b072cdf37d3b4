"""The aim of a law: the target of its scenario, which only the scenario states."""

from typing import TypeVar

import equinox as eqx
import jax

from ..fields import Scalar, scalar
from ..motion.orbit import OrbitTarget
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


class OrbitOfScenario(eqx.Module):
    """Placeholder in a law for the orbit that is the target of the scenario.

    See `TargetOfScenario`.
    """


def is_aim(node: object) -> bool:
    """Whether a node of a law is an aim, known or a placeholder."""
    kinds = Aim | TargetOfScenario | OrbitTarget | OrbitOfScenario
    return isinstance(node, kinds)


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


def known_orbit(orbit: OrbitTarget | OrbitOfScenario) -> OrbitTarget:
    """The target orbit, if it is known.

    **Raises:** `ValueError` for a placeholder, if the law is used outside of a scenario.
    """
    if isinstance(orbit, OrbitOfScenario):
        raise ValueError(
            "this law flies to the orbit that is the target of its scenario, and is used "
            "outside of one: take scenario.law in place of scenario.guidance, or give it "
            "orbit=OrbitTarget(...)"
        )
    return orbit


def told(law: Law, aim: Aim | OrbitTarget) -> Law:
    """The law with each placeholder for the target of the scenario replaced by the aim.

    **Raises:** `ValueError` for a law that flies to a place if the target is an orbit, and
    the other way round.
    """
    to_orbit = isinstance(aim, OrbitTarget)
    kind, other = TargetOfScenario, OrbitOfScenario
    kind, other = (other, kind) if to_orbit else (kind, other)

    def know(node):
        if isinstance(node, other):
            raise ValueError(
                f"{type(law).__name__} flies to {'a place' if to_orbit else 'an orbit'}, "
                f"and the target of the scenario is {'an orbit' if to_orbit else 'a place'}"
                f": give it target={'Target' if to_orbit else 'OrbitTarget'}(...)"
            )
        return aim if isinstance(node, kind) else node

    return jax.tree.map(know, law, is_leaf=is_aim)
