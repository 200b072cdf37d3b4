"""Apollo 10 under the entry guidance of the flight programs of Apollo.

Entry, target, limits and dispersions are those of `scenario`. The constants of the law are
those of the program, Comanche 055 (1969), unless they are marked.
"""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp

from ..._computed_once import computed_once
from ..._programs import cached
from ...fields import Scalar
from ...flight.flight import fly
from ...flight.scenario import Scenario
from ...flight.termination import AltitudeBelow, Termination
from ...guidance.apollo import ApolloEntry, SkipPrediction
from ...guidance.cycle import FixedCycle
from ...guidance.lateral import CrossrangeCorridor
from ...guidance.terminal_point import COLUMNS, TerminalPoint
from ...motion.dynamics import EquatorialDynamics
from ...motion.index import AltitudeIndex, VelocityIndex
from ...motion.state import EntryState
from ...onboard.profiles import JoinedProfile, PolynomialProfile, QuinticTable
from ...onboard.reference import Reference
from ...planning.influence_coefficients import plan_terminal_point
from ...planning.reference_flight import ReferenceFlight, open_loop
from ...units import degree, foot, km
from ...world.aerodynamics import ConstantAerodynamics
from ...world.atmosphere import ExponentialAtmosphere
from .scenario import END_ALTITUDE, guided as predictor_corrected


PLANNED_LIFT_TO_DRAG = 0.18
"""Upward lift-to-drag ratio of the reference of the final phase (LOD)"""

_UNIT = 51_532.3946 * foot
REFERENCE_VELOCITY, REFERENCE_RATE = 0.456023 * _UNIT, -0.0159061 * _UNIT
REFERENCE_DRAG = 0.00795 * 805.0 * foot
"""Start of the reference that the flight program stores: inertial velocity and altitude
rate, m/s, and drag, m/s2"""

EASTWARD = 0.92
"""Share of the rotation of the Earth in the direction of the flight; chosen, for a
latitude of 18 degrees and a heading of 75 degrees"""

MARGIN = 150.0 * km
"""Range by which the final phase is predicted shorter than that of the reference, m;
chosen. It leaves lift to dispersed flights: a final phase that starts too far from the
target cannot reach it"""

SECONDS_PER_RANGE = 1000.0
"""Time to go per rad of range to go, s"""
CORRIDOR = 4.0 * 0.00003
"""Half width of the corridor of the crossrange at low velocity, rad (LATBIAS)"""
CYCLE = FixedCycle(2.0)
GATE, PREBANK = 0.5, 60.0 * degree
"""Drag, m/s2, below which the final phase holds a bank, and that bank; chosen. The final
phase starts above this drag"""

_LAST = 0.97
"""Share of the velocity at the end down to which the reference is flown"""


def _reference_start(scenario: Scenario) -> Scenario:
    """Start of the reference of the final phase, to the east along the equator."""
    planet, vehicle = scenario.planet, scenario.vehicle
    turning = EASTWARD * planet.rotation_rate
    planet = eqx.tree_at(lambda p: p.rotation_rate, planet, turning)
    air = planet.atmosphere
    level = jnp.sqrt(REFERENCE_VELOCITY**2 - REFERENCE_RATE**2)
    ground = level - turning * planet.radius
    velocity = jnp.hypot(ground, REFERENCE_RATE)
    assert isinstance(air, ExponentialAtmosphere)
    assert isinstance(vehicle.aerodynamics, ConstantAerodynamics)
    coefficient = vehicle.aerodynamics.drag_coefficient * vehicle.reference_area
    density = 2.0 * REFERENCE_DRAG * vehicle.mass / (coefficient * velocity**2)
    start = EntryState(
        altitude=air.scale_height * jnp.log(air.surface_density / density),
        longitude=0.0,
        latitude=0.0,
        velocity=velocity,
        flight_path_angle=jnp.arctan2(jnp.asarray(REFERENCE_RATE), ground),
        heading=0.5 * math.pi,
    )
    return dataclasses.replace(
        scenario, planet=planet, initial_state=start, dynamics=EquatorialDynamics()
    )


@cached
def _plan(start: Scenario, cosine: Scalar) -> Reference:
    profile = PolynomialProfile(jnp.reshape(cosine, 1))
    ends = Termination({"altitude": AltitudeBelow(altitude=END_ALTITUDE)}, 900.0)
    whole = open_loop(start, profile, 1.0)
    end = fly(dataclasses.replace(whole, termination=ends)).state.velocity
    flight = ReferenceFlight.of(open_loop(start, profile, _LAST * end))
    return plan_terminal_point(flight, end, AltitudeIndex(), start_drag=1.0)


@computed_once
def _reference() -> Reference:
    """Reference of the final phase, which is constant beyond its ends."""
    scenario = _reference_start(predictor_corrected())
    aerodynamics = scenario.vehicle.aerodynamics
    assert isinstance(aerodynamics, ConstantAerodynamics)
    ratio = aerodynamics.lift_coefficient / aerodynamics.drag_coefficient
    table = _plan(scenario, PLANNED_LIFT_TO_DRAG / ratio).quantities
    assert isinstance(table, QuinticTable)
    intervals = table.coefficients[COLUMNS[0]].shape[0]
    ends = jnp.stack([table.start + intervals * table.spacing, table.start])
    return Reference(
        VelocityIndex(),
        {name: JoinedProfile((table.profile(name),), ends) for name in COLUMNS},
    )


def _prediction(scenario: Scenario, reference: Reference) -> SkipPrediction:
    """Constants of the program, with the air and the final phase of this mission.

    The program has a scale height of 28 500 feet and a linear range of the final phase,
    which is that of its reference where this starts. Here both are those of this mission.
    """
    usual, planet = SkipPrediction(), scenario.planet
    assert isinstance(planet.atmosphere, ExponentialAtmosphere)
    start = jnp.asarray(REFERENCE_VELOCITY)  # inertial: beyond the start of the table
    flown = reference.over_index(start)["range_to_go"][0] / planet.radius
    carried = EASTWARD * planet.rotation_rate * SECONDS_PER_RANGE
    moved = flown / (1.0 - carried) - MARGIN / planet.radius
    return dataclasses.replace(
        usual,
        scale_height=planet.atmosphere.scale_height,
        final_range=moved - usual.final_range_per_velocity * REFERENCE_VELOCITY,
    )


def guided() -> Scenario:
    """The five phases, with the bank of the end held below 305 m/s as in the program."""
    scenario, reference = predictor_corrected(), _reference()
    prediction, planet = _prediction(scenario, reference), scenario.planet
    per_square = prediction.lift_to_drag / 24.0 / prediction.circular_velocity**2
    final = TerminalPoint(
        reference=reference,
        planet=planet,
        lateral=CrossrangeCorridor(
            floor=CORRIDOR * planet.radius, widening=per_square * planet.radius
        ),
        gate=GATE,
        prebank=PREBANK,
        smallest_bank=15.0 * degree,
        narrowing=0.5,
        cycle=CYCLE,
    )
    law = ApolloEntry(
        final=final,
        prediction=prediction,
        seconds_per_range=SECONDS_PER_RANGE,
        cycle=CYCLE,
    )
    return dataclasses.replace(scenario, guidance=law)


def steered() -> Scenario:
    """The five phases, with a final phase that steers to the end; our own.

    A bank that is held for the last minute turns the capsule on a part of a circle, and
    leaves it short of the target.
    """
    scenario = guided()
    law = dataclasses.replace(scenario.guidance, steers_to_the_end=True)
    return dataclasses.replace(scenario, guidance=law)
