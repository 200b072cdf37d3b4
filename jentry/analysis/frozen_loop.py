"""The closed loop of any law, linearized along its flight: eigenvalues and zeros.

At a point of the flight the linear system is assumed to be constant: frozen. The
eigenvalues indicate the effect of gains, but prove no stability. Where the system changes
as fast as its errors decay, the eigenvalues depend on the coordinates of the errors.
"""

import dataclasses
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Complex, Float

from .._printed import quantity_in_words
from .._setup import needs_float64
from ..flight.scenario import Scenario
from ..flight.scenario_checks import checked
from ..flight.solver import AbstractSolver, FixedStep
from ..guidance.law import AbstractSampledLaw, Tracked
from ..motion.index import AbstractIndex, TimeIndex
from .coordinates import in_errors, lift, without
from .local_derivatives import (
    FlownPoints,
    LoopDerivatives,
    fly_points,
    loop_derivatives,
    plant_derivatives,
    what_is_tracked,
)
from .zeros import transmission_zeros


DEADBEAT = 1e-7
"""Magnitude below which a multiplier counts as zero. Rounding turns a double zero into the
square root of the rounding error"""


class Worst(NamedTuple):
    """An extreme value of an eigenvalue's property, and the point where it occurs."""

    value: float
    eigenvalue: complex
    """Per unit of the index"""
    index: float
    time: float
    """s since the start"""


@dataclasses.dataclass(frozen=True)
class FrozenLoop:
    """A closed loop that is linearized at points of its flight.

    All rates are per unit of the index that has *passed*: with a negative real part errors
    decay, whether the index rises or falls along the flight. Multiplied by `span`, rates
    are per whole flight.
    """

    over: str
    """Name of the index, such as energy"""
    unit: str
    """SI unit of the index"""
    index: Float[np.ndarray, " points"]
    """Values of the index at the points"""
    time: Float[np.ndarray, " points"]
    """s since the start"""
    span: float
    """Change of the index from the start of the flight to its end, as a magnitude"""
    coordinates: tuple[str, ...]
    """Names of the deviations at equal index, in SI units: time, motion, attitude, memory,
    held commands"""
    eliminated: str
    """The coordinate whose deviation follows from the others, since the index is equal"""
    ignorable: tuple[str, ...]
    """Coordinates that are left out because no other coordinate depends on them. Each has
    an eigenvalue of zero"""
    forgotten: tuple[str, ...]
    """Coordinates that are left out because each decision replaces them: deadbeat"""
    matrices: Float[np.ndarray, "points n n"]
    """Derivatives of the rates of the deviations, per unit of the index, with respect to
    the deviations. For a law with a guidance cycle: derivatives of the deviations after one
    cycle with respect to those before its decision"""
    multipliers: Complex[np.ndarray, "points n"] | None
    """Eigenvalues of the map of one cycle; None for a continuous law"""
    eigenvalues: Complex[np.ndarray, "points n"]
    """Eigenvalues per unit of the index. With a guidance cycle they are the logarithms of
    the multipliers over the length of the cycle, and minus infinity for a deadbeat one.
    Each column follows one eigenvalue from point to point"""
    zeros: Complex[np.ndarray, "points zeros"] | None
    """Transmission zeros of the vehicle, per unit of the index, from the controls that the
    law uses to the outputs that it tracks; NaN at points with fewer zeros. High gains drive
    eigenvalues into them. None if there are no zeros, see `without_zeros`"""
    without_zeros: str
    """Why there are no zeros; empty if there are zeros"""
    ended_by: str
    """Name of the end condition of the flight"""

    @property
    def per_span(self) -> Complex[np.ndarray, "points n"]:
        """Eigenvalues per span of the index; minus infinity for a deadbeat eigenvalue."""
        deadbeat = np.isinf(self.eigenvalues)
        scaled = np.where(deadbeat, 0.0, self.eigenvalues) * self.span
        return np.where(deadbeat, -np.inf, scaled)

    @property
    def damping(self) -> Float[np.ndarray, "points n"]:
        """Damping ratios of the eigenvalues, from 1 (aperiodic) to -1 (diverging)."""
        size = np.abs(self.eigenvalues)
        finite = np.isfinite(size) & (size > 0.0)
        ratio = -np.real(self.eigenvalues) / np.where(finite, size, 1.0)
        return np.where(np.isinf(size), 1.0, np.where(size > 0.0, ratio, 0.0))

    @property
    def least_damping(self) -> Worst:
        """The smallest damping ratio of all points."""
        return self._worst(-self.damping, self.damping)

    def least_damping_of(self, faster_than: float) -> Worst:
        """The smallest damping ratio of modes with larger eigenvalues than `faster_than`.

        `faster_than` is per unit of the index. Quantities that hardly change along the
        whole flight, such as the heading, look undamped. NaN if no mode is as fast.
        """
        counts = np.abs(self.eigenvalues) > faster_than
        if not counts.any():
            return Worst(np.nan, complex(np.nan), np.nan, np.nan)
        return self._worst(np.where(counts, -self.damping, -np.inf), self.damping)

    @property
    def largest_real_part(self) -> Worst:
        """The largest real part of all points: positive where errors grow."""
        real = np.real(self.eigenvalues)
        return self._worst(real, real)

    def _worst(self, badness: np.ndarray, value: np.ndarray) -> Worst:
        if not badness.size:
            return Worst(np.nan, complex(np.nan), np.nan, np.nan)
        point, place = np.unravel_index(np.argmax(badness), badness.shape)
        return Worst(
            float(value[point, place]),
            complex(self.eigenvalues[point, place]),
            float(self.index[point]),
            float(self.time[point]),
        )

    def __str__(self) -> str:
        def at(worst: Worst) -> str:
            return f"at {quantity_in_words(worst.index, self.unit)}, {worst.time:.1f} s"

        grows, swings = self.largest_real_part, self.least_damping
        lines = [
            f"FrozenLoop over {self.over}, span {quantity_in_words(self.span, self.unit)}",
            f"  {self.over}  {quantity_in_words(self.index, self.unit)}",
            f"  coordinates  {', '.join(self.coordinates)}",
            f"  largest real part  {grows.value * self.span:.4g} per span, {at(grows)}",
            f"  least damping  {swings.value:.4g}, {at(swings)}",
        ]
        for name, names in (
            ("nothing depends on", self.ignorable),
            ("replaced by each decision", self.forgotten),
            ("no zeros", (self.without_zeros,) if self.without_zeros else ()),
        ):
            lines += [f"  {name}  {', '.join(names)}"] if names else []
        return "\n".join(lines)


@needs_float64
def linearize(
    scenario: Scenario,
    index: AbstractIndex = TimeIndex(),
    points: int = 20,
    *,
    solver: AbstractSolver = FixedStep(),
) -> FrozenLoop:
    """Fly a scenario and linearize its closed loop at points of the flight.

    Deviations are taken at equal index, as for a law that evaluates its reference at the
    index: at equal energy a velocity error is an altitude error. This eliminates the
    coordinate in which the index is steepest, and the eigenvalue of zero that belongs to a
    shift along the flight. Motion, attitude and continuous memory of the law are
    linearized, including active limits; integers are not differentiated. All derivatives
    are exact.

    If the law declares the errors that it tracks, and these determine the motion, the
    errors that the law feeds back (e1, e1', ...) replace the deviations of the motion. In
    these coordinates the eigenvalues appear for which the law was designed; in altitude and
    flight-path angle they would not.

    For a continuous law the matrix is that of the rates. For a law with a guidance cycle it
    is the map of one cycle, including the decision, the attitude and the steps of the
    solver. The map takes deviations at equal index before the cycle to deviations at equal
    index after it, along the flow.

    **Arguments:**

    - `index`: index at which deviations are compared; time by default.
    - `points`: number of points, evenly spaced over the index from the start to the end.
        Each is moved to the nearest step of the solver, or start of a guidance cycle.

    **Raises:** `ValueError` for a flight without an end or without a whole cycle, for an
    index that is not strictly monotonic along it, for fewer steps than points, and where a
    derivative is not finite.

        loop = linearize(scenario, EnergyIndex())
        loop.per_span, loop.least_damping
    """
    scenario, flown, found, out, matrices = at_equal_index(
        scenario, index, points, solver
    )
    names = np.delete(np.array(flown.coordinates), out)
    sampled = isinstance(scenario.guidance, AbstractSampledLaw)
    same = np.eye(len(names)) if sampled else np.zeros((len(names), len(names)))
    kept, ignorable = without(matrices, same, np.arange(len(names)))
    kept, forgotten = without(matrices, 0.0 * same, kept) if sampled else (kept, [])
    matrices, coordinates = matrices[:, kept[:, None], kept], list(names[kept])
    tracked = what_is_tracked(scenario, flown.lanes)
    if tracked is not None:
        matrices, coordinates = in_errors(
            matrices, coordinates, kept, tracked, found, out, sampled
        )
    eigenvalues = _followed(np.linalg.eigvals(matrices).astype(complex))
    multipliers = eigenvalues if sampled else None
    if multipliers is not None:
        deadbeat = np.abs(multipliers) < DEADBEAT
        rates = np.log(np.where(deadbeat, 1.0, multipliers)) / found.way[:, None]
        eigenvalues = np.where(deadbeat, -np.inf, rates)
    zeros, why_none = _zeros(scenario, index, flown, tracked, flown.coordinates[out])
    return FrozenLoop(
        over=type(index).__name__.removesuffix("Index").lower(),
        unit=index.unit,
        index=flown.index,
        time=flown.time,
        span=flown.span,
        coordinates=tuple(map(str, coordinates)),
        eliminated=flown.coordinates[out],
        ignorable=tuple(map(str, names[ignorable])),
        forgotten=tuple(map(str, names[forgotten])),
        matrices=matrices,
        multipliers=multipliers,
        eigenvalues=eigenvalues,
        zeros=zeros,
        without_zeros=why_none,
        ended_by=flown.ended_by,
    )


def at_equal_index(
    scenario: Scenario, index: AbstractIndex, points: int, solver: AbstractSolver
) -> tuple[Scenario, FlownPoints, LoopDerivatives, int, np.ndarray]:
    """Linearize a closed loop at equal index, in coordinates of the motion.

    **Returns:** the checked scenario, the points of its flight, the derivatives there, the
    place of the eliminated coordinate, and the matrices without this coordinate.

    **Raises:** `ValueError` as `linearize`.
    """
    scenario = checked(scenario)
    flown = fly_points(scenario, index, points, solver)
    found = loop_derivatives(scenario, index, flown.plan, flown.lanes)
    found = jax.tree.map(np.asarray, found)
    _require_finite(found, flown)
    out = _steepest(found)
    matrices = np.delete(found.derivative @ lift(found.gradient, out), out, axis=1)
    return scenario, flown, found, out, matrices


def _require_finite(found: LoopDerivatives, flown: FlownPoints) -> None:
    known = [
        np.isfinite(x).reshape(len(x), -1).all(axis=1)
        for x in map(np.asarray, jax.tree.leaves(found))
    ]
    lost = np.flatnonzero(~np.all(known, axis=0))
    if lost.size:
        raise ValueError(
            f"the derivative of the closed loop {flown.time[lost[0]]:g} s after the start "
            "is not finite: the law may have none there, like a square root at zero"
        )


def _steepest(found: LoopDerivatives) -> int:
    """Place of the coordinate whose smallest share of the rate of the index is largest."""
    shares = np.abs(found.shares)
    least = np.min(shares / np.sum(shares, axis=1, keepdims=True), axis=0)
    if not np.max(least) > 0.0:
        raise ValueError(
            "no coordinate changes the index along the whole flight, so that none can be "
            "eliminated at equal index; take another index, such as TimeIndex()"
        )
    return int(np.argmax(least))


def _followed(eigenvalues: np.ndarray) -> np.ndarray:
    """Order eigenvalues so that each column follows the closest one from point to point."""
    found = [np.sort_complex(eigenvalues[0])]
    for new in eigenvalues[1:]:
        away = np.abs(found[-1][:, None] - new[None, :])
        ordered = np.empty_like(new)
        for _ in new:
            before, here = np.unravel_index(np.argmin(away), away.shape)
            ordered[before] = new[here]
            away[before], away[:, here] = np.inf, np.inf
        found.append(ordered)
    return np.stack(found)


def _zeros(
    scenario: Scenario,
    index: AbstractIndex,
    flown: FlownPoints,
    tracked: Tracked | None,
    eliminated: str,
) -> tuple[np.ndarray | None, str]:
    """Transmission zeros at all points, or why there are none."""
    law = type(scenario.guidance).__name__
    if tracked is None:
        return None, f"{law} does not say what it tracks"
    count = len(tracked.errors)
    if count != len(tracked.by):
        return None, f"{law} tracks {count} outputs by {len(tracked.by)} controls"
    plant = plant_derivatives(scenario, index, flown.plan, flown.lanes)
    plant = jax.tree.map(np.asarray, plant)
    by = [("angle_of_attack", "bank_angle").index(name) for name in tracked.by]
    a, b, c, d = plant.a, plant.b[..., by], plant.c, plant.d[..., by]
    states = list(vars(scenario.initial_state))
    if eliminated in states:
        out = states.index(eliminated)
        equal = lift(plant.gradient, out)
        a, b, c = np.delete(a @ equal, out, 1), np.delete(b, out, 1), c @ equal
    seen = np.any(c != 0.0, axis=(0, 1))
    for _ in seen:  # what the outputs depend on, and what that depends on
        seen |= np.any(a[:, seen] != 0.0, axis=(0, 1))
    a, b, c = a[:, seen][..., seen], b[:, seen], c[..., seen]
    span = flown.span
    found = [
        transmission_zeros(span * a, span * b, c, d)
        for a, b, c, d in zip(a, b, c, d, strict=True)
    ]
    known = [x for x in found if x is not None]
    if not known:
        return None, f"what {law} tracks is not moved by {' and '.join(tracked.by)}"
    most = max(map(len, known))
    padded = np.full((len(found), most), complex(np.nan, np.nan))
    for row, x in zip(padded, found, strict=True):
        if x is not None:
            row[: len(x)] = np.sort_complex(x) / span
    return padded, ""
