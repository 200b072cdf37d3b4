"""Mars lander under the terminal-point law of Apollo, with heading alignment.

Entry, target and dispersions are those of `drag_tracking`. Choices of our own are marked.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp

from ..._computed_once import computed_once
from ..._programs import cached
from ...flight.scenario import Scenario
from ...guidance.lateral import CrossrangeCorridor
from ...guidance.terminal_point import EarlyEnd, HeadingAlignment, TerminalPoint
from ...motion.dynamics import EntryDynamics
from ...onboard.model import OnboardModel
from ...onboard.profiles import JoinedProfile, PolynomialProfile, QuinticProfile
from ...onboard.reference import Reference
from ...planning.influence_coefficients import (
    plan_range_over_altitude,
    plan_terminal_point,
)
from ...planning.reference_flight import ReferenceFlight, open_loop
from ...units import degree, km
from .drag_tracking import END_VELOCITY, TABULATED_TO, entry, reference, to_the_place


ALIGNS_BELOW = 900.0
"""Velocity below which the bank aligns the heading, m/s; chosen"""

GATE = 4.0
"""Drag above which the range is controlled, m/s2; that of the laws over the velocity"""


def _planned_bank() -> PolynomialProfile:
    """Cosine of the bank of the planned flight of `drag_tracking`."""
    cos_bank = reference().cos_bank
    assert isinstance(cos_bank, PolynomialProfile)
    return cos_bank


@cached
def _plan(
    start: Scenario, cos_bank: PolynomialProfile
) -> tuple[Reference, QuinticProfile]:
    """Influence coefficients, and the range to go over the altitude.

    Below `ALIGNS_BELOW` the reference flies without bank, as in a heading alignment with no
    heading error. It ends 0.5 km higher than the planned flight.
    """
    level = PolynomialProfile(jnp.ones(1))
    ends = jnp.array([0.0, ALIGNS_BELOW, 2.0 * start.initial_state.velocity])
    profile = JoinedProfile((level, cos_bank), ends)
    flight = ReferenceFlight.of(open_loop(start, profile, TABULATED_TO))
    return (
        plan_terminal_point(flight, END_VELOCITY),
        plan_range_over_altitude(flight, END_VELOCITY, 60.0 * km),
    )


@computed_once
def _planned() -> tuple[Reference, QuinticProfile]:
    return _plan(entry(), _planned_bank())


def guided() -> Scenario:
    """The final phase of Apollo, over the velocity, and heading alignment at the end.

    The over-control gain of 5, the corridor, the gate and the heading alignment are
    chosen. The prebank is the planned bank at the entry.
    """
    start = entry()
    coefficients, range_to_go = _planned()
    law = TerminalPoint(
        reference=coefficients,
        planet=start.planet,
        lateral=CrossrangeCorridor(floor=300.0, widening=4e-4),
        gate=GATE,
        prebank=jnp.arccos(_planned_bank()(start.initial_state.velocity)),
        gain=5.0,
        alignment=HeadingAlignment(ALIGNS_BELOW, 20.0, 30.0 * degree),
        early_end=EarlyEnd(OnboardModel(start.planet, start.vehicle), range_to_go),
    )
    guided = eqx.tree_at(lambda s: s.guidance, to_the_place(start), law)
    return dataclasses.replace(guided, dynamics=EntryDynamics())
