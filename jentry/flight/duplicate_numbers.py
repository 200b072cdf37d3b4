"""Numbers that a scenario states in two places, and checks that both are equal."""

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer

from .._printed import quantity_in_words
from ..addresses import address_of, leaves_by_address, unit_of
from ..guidance.aerocapture import AerocaptureGuidance
from ..guidance.bezier import BezierGuidance, NewtonAdjustment
from ..guidance.guided_end import GuidedEnd
from ..guidance.lateral import HeadingCorridor
from ..guidance.replanning import ReplannedTracking
from ..motion.orbit import OrbitTarget
from ..world.perturbed_atmosphere import GroundWave
from .termination import (
    AbstractEndCondition,
    AltitudeAbove,
    AltitudeBelow,
    CapturedAbove,
    Crossing,
    EnergyBelow,
    EscapedAbove,
    Outcome,
    VelocityBelow,
)


if TYPE_CHECKING:
    from .scenario import Scenario


class Twice(NamedTuple):
    """Addresses of two numbers with the same meaning."""

    first: str
    second: str
    may_differ: bool = False
    """Whether the two values of a scenario may differ. If they are equal, a change of one
    alone is refused in either case"""


_ENDS = {
    # Name of the end of a prediction: the end condition, and the outcome of the flight.
    "velocity": (VelocityBelow, Outcome.REACHED),
    "altitude": (AltitudeBelow, Outcome.REACHED),
    "energy": (EnergyBelow, Outcome.REACHED),
    "ceiling": (AltitudeAbove, Outcome.SKIPPED_OUT),
}


def stated_twice(scenario: "Scenario") -> list[Twice]:
    """All pairs of numbers of a scenario with the same meaning.

    Numbers of an onboard model, such as its planet, are not paired with those of the
    scenario: they are meant to differ from each other.
    """
    found: list[Twice] = []
    for end, address in nodes(scenario.guidance, GuidedEnd, "guidance"):
        for name in _ENDS:
            if getattr(end, name) is not None:
                found += _with_ends(scenario, f"{address}.{name}", name)
    for _, address in nodes(scenario.guidance, AerocaptureGuidance, "guidance"):
        for kind in (CapturedAbove, EscapedAbove):
            for _, end in nodes(scenario.termination, kind, "termination"):
                found.append(Twice(f"{address}.exit_altitude", f"{end}.altitude"))
    for _, address in nodes(scenario.guidance, ReplannedTracking, "guidance"):
        found += _with_ends(scenario, f"{address}.end", "energy")
    for _, address in nodes(scenario.guidance, BezierGuidance, "guidance"):
        found.append(Twice(f"{address}.arrival.altitude", "target.altitude"))
        if getattr(scenario.target, "flight_path_angle", None) is not None:
            angle = "flight_path_angle"
            found.append(Twice(f"{address}.arrival.{angle}", f"target.{angle}"))
    for _, address in nodes(scenario.guidance, NewtonAdjustment, "guidance"):
        found.append(Twice(f"{address}.target_velocity", "target.velocity"))
    for kind, place, tree in (
        (GroundWave, "planet", scenario.planet),
        (HeadingCorridor, "guidance", scenario.guidance),
    ):
        for _, address in nodes(tree, kind, place):
            found.append(Twice(f"{address}.radius", "planet.radius"))
    place = not isinstance(scenario.target, OrbitTarget)
    for name in ("velocity", "altitude") if place else ():
        for there in _conditions(scenario, name):
            found.append(Twice(there, f"target.{name}", may_differ=True))
    return found


def _with_ends(scenario: "Scenario", address: str, name: str) -> Iterator[Twice]:
    """The end of guided flight in an onboard model, paired with the end conditions of its
    kind; without such a condition, paired with the velocity of the target."""
    conditions = _conditions(scenario, name)
    for condition in conditions:
        # If there are several, it is one of them: an end altitude and the ground.
        yield Twice(address, condition, may_differ=len(conditions) > 1)
    if name == "velocity" and not conditions:
        yield Twice(address, "target.velocity")


def _conditions(scenario: "Scenario", name: str) -> list[str]:
    """Addresses of the numbers of the end conditions of one kind."""
    kind, outcome = _ENDS[name]
    number = "altitude" if name == "ceiling" else name
    return [
        f"{address}.{number}"
        for condition, address in nodes(
            scenario.termination, AbstractEndCondition, "termination", skips=Crossing
        )
        if type(condition) is kind and condition.outcome is outcome
    ]


def nodes(
    tree: Any, kind: type | Callable[[Any], bool], place: str, skips: Any = ()
) -> list[tuple[Any, str]]:
    """Nodes of a kind with their addresses; nodes of the kind `skips` are searched, but
    are not results."""

    def is_one(node: Any) -> bool:
        if isinstance(kind, type):
            return isinstance(node, kind) and not isinstance(node, skips)
        return kind(node)

    found: list[tuple[Any, str]] = []
    paths, _ = jax.tree_util.tree_flatten_with_path(tree, is_leaf=is_one)
    for path, node in paths:
        if is_one(node):
            inside = address_of(path)
            address = f"{place}.{inside}" if inside else place
            found.append((node, address))
    return found


def check_stated_twice(scenario: "Scenario") -> None:
    """Refuse numbers with the same meaning that differ, as far as they are known."""
    leaves = leaves_by_address(scenario)
    for pair in stated_twice(scenario):
        one, other = leaves.get(pair.first), leaves.get(pair.second)
        if pair.may_differ or one is None or other is None:
            continue
        if not (isinstance(one, Tracer) or isinstance(other, Tracer)) and differ(
            one, other
        ):
            unit = unit_of(scenario, pair.first)
            first, second = (quantity_in_words(x, unit) for x in (one, other))
            raise ValueError(
                f"{pair.first} is {first} and {pair.second} is {second}: they have the "
                "same meaning, so give both one value"
            )


def require_both(scenario: "Scenario", moved: Iterable[str]) -> None:
    """Refuse to vary one of two equal numbers with the same meaning without the other.

    `moved` are the addresses of all numbers that are varied.
    """
    moved = set(moved)
    leaves = leaves_by_address(scenario)
    for first, second, _ in stated_twice(scenario):
        if first not in leaves or second not in leaves:
            continue
        alone = {first, second} & moved
        if len(alone) == 1 and not differ(leaves[first], leaves[second]):
            (one,) = alone
            other = second if one == first else first
            raise ValueError(
                f"{one} is varied, and {other}, which has the same meaning, is not: vary "
                "both"
            )


def differ(one: Any, other: Any) -> bool:
    """Whether two numbers differ by more than rounding."""
    return not np.allclose(np.asarray(one), np.asarray(other), rtol=1e-9, atol=1e-12)
