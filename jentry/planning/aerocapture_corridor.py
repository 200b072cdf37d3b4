"""Entry corridor of an aerocapture: between lift down and lift up all the way."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Integer

from .._programs import cached
from .._setup import needs_float64
from ..fields import Flag, Scalar
from ..flight.cycle import Plan
from ..flight.flight import Flight, fly
from ..flight.scenario import Scenario
from ..flight.scenario_checks import checked
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Outcome
from ..guidance.open_loop import BankProfile
from ..motion.orbit import OrbitTarget, orbit_of
from ..onboard.profiles import PolynomialProfile
from ..units import degree


_FLOWN = 17
"""Number of flights that divide an interval at once"""
_ROUNDS = 8
"""Number of divisions of the interval, each by 16"""

STEEPEST, SHALLOWEST = -20.0 * degree, -5.0 * degree
"""Flight-path angles between which limits are searched unless others are given, rad"""

_COS_BANK = {"shallow": -1.0, "steep": 1.0}
"""Cosine of the constant bank of the flight at each limit"""


class CaptureCorridor(NamedTuple):
    """Flight-path angles at the entry between which the target apoapsis can be met, rad."""

    shallow: Scalar
    """Shallowest angle: with the lift downwards throughout, the apoapsis is that of the
    target. A shallower flight leaves the air too fast, whatever its bank"""
    steep: Scalar
    """Steepest angle: with the lift upwards throughout, the apoapsis is that of the target.
    A steeper flight leaves the air too slowly, or not at all"""

    @property
    def width(self) -> Scalar:
        """Difference of the two angles, rad; negative if no angle allows a capture."""
        return self.shallow - self.steep


@needs_float64
def capture_corridor(
    scenario: Scenario,
    steepest: float = STEEPEST,
    shallowest: float = SHALLOWEST,
    solver: AbstractSolver = FixedStep(),
) -> CaptureCorridor:
    """Entry corridor of the vehicle of a scenario, whose target is an orbit.

    The flights are those of the scenario, with its air and errors, but with a constant bank
    in place of its law. The angles are those of the velocity relative to the planet, to
    1e-9 of the interval that is searched.

    **Arguments:**

    - `steepest`, `shallowest`: flight-path angles between which to search, rad.

    **Raises:** `ValueError` if the target is a place, if the angles are in the wrong order,
    if a limit does not lie between them, and if a flight stops before it has left the air,
    for example at its start or since steps are too long.
    """
    if not isinstance(scenario.target, OrbitTarget):
        raise ValueError(
            "target is a place: the corridor is about the apoapsis of a target orbit; give "
            "the scenario target=OrbitTarget(...)"
        )
    if not steepest < shallowest < 0.0:
        raise ValueError(
            f"steepest is {steepest / degree:g} deg and shallowest "
            f"{shallowest / degree:g} deg: both are below the horizon, so that steepest < "
            "shallowest < 0"
        )
    scenario = checked(scenario)
    found = {}
    for name, cosine in _COS_BANK.items():
        flown = _banked(scenario, cosine)
        low, high = jnp.asarray(steepest), jnp.asarray(shallowest)
        for _ in range(_ROUNDS):
            angles = jnp.linspace(low, high, _FLOWN)
            # The steeper a flight, the more it is braked.
            steep, outcomes = _too_low(flown, angles, solver)
            _require_left(angles, steep, outcomes, cosine)
            if not (bool(steep[0]) and not bool(steep[-1])):
                raise ValueError(
                    f"with the lift {_lift(cosine)}, the apoapsis of the target is not "
                    f"between {steepest / degree:g} and {shallowest / degree:g} deg: give "
                    "other angles"
                )
            first = jnp.argmin(steep)
            low, high = angles[first - 1], angles[first]
        found[name] = 0.5 * (low + high)
    return CaptureCorridor(**found)


@needs_float64
def limiting_flights(
    scenario: Scenario, corridor: CaptureCorridor, solver: AbstractSolver = FixedStep()
) -> dict[str, Flight]:
    """The flights at the limits of an entry corridor, by the names of its two angles.

    They have a history of each step.

    **Arguments:**

    - `corridor`: that of the scenario, by `capture_corridor` with the same solver.
    """
    flights = {}
    for name, cosine in _COS_BANK.items():
        flown = _from_angle(_banked(scenario, cosine), getattr(corridor, name))
        step = Plan.of(flown, solver, None).step
        flights[name] = cached(fly)(flown, solver, step)
    return flights


def _banked(scenario: Scenario, cosine: float) -> Scenario:
    """The scenario with a constant bank, by its cosine, in place of its law."""
    law = BankProfile(PolynomialProfile(jnp.full(1, cosine)))
    return dataclasses.replace(scenario, guidance=law)


def _from_angle(scenario: Scenario, angle: Scalar) -> Scenario:
    """The scenario with another flight-path angle at its start."""
    start = dataclasses.replace(scenario.initial_state, flight_path_angle=angle)
    return dataclasses.replace(scenario, initial_state=start)


def _lift(cosine: float) -> str:
    return f"{'up' if cosine > 0.0 else 'down'}wards"


def _require_left(
    angles: Float[Array, " n"],
    too_low: Bool[Array, " n"],
    outcomes: Integer[Array, " n"],
    cosine: float,
) -> None:
    """Refuse flights whose apoapsis is not known, since they stopped before the exit.

    In the air it only falls: one that is too low is known to be.
    """
    left = (outcomes == Outcome.REACHED) | (outcomes == Outcome.SKIPPED_OUT)
    unknown = ~too_low & ~left
    if bool(jnp.any(unknown)):
        which = int(jnp.argmax(unknown))
        angle = float(angles[which]) / degree
        raise ValueError(
            f"with the lift {_lift(cosine)}, the flight from {angle:g} deg "
            f"{Outcome(int(outcomes[which])).message}, and its apoapsis is not known: take "
            "a smaller step, other angles, or another start"
        )


@eqx.filter_jit
def _too_low(
    scenario: Scenario, angles: Float[Array, " n"], solver: AbstractSolver
) -> Any:
    """Whether flights from these angles have an apoapsis below that of the target.

    Also their outcomes.
    """
    planet, target = scenario.planet, scenario.target
    assert isinstance(target, OrbitTarget)
    goal = planet.radius + target.apoapsis_altitude

    def too_low(angle: Scalar) -> tuple[Flag, Any]:
        flight = fly(_from_angle(scenario, angle), solver)
        inverse = orbit_of(planet, flight.state).inverse_apoapsis_radius
        return goal * inverse > 1.0, flight.outcome

    return jax.vmap(too_low)(angles)
