"""The landing footprint: the outline of all points at which a vehicle can end."""

import dataclasses
import itertools
import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._setup import needs_float64
from ..addresses import addresses_of, replace_leaves
from ..fields import Scalar, scalar
from ..flight.flight import Flight
from ..flight.scenario import Scenario, Target
from ..flight.solver import AbstractSolver, FixedStep
from ..guidance.law import AbstractLaw
from .control_splines import bank_coefficients
from .flight_problem import AtEnd, FlightProblem, best_flight
from .optimization import Optimized


_FAR = 2.0
"""Distance of the targets that flights approach, in half-widths of the footprint"""


class Aim(eqx.Module):
    """Objective of the flights of a footprint, which all use one compiled program.

    It is the weighted sum of downrange and crossrange (as in `AtEnd`), plus half the square
    of the distance from the target, scaled by one length along and one across. The flights
    minimise it.
    """

    downrange: Scalar = scalar(0.0)
    crossrange: Scalar = scalar(0.0)
    along: Scalar = scalar(math.inf, unit="m")
    across: Scalar = scalar(math.inf, unit="m")

    def __call__(self, scenario: Scenario, flight: Flight) -> Scalar:
        target = scenario.place
        downrange = AtEnd("downrange")(scenario, flight)
        crossrange = AtEnd("crossrange")(scenario, flight)
        off = (downrange - target.downrange) / self.along
        aside = (crossrange - target.crossrange) / self.across
        weighed = self.downrange * downrange + self.crossrange * crossrange
        return weighed + 0.5 * (off**2 + aside**2)


@dataclasses.dataclass(frozen=True)
class Footprint:
    """Points on the outline of all places where a vehicle can end, in order around it."""

    downrange: np.ndarray
    """(points,) Downrange, m, as in `misses`"""
    crossrange: np.ndarray
    """(points,) Crossrange, m, positive to the left"""
    flights: tuple[Optimized, ...]
    """Flights that end at the points"""
    failed: tuple[str, ...] = ()
    """Directions without a point, with the reasons"""


@needs_float64
def footprint(
    scenario: Scenario,
    problem: FlightProblem,
    directions: int = 16,
    solver: AbstractSolver = FixedStep(),
    report: Callable[[int], None] = lambda done: None,
) -> Footprint:
    """Points on the outline of the set of places where a vehicle can end its flight.

    First the flights with the largest and the smallest downrange and crossrange are found.
    Then flights approach targets outside the footprint as closely as possible. The targets
    lie at equal angles around the middle, in units of the two widths. Each flight is an
    optimum under the constraints of the problem. Its search starts with the controls of a
    flight that ends nearby, or with their mirror image. The vehicle can reach all points of
    the outline; it can reach all places between them only if the set is convex.

    **Arguments:**

    - `problem`: free controls and constraints; its objective is not used.
    - `directions`: number of points in addition to the first four.
    - `report`: function that is called with the number of flights so far.

    **Raises:** `ValueError` if one of the first four flights is not found, and for motion
    in a plane. A direction without an optimum is left out, and listed in
    `Footprint.failed`.
    """
    if not scenario.dynamics.has_crossrange:
        raise ValueError(
            f"{type(scenario.dynamics).__name__} has no crossrange, which a footprint "
            "needs: take dynamics=EntryDynamics()"
        )
    if directions < 0:
        raise ValueError(f"directions is {directions}: it must be 0 or more")
    bank, extremes = problem.bank, []
    # A bank to the right turns towards negative crossrange.
    to_the_left = dataclasses.replace(bank, start=max(bank.least, -abs(bank.start)))
    for name, weight in (
        ("downrange", -1.0),
        ("downrange", 1.0),
        ("crossrange", -1.0),
        ("crossrange", 1.0),
    ):
        asked = dataclasses.replace(
            problem,
            objective=Aim(**{name: weight}),
            largest=False,
            bank=bank if name == "downrange" else to_the_left,
        )
        # The search for the flight to the right starts with the mirrored flight.
        begin = _mirrored(extremes[-1], problem) if len(extremes) == 3 else None
        extremes.append(best_flight(scenario, asked, solver, begin))
        report(len(extremes))
    places = np.array([_place(each) for each in extremes])
    (far, _), (near, _), (_, left), (_, right) = places
    middle = 0.5 * (far + near), 0.5 * (left + right)
    along, across = 0.5 * (far - near), 0.5 * (left - right)
    if not (along > 0.0 and across > 0.0):
        raise ValueError(
            f"the footprint is {2.0 * along:g} m long and {2.0 * across:g} m wide: the "
            "controls have no freedom left"
        )
    asked = dataclasses.replace(
        problem, objective=Aim(along=along, across=across), largest=False
    )
    found, failed = list(extremes), []
    for number in range(directions):
        angle = 2.0 * math.pi * (number + 0.5) / directions
        aim = (
            middle[0] + _FAR * along * math.cos(angle),
            middle[1] + _FAR * across * math.sin(angle),
        )
        begin = _nearest(found, problem, aim)
        aimed = dataclasses.replace(scenario, target=_aimed(scenario.place, *aim))
        try:
            found.append(best_flight(aimed, asked, solver, begin))
        except ValueError as error:
            failed.append(f"{math.degrees(angle):.0f} deg: {error}")
        report(len(found) + len(failed))
    around = sorted(found, key=lambda each: _angle(each, middle, along, across))
    places = np.array([_place(each) for each in around])
    return Footprint(places[:, 0], places[:, 1], tuple(around), tuple(failed))


def _place(best: Optimized) -> tuple[float, float]:
    downrange = AtEnd("downrange")(best.scenario, best.flight)
    return float(downrange), float(AtEnd("crossrange")(best.scenario, best.flight))


def _mirrored(best: Optimized, problem: FlightProblem) -> AbstractLaw:
    """The splines with the opposite bank, clipped to its bounds."""
    scenario = best.scenario
    least, most = problem.bank.least, problem.bank.most
    (address,) = addresses_of(scenario, bank_coefficients)
    other = jnp.clip(-bank_coefficients(scenario), least, most)
    return replace_leaves(scenario, {address: other}).guidance


def _nearest(
    found: list[Optimized], problem: FlightProblem, aim: tuple[float, float]
) -> AbstractLaw:
    """Controls of the flight, or of the mirror image, that ends nearest to an aim."""

    def off(best: Optimized, side: float) -> float:
        downrange, crossrange = _place(best)
        return math.dist((downrange, side * crossrange), aim)

    best, side = min(itertools.product(found, (1.0, -1.0)), key=lambda each: off(*each))
    return best.scenario.guidance if side > 0.0 else _mirrored(best, problem)


def _aimed(target: Target, downrange: float, crossrange: float) -> Target:
    return dataclasses.replace(target, downrange=downrange, crossrange=crossrange)


def _angle(
    best: Optimized, middle: tuple[float, float], along: float, across: float
) -> float:
    downrange, crossrange = _place(best)
    return math.atan2(
        (crossrange - middle[1]) / across, (downrange - middle[0]) / along
    )
