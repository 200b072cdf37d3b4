"""X-33 under the laws of other papers: all of them track the flight of `reference()`.

Laws that depend on the state and not on time end at the velocity of the end of the
reference, like the predictor-corrector. Gains are those of the law's own mission,
unchanged: gains over time are in seconds, the others are dimensionless.
"""

import dataclasses

import jax.numpy as jnp

from ..._computed_once import computed_once
from ..._integrate import runge_kutta
from ..._programs import cached
from ...fields import Scalar
from ...flight.scenario import Scenario
from ...flight.termination import Termination, VelocityBelow
from ...guidance.angle_of_attack import AngleOfAttackProfile
from ...guidance.angle_of_attack_modulation import DynamicalModulation
from ...guidance.composition import BankLimits, compose
from ...guidance.drag_tracking import (
    ObserverDragTracking,
    StateFeedbackDragTracking,
)
from ...guidance.feedback_linearization import (
    AttitudeBand,
    GroundTrackModel,
    GroundTrackTracking,
)
from ...guidance.law import AbstractLaw, Sampled
from ...guidance.shuttle import ShuttleBank, ShuttleModulation
from ...motion.forces import air_data
from ...motion.index import AbstractIndex, EnergyIndex, VelocityIndex
from ...motion.quantities import energy
from ...motion.state import Controls, EntryState
from ...onboard.model import OnboardModel
from ...onboard.profiles import QuinticTable
from ...onboard.reference import DragReference, Reference
from ...onboard.scheduled_aerodynamics import ScheduledAerodynamics
from ...onboard.velocity_domain import VelocityDomain
from ...planning.ground_track import GroundTrackPlan, plan_ground_track
from ...planning.reference_flight import ReferenceFlight
from ...units import degree
from ..mars.drag_tracking import nominal_gains, nominal_observer
from ..sx_2.scenario import gains
from .airframe import ScheduledAngleOfAttack, vehicle
from .scenario import STEP, cos_bank, earth, glide, open_loop, reference


_BEFORE = 30.0
"""Time by which the reference begins earlier, s: for errors that raise the energy"""
_BEYOND = 600.0
"""Velocity down to which the reference continues, m/s: for ends with less energy"""
_INTERVALS = 2000
"""Number of intervals of the tables"""
CYCLE = 0.1
"""Guidance cycle of the laws of the RLV, s, as in that mission"""
LARGEST_BANK = 80.0 * degree
"""Largest bank of the laws of the RLV and of the SX-2, as in those missions"""


def _angle(state: EntryState) -> Scalar:
    return ScheduledAngleOfAttack()(state.velocity)


def _cosine(state: EntryState) -> Scalar:
    return cos_bank()(state.velocity)


def longer() -> Scenario:
    """The reference without feedback, with an earlier start and beyond its end."""
    flown = open_loop()

    def slope(_: Scalar, state: EntryState) -> EntryState:
        cosine = _cosine(state)
        controls = Controls(_angle(state), cosine, jnp.sqrt(1.0 - cosine**2))
        return flown.dynamics.rates(flown.planet, flown.vehicle, state, controls)

    back = runge_kutta(slope, 0.0, -_BEFORE, flown.initial_state, 300)
    ends = {"velocity": VelocityBelow(velocity=_BEYOND)}
    limit = 2.0 * float(reference().ends[-1])
    return dataclasses.replace(
        flown, initial_state=back, termination=Termination(ends, limit)
    )


def _quantities(time: Scalar, state: EntryState) -> dict[str, Scalar]:
    """Quantities of a reference that the laws use, by name."""
    angle, cosine = _angle(state), _cosine(state)
    air = air_data(earth(), vehicle(), state, angle)
    return {
        "altitude": state.altitude,
        "flight_path_angle": state.flight_path_angle,
        "angle_of_attack": angle,
        "bank": jnp.arccos(cosine),
        "drag": air.drag,
        "lift": air.lift,
        "altitude_rate": state.velocity * jnp.sin(state.flight_path_angle),
        "lift_to_drag_up": cosine * air.lift / air.drag,
    }


def _tabulated(scenario: Scenario, index: AbstractIndex) -> QuinticTable:
    flight = ReferenceFlight.of(scenario)
    return flight.tabulate(_quantities, index, _INTERVALS)


@computed_once
def table(index: AbstractIndex) -> QuinticTable:
    """The flight of the planned bank over an index."""
    return cached(_tabulated)(longer(), index)


def _flown_by(law: AbstractLaw) -> Scenario:
    """The glide with another law, down to the velocity of the end."""
    return dataclasses.replace(glide(), guidance=law, step=STEP)


def _tracking(bank: AbstractLaw) -> Scenario:
    """The glide with a bank law and the scheduled angle of attack."""
    return _flown_by(compose(AngleOfAttackProfile(ScheduledAngleOfAttack()), bank))


def _scheduled_model() -> OnboardModel:
    """Onboard model of drag tracking: coefficients at the scheduled angle of attack."""
    known = vehicle()
    aerodynamics = ScheduledAerodynamics(known.aerodynamics, ScheduledAngleOfAttack())
    return OnboardModel(earth(), dataclasses.replace(known, aerodynamics=aerodynamics))


def drag_reference() -> DragReference:
    """The drag of the reference over the energy, as in the paper of the law."""
    return DragReference(
        EnergyIndex(), table(EnergyIndex()).profile("drag"), cos_bank()
    )


def state_drag_tracking() -> Scenario:
    """Yan and He's law (14), with the gains of their figures 1 to 5."""
    law = StateFeedbackDragTracking(
        nominal_gains(), drag_reference(), _scheduled_model()
    )
    return _tracking(law)


def observer_drag_tracking() -> Scenario:
    """Yan and He's law (24) with observer (25), with the gains of figures 6 to 10."""
    law = ObserverDragTracking(
        nominal_gains(),
        nominal_observer(),
        drag_reference(),
        _scheduled_model(),
    )
    return _tracking(law)


def glide_reference() -> Reference:
    """The reference over the velocity, with the columns that the laws of the RLV use."""
    return Reference(VelocityIndex(), table(VelocityIndex()))


def modulation() -> Scenario:
    """Zhang, Li and Zhang's law with its gains of the RLV, and the Shuttle's bank law.

    The attitude has no lag here, and there are no bank reversals.
    """
    onboard = OnboardModel(earth(), vehicle())
    law = DynamicalModulation(
        reference=glide_reference(),
        domain=VelocityDomain(onboard, scale_height=6600.0),
    )
    return _modulated(law)


def shuttle() -> Scenario:
    """The Shuttle's laws for angle of attack, with f = 1, and bank: the RLV's baseline."""
    onboard = OnboardModel(earth(), vehicle())
    return _modulated(Sampled(ShuttleModulation(glide_reference(), onboard), CYCLE))


def _modulated(angle_of_attack: AbstractLaw) -> Scenario:
    bank = Sampled(ShuttleBank(glide_reference()), CYCLE)
    limits = BankLimits(12.0 * degree, LARGEST_BANK)
    return _flown_by(compose(angle_of_attack, bank, limits))


def track_model() -> GroundTrackModel:
    """The model of the motion that feedback linearization differentiates."""
    controls, start = table(EnergyIndex()), reference().at(jnp.zeros(())).state
    first = energy(earth(), start.eastward())
    last = energy(earth(), reference().end.eastward())
    return GroundTrackModel(
        OnboardModel(earth(), vehicle()),
        controls.profile("angle_of_attack"),
        controls.profile("bank"),
        first - last,
    )


@computed_once
def ground_track() -> GroundTrackPlan:
    """The reference over the energy, extended at both ends."""
    energies = table(EnergyIndex())
    last = energies.start + _INTERVALS * energies.spacing
    return cached(plan_ground_track)(longer(), track_model(), last)


def feedback_linearization() -> Scenario:
    """Bharadwaj, Rao and Mease's law, with the eigenvalues and the band of the SX-2.

    In the vertical plane the crossrange has no error. The lateral lift remains that of the
    reference and turns nothing here. Angle of attack and bank control the downrange.
    """
    law = GroundTrackTracking(
        track_model(),
        ground_track().table,
        gains(),
        AttitudeBand(5.0 * degree, 5.0 * degree, 45.0 * degree, LARGEST_BANK),
    )
    return _flown_by(law)
