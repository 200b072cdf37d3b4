"""The optimal flight of a vehicle for an objective, with free bank and angle of attack."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from ..addresses import addresses_of
from ..fields import Scalar, scalar, units_of
from ..flight.flight import Flight
from ..flight.miss import misses
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver, FixedStep
from ..guidance.law import AbstractLaw
from ..motion.index import AbstractIndex, EnergyIndex
from ..motion.orbit import orbit_of
from ..motion.quantities import energy, ground_track
from ..motion.state import EntryState
from ..parameters.maps import Bounds
from ..units import degree, km
from .control_splines import control_coefficients, free_controls
from .flight_constraints import Constraint, Quantity, within_limits
from .optimization import Optimized, optimize


_STATE = units_of(EntryState)
_ORBIT = {"apoapsis_altitude": "m", "periapsis_altitude": "m"}
_BESIDE = {
    "time": "s",
    "energy": "J/kg",
    "downrange": "m",
    "crossrange": "m",
    **_ORBIT,
    "velocity_increment": "m/s",
}

_MUCH = {"rad": degree, "s": 1.0, "m": km, "m/s": 1.0, "J/kg": 1000.0}

END_QUANTITIES: Mapping[str, str] = _STATE | _BESIDE
"""Quantities that `AtEnd` can compute, with their SI units"""


@dataclasses.dataclass(frozen=True)
class AtEnd:
    """A quantity at the end of a flight: of its state, or one of seven further quantities.

    These are time, energy, downrange, crossrange, the altitudes of apoapsis and periapsis
    of the orbit without air, and the velocity increment to the orbit that is the target.
    Downrange and crossrange are arcs from
    the origin of the target, or from the start of the flight if the target has no origin,
    as in `misses`. Crossrange is positive to the left. Downrange increases beyond half of
    the circumference of the planet, up to three quarters of it.
    """

    name: str

    def __post_init__(self):
        if self.name not in END_QUANTITIES:
            raise ValueError(
                f"no quantity {self.name!r} at the end: choose from "
                f"{', '.join(END_QUANTITIES)}"
            )

    @property
    def unit(self) -> str:
        """SI unit of the quantity."""
        return END_QUANTITIES[self.name]

    @property
    def much(self) -> float:
        """Scale of the quantity, used where its value is zero."""
        return _MUCH[self.unit]

    def __call__(self, scenario: Scenario, flight: Flight) -> Scalar:
        end = flight.state
        if self.name == "time":
            return flight.time
        if self.name == "energy":
            return energy(scenario.planet, end)
        if self.name in _ORBIT:
            return getattr(orbit_of(scenario.planet, end), self.name)
        if self.name == "velocity_increment":
            increment = misses(scenario, flight).velocity_increment
            if increment is None:
                raise ValueError(
                    "target is a place, and the velocity increment is that to an orbit: "
                    "give the scenario target=OrbitTarget(...), or choose from "
                    f"{', '.join(name for name in END_QUANTITIES if name != self.name)}"
                )
            return increment
        if self.name in ("downrange", "crossrange"):
            origin = scenario.target.origin
            origin = scenario.initial_state if origin is None else origin
            downrange, crossrange = ground_track(scenario.planet, origin, end)
            if self.name == "crossrange":
                return crossrange
            around = 2.0 * jnp.pi * scenario.planet.radius
            return jnp.where(downrange < -0.25 * around, downrange + around, downrange)
        return getattr(end, self.name)


@dataclasses.dataclass(frozen=True)
class Peak:
    """The largest value of a path constraint along the flight."""

    name: str

    def __call__(self, scenario: Scenario, flight: Flight) -> Scalar:
        return flight.peaks[self.name]


class Signed(eqx.Module):
    """A quantity times 1 (to minimise it) or times -1 (to maximise it), in one program."""

    quantity: Quantity
    sign: Scalar = scalar()

    def __call__(self, scenario: Scenario, flight: Flight) -> Scalar:
        return self.sign * self.quantity(scenario, flight)


@dataclasses.dataclass(frozen=True)
class FreeControl:
    """A free control: its start, and the values between which it stays; rad."""

    start: float
    least: float
    most: float

    unit: ClassVar[str] = "rad"

    def __post_init__(self):
        if not self.least <= self.start <= self.most or not self.least < self.most:
            start, least, most = (
                f"{x / degree:g} deg" for x in (self.start, self.least, self.most)
            )
            raise ValueError(
                f"a control starts at {start}, with the bounds {least} and {most}: the "
                "start must lie between them"
            )


@dataclasses.dataclass(frozen=True)
class FlightProblem:
    """An optimal control problem: objective, constraints and free controls of a flight.

    The limits of the path constraints of the scenario hold along the path. The splines of
    bank and angle of attack stay between their bounds everywhere.
    """

    objective: Quantity
    """Quantity to optimise, such as `AtEnd("downrange")`"""
    bank: FreeControl
    angle_of_attack: FreeControl | None = None
    """Free angle of attack. If it is None, the law or the trim of the vehicle determines
    the angle of attack, see `free_controls`"""
    constraints: Mapping[str, Constraint] = dataclasses.field(default_factory=dict)
    largest: bool = True
    """Whether the objective is maximised (True) or minimised (False)"""
    keeps_limits: bool = True
    """Whether the limits of the path constraints are enforced"""
    nodes: int = 40
    """Number of coefficients of each spline"""
    index: AbstractIndex = EnergyIndex()
    history: float = 10.0
    """Interval at which the path constraints are enforced, s"""
    published: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Best published values of the objective, SI, by the text of a mission's law, case and
    world"""


def best_flight(
    scenario: Scenario,
    problem: FlightProblem,
    solver: AbstractSolver = FixedStep(),
    begin: AbstractLaw | None = None,
) -> Optimized:
    """The optimal flight of the vehicle of a scenario for a problem.

    The optimizer minimises. For a maximum it minimises the negative of the objective, and
    `Optimized.objective` and the multipliers belong to this negative.

    **Arguments:**

    - `scenario`: splines of the controls replace its law, see `free_controls`.
    - `begin`: a law of `free_controls` from which the search starts instead of constant
      controls, such as `Optimized.scenario.guidance` of a similar problem.

    **Raises:** `ValueError` as `free_controls` and `optimize`.
    """
    free, angle = problem.bank, problem.angle_of_attack
    if begin is not None:
        start = dataclasses.replace(scenario, guidance=begin)
    else:
        begins = None if angle is None else angle.start
        start = free_controls(
            scenario, free.start, begins, problem.nodes, problem.index
        )
    bounds = [
        Bounds(each.least, each.most) for each in (free, angle) if each is not None
    ]
    addresses = addresses_of(start, control_coefficients)
    limited = any(each.limit is not None for each in scenario.constraints.values())
    kept = within_limits(scenario) if problem.keeps_limits and limited else {}
    clash = sorted(set(kept) & set(problem.constraints))
    if clash:
        raise ValueError(
            f"the problem has a constraint {clash[0]!r}, which is the name of a path "
            "constraint with a limit: take another name"
        )
    sign = -1.0 if problem.largest else 1.0
    return optimize(
        start,
        control_coefficients,
        Signed(problem.objective, sign),
        {**kept, **problem.constraints},
        ranges=dict(zip(addresses, bounds, strict=True)),
        solver=solver,
        history=problem.history,
    )
