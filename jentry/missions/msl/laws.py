"""Laws of the mission `msl`: the terminal-point law, and a predictor-corrector.

The phases are those of the Mars Science Laboratory: a constant bank up to a drag of 0.2 g
(Y. Zheng, H. Cui, Y. Tian, AIAA 2015-2398, introduction), range control, and heading
alignment below a velocity. The settings are in the papers of G. F. Mendeck and L. E. Craig,
of which we have read the abstracts only. The numbers here are chosen.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._computed_once import computed_once
from ..._newton import newton
from ..._programs import cached
from ...fields import Scalar
from ...flight.flight import fly
from ...flight.scenario import Scenario
from ...guidance.bank_shapes import ConstantBankShape
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import CrossrangeCorridor, PredictedCrossrange
from ...guidance.predictor_corrector import PredictorCorrector
from ...guidance.terminal_point import HeadingAlignment, TerminalPoint
from ...motion.dynamics import EquatorialDynamics
from ...motion.quantities import ground_track
from ...onboard.model import OnboardModel
from ...onboard.profiles import JoinedProfile, PolynomialProfile
from ...onboard.reference import Reference
from ...planning.influence_coefficients import plan_terminal_point
from ...planning.reference_flight import ReferenceFlight, open_loop, require_planned
from ...units import degree, km, standard_gravity
from .scenario import CEILING, END_VELOCITY, entry


GATE = 0.2 * standard_gravity
"""Drag above which the range is controlled, m/s2"""
ALIGNS_BELOW = 1100.0
"""Velocity below which the bank aligns the heading, m/s; chosen"""
TABULATED_TO = 300.0
"""Velocity down to which the reference extends, m/s: beyond the end"""


class Plan(NamedTuple):
    """The planned flight of the terminal-point law."""

    cos_bank: Scalar
    """Cosine of the constant bank down to `ALIGNS_BELOW`"""
    reference: Reference


def in_plane(scenario: Scenario) -> Scenario:
    """The entry along the equator, with zero bank in place of a law.

    The planned flight has no bank reversals. In three dimensions its heading would turn
    away by tens of degrees. The heading of the entry is within 4 degrees of east, and its
    latitude within 4 degrees of the equator.
    """
    start = dataclasses.replace(
        scenario.initial_state, longitude=0.0, latitude=0.0, heading=90.0 * degree
    )
    return dataclasses.replace(
        scenario, initial_state=start, dynamics=EquatorialDynamics()
    )


def profile(cos_bank: Scalar, entry_velocity: Scalar) -> JoinedProfile:
    """A constant bank down to `ALIGNS_BELOW`, and none below: all the lift is upwards."""
    parts = jnp.ones(1), jnp.reshape(cos_bank, 1)
    level, constant = map(PolynomialProfile, parts)
    ends = jnp.array([0.0, ALIGNS_BELOW, 2.0 * entry_velocity])
    return JoinedProfile((level, constant), ends)


@cached
def _plan(start: Scenario) -> Plan:
    """The constant bank whose flight along the equator has the range of the target."""
    flat = in_plane(start)
    velocity = start.initial_state.velocity

    def error(cos_bank: Scalar) -> Scalar:
        """Range error in units of 100 km."""
        flown = fly(open_loop(flat, profile(cos_bank, velocity), END_VELOCITY))
        downrange, _ = ground_track(flat.planet, flat.initial_state, flown.state)
        return (downrange - start.place.downrange) / (100.0 * km)

    def differences(cos_bank):
        step = 1e-4
        one, other = jnp.asarray(jax.vmap(error)(cos_bank + jnp.array([0.0, step])))
        return one, (other - one) / step

    found = newton(differences, jnp.asarray(0.65), 6, lower=-1.0, upper=1.0)
    # 10 m, before the last step
    planned = found.known & (jnp.abs(found.value) < 1e-4)
    cos_bank = jnp.where(planned, found.x, jnp.nan)
    flight = ReferenceFlight.of(
        open_loop(flat, profile(cos_bank, velocity), TABULATED_TO)
    )
    return Plan(cos_bank, plan_terminal_point(flight, END_VELOCITY, start_drag=1.5))


@computed_once
def plan() -> Plan:
    """The planned flight of the mission.

    Raises `ValueError` if no constant bank has the range of the target.
    """
    planned = _plan(entry())
    require_planned(planned.cos_bank)
    return planned


def terminal_point() -> Scenario:
    """Prebank, range control by influence coefficients, and heading alignment.

    The bank before range control is that of the planned flight. The over-control gain is
    that of Apollo, 4. Corridor and heading alignment are chosen; the corridor gives three
    bank reversals, as many as were flown.
    """
    start = entry()
    planned = plan()
    law = TerminalPoint(
        reference=planned.reference,
        planet=start.planet,
        lateral=CrossrangeCorridor(floor=1.0 * km, widening=8e-4),
        gate=GATE,
        prebank=jnp.arccos(planned.cos_bank),
        gain=4.0,
        alignment=HeadingAlignment(ALIGNS_BELOW, 4.0, 30.0 * degree),
    )
    return eqx.tree_at(lambda s: s.guidance, start, law)


def predictor_corrector() -> Scenario:
    """A constant bank to the end, corrected every 2 s by predictions of the flight.

    The prediction also determines the bank reversals.
    """
    start = entry()
    law = PredictorCorrector(
        model=OnboardModel(start.planet, start.vehicle),
        shape=ConstantBankShape(),
        end=GuidedEnd(END_VELOCITY, ceiling=CEILING),
        lateral=PredictedCrossrange(),
        in_space=True,
    )
    return eqx.tree_at(lambda s: s.guidance, start, law)
