"""RLV under the laws of other papers, with an attitude bandwidth of 5 rad/s.

All of them fly at or near the planned angle of attack. They begin where the mission's own
laws begin, have guidance cycles of equal length, and end at the same velocity. Bank laws
have the mission's six bank reversals. Gains are those of the law's own mission if nothing
else is stated.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._computed_once import computed_once
from ..._programs import cached
from ...fields import Scalar
from ...flight.flight import fly
from ...flight.scenario import Scenario
from ...flight.termination import Termination, VelocityBelow
from ...guidance.aim import TargetOfScenario
from ...guidance.angle_of_attack import AngleOfAttackProfile
from ...guidance.composition import compose
from ...guidance.drag_tracking import (
    ErrorGains,
    ObserverDragTracking,
    ObserverGains,
    StateFeedbackDragTracking,
)
from ...guidance.feedback_linearization import (
    AttitudeBand,
    GroundTrackModel,
    GroundTrackTracking,
)
from ...guidance.gated import Gated
from ...guidance.lateral import VelocityReversals
from ...guidance.law import AbstractContinuousLaw, Sampled
from ...guidance.open_loop import BankProfile
from ...guidance.pseudospectral_tracking import (
    DeviationWeights,
    Regulator,
    StoredGainTracking,
    plan_gains,
)
from ...guidance.shuttle import ShuttleBank
from ...motion.attitude import IdealAttitude
from ...motion.dynamics import EquatorialDynamics
from ...motion.forces import air_data
from ...motion.index import VelocityIndex
from ...motion.quantities import energy
from ...motion.state import EntryState
from ...onboard.longitudinal import LongitudinalModel, LongitudinalReference
from ...onboard.model import OnboardModel
from ...onboard.profiles import (
    PolynomialProfile,
    QuinticProfile,
    QuinticTable,
    grid,
    quintic_table,
)
from ...onboard.reference import DragReference
from ...onboard.scheduled_aerodynamics import ScheduledAerodynamics
from ...onboard.spline import cubic_spline
from ...planning.ground_track import GroundTrackPlan, plan_ground_track
from ...planning.longitudinal_flight import as_longitudinal
from ...planning.reference_flight import ReferenceFlight
from ...units import degree
from ..mars.drag_tracking import nominal_gains, nominal_observer
from ..sx_2.scenario import gains
from .airframe import vehicle
from .scenario import (
    CYCLE,
    LARGEST_BANK,
    REVERSALS,
    earth,
    entry,
    gate,
    model,
    plan,
    shuttle_bank,
    start,
)


FREQUENCY = 5.0
"""Bandwidth of the attitude, rad/s, that of the mission"""
FIRST_BANK = 30.0 * degree
"""Bank before guidance begins, as under the mission's bank law"""


HIGH_ANGLE = 40.0 * degree
"""Angle of attack at the beginning of the plan"""


def planned(name: str) -> QuinticProfile:
    """A quantity of the plan over the velocity."""
    table = plan().quantities
    assert isinstance(table, QuinticTable)
    return table.profile(name)


def reversals() -> VelocityReversals:
    """The bank reversals of the mission."""
    return VelocityReversals(jnp.array(REVERSALS))


def _at_planned_angle(bank: AbstractContinuousLaw) -> Scenario:
    angle = AngleOfAttackProfile(planned("angle_of_attack"))
    return entry(compose(angle, Sampled(bank, CYCLE)), FREQUENCY)


def bank_alone() -> Scenario:
    """The mission's bank law without modulation, with which the other laws are compared."""
    angle = AngleOfAttackProfile(planned("angle_of_attack"))
    return entry(compose(angle, shuttle_bank()), FREQUENCY)


# Drag tracking.

SLOWER = 4.0
"""Factor on the time constants of Yan and He. Their vehicle follows a bank command at once;
the bank of this vehicle has a bandwidth of 0.6 rad/s. With it their nominal gains give a
damping ratio of 0.02 with the drag rate, and -0.01 with the observer. The factor is the
least power of two for which both are 0.3 or more, the bound of the mission's tuning"""


def drag_gains() -> ErrorGains:
    """Gains of figures 1 to 10 of Yan and He, slower by the factor `SLOWER`."""
    gains = nominal_gains()
    return dataclasses.replace(gains, epsilon0=SLOWER * gains.epsilon0)


def drag_observer() -> ObserverGains:
    """Observer of figures 6 to 10, slower by the factor `SLOWER`."""
    observer = nominal_observer()
    return dataclasses.replace(observer, epsilon=SLOWER * observer.epsilon)


def drag_reference() -> DragReference:
    """The planned drag, which is tracked from where the mission's own laws begin."""
    held = PolynomialProfile(jnp.cos(jnp.array([FIRST_BANK])))
    return DragReference(VelocityIndex(), planned("drag"), held, gate().drag)


def scheduled_model() -> OnboardModel:
    """Onboard model of drag tracking, with coefficients at the planned angle of attack."""
    known = vehicle()
    aerodynamics = ScheduledAerodynamics(known.aerodynamics, planned("angle_of_attack"))
    return OnboardModel(earth(), dataclasses.replace(known, aerodynamics=aerodynamics))


def state_drag_tracking() -> Scenario:
    """Yan and He's law (14), four times slower than in figures 1 to 5."""
    law = StateFeedbackDragTracking(
        drag_gains(), drag_reference(), scheduled_model(), lateral=reversals()
    )
    return _at_planned_angle(law)


def observer_drag_tracking() -> Scenario:
    """Yan and He's law (24) with observer (25), four times slower than in their figures."""
    law = ObserverDragTracking(
        drag_gains(),
        drag_observer(),
        drag_reference(),
        scheduled_model(),
        lateral=reversals(),
    )
    return _at_planned_angle(law)


# Pseudospectral regulation.

_PARTS, _DEGREE = 25, 10
"""Number and degree of the polynomials of the flight over time"""


def in_plane() -> Scenario:
    """The nominal flight without reversals and attitude lag: a reference over time."""
    angle = AngleOfAttackProfile(planned("angle_of_attack"))
    law = compose(angle, ShuttleBank(plan(), gate=gate()))
    return dataclasses.replace(
        entry(law, FREQUENCY),
        planet=earth(),
        attitude=IdealAttitude(),
        dynamics=EquatorialDynamics(),
        constraints={},
    )


def longitudinal_model() -> LongitudinalModel:
    """The regulator's model of the motion in the vertical plane."""
    return LongitudinalModel(model(), planned("angle_of_attack"))


def _flown_in_plane(scenario: Scenario) -> LongitudinalReference:
    return as_longitudinal(ReferenceFlight.of(scenario), _PARTS, _DEGREE)


@computed_once
def longitudinal_reference() -> LongitudinalReference:
    """The flight `in_plane` from the start to the last velocity."""
    return cached(_flown_in_plane)(in_plane())


def _regulated(regulator: Regulator) -> Scenario:
    gains = cached(plan_gains)(regulator)
    return _at_planned_angle(StoredGainTracking(regulator, gains, reversals()))


def pseudospectral() -> Scenario:
    """Lee, Cho and Yan's regulator, with the weights of the X-33."""
    return _regulated(Regulator(longitudinal_model(), longitudinal_reference()))


def pseudospectral_with_range() -> Scenario:
    """The regulator with the downrange as a fourth state, with weights of the X-33."""
    underway, at_end = DeviationWeights(downrange=1.0), DeviationWeights(*4 * [3e4])
    regulated = _regulated(
        Regulator(
            longitudinal_model(),
            longitudinal_reference(),
            underway,
            at_end,
            aim=TargetOfScenario(),
        )
    )
    target = dataclasses.replace(regulated.target, origin=start())
    return dataclasses.replace(regulated, target=target)


# Feedback linearization.

_EARLIER, _BEYOND = 25.0, 1200.0
"""Time by which the reference begins before guidance, s, and velocity down to which it
continues, m/s: for flights with more or less energy there"""
_EVERY = 2.0
"""Time between the knots of the reference controls, s"""
_INTERVALS = 4000
"""Number of intervals of the tables"""


class Recorded(eqx.Module):
    """The start of a reference, and its attitude from there on."""

    start: EntryState
    controls: QuinticTable
    """Columns angle_of_attack and bank, rad, over the energy in J/kg"""


@computed_once
def recorded() -> Recorded:
    """The nominal flight of `bank_alone`, reversals and lag included."""
    ends = {"velocity": VelocityBelow(velocity=_BEYOND)}
    longer = dataclasses.replace(bank_alone(), termination=Termination(ends, 4000.0))
    history = fly(longer, history=_EVERY).history
    assert history is not None
    states, controls = history.states, history.controls
    high = jnp.asarray(HIGH_ANGLE)
    drag = jax.vmap(lambda s: air_data(earth(), vehicle(), s, high).drag)
    begins = np.argmax(np.asarray(drag(states)) > float(gate().drag))
    rows = np.flatnonzero(np.isfinite(np.asarray(history.time)))
    rows = rows[begins - int(_EARLIER / _EVERY) :]
    states = jax.tree.map(lambda x: x[rows], states)
    energies = jnp.asarray(jax.vmap(lambda s: energy(earth(), s))(states))[::-1]
    bank = jnp.arctan2(controls.sin_bank, controls.cos_bank)[rows][::-1]
    angle = jnp.asarray(controls.angle_of_attack)[rows][::-1]
    nodes = grid(energies[-1], energies[0], _INTERVALS)
    read = {}
    for name, values in (("angle_of_attack", angle), ("bank", bank)):
        spline = cubic_spline(energies, values)
        value, first, second = jax.vmap(spline.with_derivatives)(nodes)
        read[name] = tuple(jnp.asarray(x) for x in (value, first, second))
    begun = jax.tree.map(lambda x: x[0], states)
    return Recorded(begun, quintic_table(nodes, read))


def track_model() -> GroundTrackModel:
    """The motion that the law differentiates, under the attitude of `recorded`."""
    flown, end = recorded(), longitudinal_reference().end
    return GroundTrackModel(
        model(),
        flown.controls.profile("angle_of_attack"),
        flown.controls.profile("bank"),
        energy(earth(), flown.start) - energy(earth(), end.eastward()),
    )


def _planned_track(
    scenario: Scenario, tracked: GroundTrackModel, last: Scalar
) -> GroundTrackPlan:
    return plan_ground_track(scenario, tracked, last, intervals=_INTERVALS)


@computed_once
def ground_track() -> GroundTrackPlan:
    """The reference over the energy that follows from the attitude of `recorded`."""
    flown = dataclasses.replace(
        bank_alone(),
        planet=earth(),
        initial_state=recorded().start,
        attitude=IdealAttitude(),
        constraints={},
    )
    controls = recorded().controls
    last = controls.start + _INTERVALS * controls.spacing
    return cached(_planned_track)(flown, track_model(), last)


def feedback_linearization() -> Scenario:
    """Bharadwaj, Rao and Mease's law, with the eigenvalues and the band of the SX-2.

    The law does not suit this vehicle: its command leaves no time to turn. With the lag of
    this bank even the nominal flight departs from its reference by hundreds of km of
    downrange, and returns towards the end. Without a lag of the attitude it ends within
    2 km.
    """
    law = GroundTrackTracking(
        track_model(),
        ground_track().table,
        gains(),
        AttitudeBand(5.0 * degree, 5.0 * degree, 45.0 * degree, LARGEST_BANK),
    )
    held = PolynomialProfile(jnp.cos(jnp.array([FIRST_BANK])))
    gated = Gated(law, BankProfile(held, HIGH_ANGLE), gate().drag)
    return entry(Sampled(gated, CYCLE), FREQUENCY)
