"""What is checked of a scenario before it is flown, and which of its numbers count."""

import dataclasses
import math
import warnings
from collections.abc import Iterator, Mapping

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from .._printed import quantity_in_words
from ..addresses import (
    field_metadata,
    leaves_by_address,
    modules_by_address,
    unit_of,
    with_leaves,
)
from ..fields import NOT_NEGATIVE, Scalar, check_values, is_scalar, units_of
from ..guidance.aim import Aim, is_aim
from ..guidance.lateral import HeadingCorridor
from ..guidance.law import (
    AbstractLaw,
    kept_constraints,
    reads_forces_between_cycles,
)
from ..motion.constraints import AbstractConstraint, AbstractIntegral
from ..motion.dynamics import AbstractDynamics, EntryDynamics, EquatorialDynamics
from ..motion.orbit import OrbitTarget
from ..motion.quantities import from_ground_track, ground_track
from ..motion.singularities import at_rest
from ..motion.state import EntryState
from ..onboard.measurement import Accelerometers
from ..onboard.navigation import InertialNavigation
from ..onboard.track import Track
from ..units import degree, km
from .duplicate_numbers import check_stated_twice, nodes
from .scenario import Scenario
from .termination import RangeToGoBelow


def check(scenario: Scenario) -> None:
    """Refuse a scenario with a number that cannot be flown.

    Raises `ValueError` that names the address, the value and what was expected. Numbers
    that are not known yet (under `jit`, `vmap` or `grad`) are not checked here: see the
    outcome of the flight. Warns if the law enforces limits that the scenario does not have.
    """
    with_leaves(scenario)
    _check_kept(scenario.dynamics, scenario.initial_state)
    _check_one_target(scenario)
    check_stated_twice(scenario)
    _check_noise(scenario)
    _check_constraints(scenario)
    _check_navigation(scenario)
    _warn_without_limits(scenario)
    for address, leaf in leaves_by_address(scenario).items():
        if jax.config.read("jax_enable_x64") and leaf.dtype == np.float32:
            raise ValueError(
                f"{address} is of single precision: it was made before jentry.setup(), "
                "which comes first, or with dtype=float32"
            )
        if not isinstance(leaf, Tracer):
            check_leaf(scenario, address, np.asarray(leaf))
    _check_parts(scenario)
    law = scenario.law
    if law is not scenario.guidance:  # its parts have seen no target so far
        _check_parts(law, "guidance")


def check_leaf(
    scenario: Scenario, address: str, value: np.ndarray, *, had_unit: bool = False
) -> None:
    """Refuse a value for the leaf at an address; see `check_values`.

    Raises `ValueError` for a value that is not finite, or that this scenario cannot fly.
    """
    metadata = metadata_in(scenario, address)
    if np.ndim(value) and is_scalar(metadata):
        raise ValueError(
            f"{address} has the shape {np.shape(value)}: it must be one number; for many "
            "flights take monte_carlo(scenario, inputs=...) or jax.vmap"
        )
    try:
        check_values(address, value, metadata, had_unit=had_unit)
    except ValueError as error:
        if address != "initial_state.velocity" or np.any(value != 0.0):
            raise
        raise ValueError(
            f"{error}; to start at rest take dynamics=VectorDynamics()"
        ) from None


def _check_parts(tree: eqx.Module, root: str = "") -> None:
    """Refuse parts that their own classes refuse. A part checks itself when it is made, and
    not again when a leaf of it is replaced. `root` is the address of the tree."""
    for inner, part in modules_by_address(tree).items():
        address = ".".join(filter(None, (root, inner)))
        for kind in type(part).__mro__:
            if "__check_init__" not in vars(kind):
                continue
            try:
                # Numbers that are known are compared at once, even in a traced program.
                with jax.ensure_compile_time_eval():
                    vars(kind)["__check_init__"](part)
            except ValueError as error:
                where = f"{address}, {kind.__name__}" if address else kind.__name__
                raise ValueError(f"{where}: {error}") from None


def checked(scenario: Scenario) -> Scenario:
    """A scenario that can be flown, with every number a leaf; see `with_leaves`.

    Raises `ValueError` as `check` does.
    """
    scenario = with_leaves(scenario)
    check(scenario)
    return scenario


def _check_kept(dynamics: AbstractDynamics, start: EntryState) -> None:
    for name, wanted in dynamics.constant.items():
        value = getattr(start, name)
        if not isinstance(value, Tracer) and abs(np.asarray(value) - wanted) > 1e-12:
            unit = unit_of(start, name)
            raise ValueError(
                f"initial_state.{name} is {quantity_in_words(value, unit)}: "
                f"{type(dynamics).__name__} holds it at "
                f"{quantity_in_words(wanted, unit)}; take that, or other dynamics such "
                "as dynamics=EntryDynamics()"
            )


_APART = 1.0
"""m; the place of a law or an end condition is the target if it is nearer than this"""


def _check_navigation(scenario: Scenario) -> None:
    """Refuse dynamics that an inertial navigation does not integrate, and a filter with
    a covariance that is not positive."""
    navigation, dynamics = scenario.navigation, scenario.dynamics
    if not isinstance(navigation, InertialNavigation):
        return
    if type(dynamics) not in (EntryDynamics, EquatorialDynamics):
        raise ValueError(
            f"navigation is InertialNavigation and dynamics {type(dynamics).__name__}: it "
            "integrates the angles of a motion over a rotating planet; take "
            "dynamics=EntryDynamics(), or EquatorialDynamics() for a flight in the plane "
            "of the equator, or navigation=PerfectNavigation()"
        )
    if not dynamics.has_crossrange:
        _check_navigation_in_equator(scenario, navigation)
    if navigation.filter is not None:
        navigation.filter.check()


_ACROSS_EQUATOR = "navigation.knowledge.north", "navigation.knowledge.velocity_north"
"""Knowledge errors out of the plane of the equator"""


def _check_navigation_in_equator(
    scenario: Scenario, navigation: InertialNavigation
) -> None:
    """Refuse what would move a navigation out of the plane of the equator."""
    name = type(scenario.dynamics).__name__
    if navigation.filter is not None:
        raise ValueError(
            f"navigation has a filter and dynamics is {name}: the filter estimates "
            "latitude and heading, which a flight in the plane of the equator does not "
            "have; take InertialNavigation(filter=None), or dynamics=EntryDynamics()"
        )
    if navigation.gravity is not None:
        navigation.gravity.in_equator(scenario.planet.radius)  # raises if it pulls out
    for address in _ACROSS_EQUATOR:
        part = address.split(".")[-1]
        size = getattr(navigation.knowledge, part)
        if not isinstance(size, Tracer) and np.any(np.asarray(size) != 0.0):
            unit = unit_of(scenario, address)
            raise ValueError(
                f"{address} is {quantity_in_words(size, unit)}, and {name} knows no north: "
                "take 0, or dynamics=EntryDynamics()"
            )


def _check_one_target(scenario: Scenario) -> None:
    """Refuse a scenario that states two different targets."""
    to_orbit = isinstance(scenario.target, OrbitTarget)
    for part, address in nodes(scenario.guidance, is_aim, "guidance"):
        if isinstance(part, type(scenario.target) if to_orbit else Aim):
            raise ValueError(
                f"{address} is an {type(part).__name__}, and the scenario has a target: "
                "leave it out, and the law flies to scenario.target"
            )
    _ = scenario.law  # raises if the law flies to a place and the target is not one
    if isinstance(scenario.target, OrbitTarget):
        return
    target, planet = scenario.target, scenario.planet
    origin = scenario.initial_state if target.origin is None else target.origin
    for longitude, latitude, addresses in _places_to_go(scenario):
        numbers = jax.tree.leaves((target, origin, planet.radius, longitude, latitude))
        if any(isinstance(x, Tracer) for x in numbers):
            continue
        there = dataclasses.replace(origin, longitude=longitude, latitude=latitude)
        # Evaluated at once, even within a program that is being traced.
        with jax.ensure_compile_time_eval():
            ends = ground_track(planet, origin, there)
            place = from_ground_track(
                planet, origin, target.downrange, target.crossrange
            )
        off = math.hypot(
            float(ends[0]) - float(target.downrange),
            float(ends[1]) - float(target.crossrange),
        )
        if off > _APART:
            raise ValueError(
                f"{' and '.join(addresses)} say {_place(longitude, latitude)}, and the "
                f"target lies at {_place(*place)}, {off / km:.6g} km from there: a "
                "scenario has one target, so set them, target.downrange and "
                "target.crossrange to one place"
            )


def _place(longitude: Scalar, latitude: Scalar) -> str:
    east, north = float(longitude) / degree, float(latitude) / degree
    return f"longitude {east:.7g} deg and latitude {north:.7g} deg"


def _places_to_go(scenario: Scenario) -> Iterator[tuple[Scalar, Scalar, list[str]]]:
    """Longitudes and latitudes to which the scenario flies, with their addresses."""
    for tree, name in (
        (scenario.guidance, "guidance"),
        (scenario.termination, "termination"),
    ):
        for track, address in nodes(tree, Track, name):
            ends = [f"{address}.target_{x}" for x in ("longitude", "latitude")]
            yield track.target_longitude, track.target_latitude, ends
    for tree, kind, name in (
        (scenario.guidance, HeadingCorridor, "guidance"),
        (scenario.termination, RangeToGoBelow, "termination"),
    ):
        for part, address in nodes(tree, kind, name):
            ends = [f"{address}.{x}" for x in ("longitude", "latitude")]
            yield part.longitude, part.latitude, ends


def _check_constraints(scenario: Scenario) -> None:
    known = scenario.constraints
    for name, constraint in known.items():
        if not name.isidentifier() or name.startswith("_"):
            raise ValueError(
                f"constraints has the name {name!r}: it must be a word that a column of "
                "the results can have, such as heat_rate"
            )
        if name.endswith("_error"):
            raise ValueError(
                f"constraints has the name {name!r}: columns of the results that end with "
                "_error are misses; take another, such as "
                f"{name.removesuffix('_error')}_deviation"
            )
        if not isinstance(constraint, AbstractConstraint | AbstractIntegral):
            raise ValueError(
                f"constraints.{name} is {constraint!r}: it must be an AbstractConstraint "
                "or an AbstractIntegral, such as HeatRate()"
            )
        if not isinstance(getattr(constraint, "unit", None), str):
            raise ValueError(
                f"constraints.{name}: {type(constraint).__name__} has no unit; state "
                'that of its value in the class, such as unit = "W/m2", or "1"'
            )
    for field in ("located_peaks", "values_at_end"):
        for name in getattr(scenario, field):
            if name not in known:
                raise ValueError(
                    f"{field} has {name!r}, which is no constraint of the scenario: "
                    f"choose from {', '.join(known)}"
                )
    for name in scenario.values_at_end:
        if name in ("time", *units_of(EntryState)) or name.startswith("navigated_"):
            raise ValueError(
                f"values_at_end has {name!r}: the results have another end_{name}; give "
                "this constraint another name"
            )


def _warn_without_limits(scenario: Scenario) -> None:
    kinds = kept_constraints(scenario.guidance)
    known = scenario.constraints.items()
    kept = {name: each for name, each in known if isinstance(each, kinds)}
    if kept and all(each.limit is None for each in kept.values()):
        some, each = next(iter(kept.items()))
        warnings.warn(
            f"{type(scenario.guidance).__name__} respects the limits of "
            f"{', '.join(kept)}, and constraints has them without a limit: it lets them "
            f"become any value. Give one, such as "
            f'constraints={{"{some}": {type(each).__name__}(limit)}}, or leave these '
            "constraints out if none is meant",
            stacklevel=3,
        )


def _check_noise(scenario: Scenario) -> None:
    sensors, law = scenario.accelerometers, scenario.law
    if not isinstance(sensors, Accelerometers) or isinstance(sensors.noise, Tracer):
        return
    if np.asarray(sensors.noise) != 0.0:
        _require_samples(law, scenario, f"is {float(sensors.noise):g} m/s2")


def _require_samples(law: AbstractLaw, scenario: Scenario, noise: str) -> None:
    if reads_forces_between_cycles(law, scenario.initial_state):
        raise ValueError(
            f"accelerometers.noise {noise}: it is noise of samples, and "
            f"{type(law).__name__} reads its sensors at every instant; take 0, or a law "
            "that reads them at its guidance cycles"
        )


def without_effect(scenario: Scenario) -> tuple[str, ...]:
    """Addresses of the numbers that this scenario does not use."""
    constant = (f"initial_state.{name}" for name in scenario.dynamics.constant)
    in_plane = isinstance(scenario.dynamics, EquatorialDynamics)
    navigates = in_plane and isinstance(scenario.navigation, InertialNavigation)
    return *constant, *(_ACROSS_EQUATOR if navigates else ())


def require_effect(scenario: Scenario, address: str) -> None:
    """Refuse to vary a number that this scenario does not or cannot use."""
    if address == "accelerometers.noise":
        _require_samples(scenario.law, scenario, "is varied")
    if address in without_effect(scenario):
        raise ValueError(
            f"{address} has no effect in this scenario: "
            f"{type(scenario.dynamics).__name__} holds it; take other dynamics, such as "
            "dynamics=EntryDynamics()"
        )


def metadata_in(scenario: Scenario, address: str) -> Mapping:
    """Metadata of the leaf at an address, with the values that this scenario can fly.

    A flight may start at rest if its equations of motion are not singular there.
    """
    metadata = field_metadata(scenario, address)
    singular_at_rest = at_rest in scenario.dynamics.singular_points
    if address != "initial_state.velocity" or singular_at_rest:
        return metadata
    return {**metadata, "positive": False, "range": NOT_NEGATIVE}
