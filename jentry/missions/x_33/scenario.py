"""X-33: the planned drag, the flight with this drag, and laws that track this flight.

Source: D.-W. Lee, K.-R. Cho, H. Yan, "Re-Entry Trajectory Tracking Via an Inverse Dynamics
Method". What the paper leaves open is stated where it is chosen.
"""

import dataclasses

import jax.numpy as jnp

from ..._computed_once import computed_once
from ..._programs import cached
from ...flight.scenario import Scenario, Target
from ...flight.termination import (
    AbstractEndCondition,
    AltitudeBelow,
    Outcome,
    Termination,
    VelocityBelow,
)
from ...guidance.aim import TargetOfScenario
from ...guidance.angle_of_attack import AngleOfAttackProfile
from ...guidance.composition import compose
from ...guidance.law import AbstractLaw
from ...guidance.open_loop import BankProfile, ControlProfiles
from ...guidance.pseudospectral_tracking import (
    DeviationWeights,
    PseudospectralTracking,
    Regulator,
    StoredGainTracking,
    plan_gains,
)
from ...motion.constraints import (
    Constraints,
    DynamicPressure,
    EquilibriumGlide,
    HeatRate,
    NormalLoadFactor,
)
from ...motion.dynamics import EquatorialDynamics
from ...motion.index import EnergyIndex
from ...motion.state import EntryState
from ...onboard.longitudinal import (
    LongitudinalModel,
    LongitudinalReference,
    LongitudinalState,
)
from ...onboard.model import OnboardModel
from ...onboard.profiles import JoinedProfile, PolynomialProfile
from ...planning.drag_profile import DragPlan, plan_drag_profile
from ...planning.inverse_dynamics import (
    AbstractInverse,
    ExactInverse,
    SmallAngleInverse,
)
from ...planning.longitudinal_flight import fly_longitudinal, plan_bank_over_velocity
from ...units import degree, km, standard_gravity
from ...world.atmosphere import ExponentialAtmosphere
from ...world.gravity import InverseSquareGravity
from ...world.planet import Planet
from .airframe import ScheduledAngleOfAttack, vehicle


FIRST_VELOCITY, LAST_VELOCITY = 7450.0, 760.0
"""Velocities at the start and at the end, m/s"""
FIRST_DRAG, LAST_DRAG = 4.0487, 5.4482
"""Drag at the start and at the end, m/s2; not printed. With these numbers the flight begins
at a flight-path angle of -0.5 degrees and ends at 22.165 km"""
RANGE = 3000.0 * km
SURFACE_GRAVITY = 9.81
"""Gravity at the surface, m/s2; not printed"""
RADIUS = 6378.0 * km
"""Radius of the Earth; not printed"""
STEP = 0.1
"""Length of a step, s"""
GLIDE_BANK = 60.0 * degree
"""Bank of the initial flight of planning for the longest and the shortest range"""
GLIDE_STEP = 1.0
"""Length of a step without a feedback law, s"""

_HEATING = 1.7415e-4
"""Coefficient of the heat rate, W s3/(kg1/2 m7/2): Sutton and Graves, for a nose radius of
1 m; the paper states none"""


def earth() -> Planet:
    """The Earth at rest with an exponential atmosphere; the paper prints no numbers."""
    return Planet(
        radius=RADIUS,
        gravity=InverseSquareGravity(SURFACE_GRAVITY * RADIUS**2),
        atmosphere=ExponentialAtmosphere(1.225, 6600.0),
        heating_coefficient=_HEATING,
    )


def corridor() -> Constraints:
    """The limits (6) to (9); the load factor is in units of 9.81 m/s2.

    Equation (6) limits the square root of the density times the cube of the velocity. Here
    the heat rate is limited, which is that product times a coefficient.
    """
    return {
        "heat_rate": HeatRate(3.305e9 * _HEATING),
        "normal_load_factor": NormalLoadFactor(
            2.0 * SURFACE_GRAVITY / standard_gravity
        ),
        "dynamic_pressure": DynamicPressure(16_280.0),
        "equilibrium_glide": EquilibriumGlide(limit=0.0),
    }


@computed_once
def plan(first_drag: float = FIRST_DRAG) -> DragPlan:
    """The smoothest drag in the corridor, from a drag at the entry (m/s2).

    From 1 m/s2 the load limit is active at some nodes. At high altitude that profile is at
    the limit of the equilibrium glide too, and needs more lift between the nodes than there
    is: it is a plan that cannot be flown.
    """
    return plan_drag_profile(
        earth(),
        vehicle(),
        ScheduledAngleOfAttack(),
        corridor(),
        (FIRST_VELOCITY, first_drag),
        (LAST_VELOCITY, LAST_DRAG),
        RANGE,
    )


def model() -> LongitudinalModel:
    """The onboard model of the motion in the vertical plane."""
    return LongitudinalModel(OnboardModel(earth(), vehicle()), ScheduledAngleOfAttack())


def inverse(exact: bool) -> AbstractInverse:
    """The inverse of the dynamics for the planned drag, exact or that of the paper."""
    kind = ExactInverse if exact else SmallAngleInverse
    return kind(earth(), vehicle(), ScheduledAngleOfAttack(), plan().drag)


@computed_once
def cos_bank(exact: bool = False) -> JoinedProfile:
    """Cosine of the planned bank over the velocity.

    It jumps where the angle of attack begins to fall.
    """
    jump = float(ScheduledAngleOfAttack().top)
    ends = jnp.array([LAST_VELOCITY, jump, FIRST_VELOCITY])
    return plan_bank_over_velocity(inverse(exact), ends)


@computed_once
def reference(exact: bool = False) -> LongitudinalReference:
    """The flight under the planned bank, from the start of the drag profile."""
    first = inverse(exact).at(jnp.asarray(FIRST_VELOCITY))
    start = LongitudinalState(first.altitude, FIRST_VELOCITY, first.flight_path_angle)
    return fly_longitudinal(model(), cos_bank(exact), start, LAST_VELOCITY)


def regulator(of: LongitudinalReference, with_range: bool = False) -> Regulator:
    """The regulator, with Q and R of ones and P_f of 300, which the paper does not print.

    With the range as a fourth state P_f is 30 000: with 300 the range error is up to 6 km,
    which is little relative to the radius of the planet.
    """
    if not with_range:
        return Regulator(model(), of)
    underway, at_end = DeviationWeights(downrange=1.0), DeviationWeights(*4 * [3e4])
    return Regulator(model(), of, underway, at_end, aim=TargetOfScenario())


def start(of: LongitudinalReference) -> EntryState:
    """Initial state at the first point of a reference, on the equator and heading east."""
    return of.at(of.ends[0]).state.eastward()


def entry(law: AbstractLaw, of: LongitudinalReference) -> Scenario:
    """The flight of a bank law for the duration of a reference.

    Its target is the end of the reference, at the time of that end.
    """
    end = of.end
    return Scenario(
        planet=earth(),
        vehicle=vehicle(),
        initial_state=start(of),
        guidance=compose(AngleOfAttackProfile(ScheduledAngleOfAttack()), law),
        termination=Termination(
            {"ground": AltitudeBelow(altitude=0.0, outcome=Outcome.CRASHED)},
            time_limit=float(of.ends[-1]),
            at_time_limit=Outcome.REACHED,
        ),
        target=Target(
            end.altitude,
            end.velocity,
            end.downrange,
            flight_path_angle=end.flight_path_angle,
            origin=start(of),
        ),
        dynamics=EquatorialDynamics(),
        constraints=corridor(),
        step=STEP,
    )


def tracked(regulated: Regulator) -> Scenario:
    """The flight of a regulator with stored gains."""
    law = StoredGainTracking(regulated, cached(plan_gains)(regulated))
    return entry(law, regulated.reference)


def tracking() -> Scenario:
    """The paper's regulator about the flight of the paper's inverse, with stored gains."""
    return tracked(regulator(reference()))


def with_range() -> Scenario:
    """The paper's regulator with the downrange as a fourth state."""
    return tracked(regulator(reference(), with_range=True))


def receding() -> Scenario:
    """The paper's regulator, solved again every 10 s for the remaining horizon."""
    return entry(PseudospectralTracking(regulator=regulator(reference())), reference())


def receding_with_range() -> Scenario:
    """The law `receding` with the downrange as a fourth state."""
    regulated = regulator(reference(), with_range=True)
    return entry(PseudospectralTracking(regulator=regulated), reference())


def open_loop() -> Scenario:
    """The planned bank over the velocity, without feedback."""
    return entry(BankProfile(cos_bank()), reference())


def glide() -> Scenario:
    """A constant bank down to the velocity of the end: the initial flight of planning.

    It starts like the reference, and has its angle of attack over the velocity.
    """
    of = reference()
    bank = ControlProfiles(
        EnergyIndex(), earth(), None, PolynomialProfile(jnp.array([GLIDE_BANK]))
    )
    ends: dict[str, AbstractEndCondition] = {
        "velocity": VelocityBelow(velocity=LAST_VELOCITY),
        "ground": AltitudeBelow(altitude=0.0, outcome=Outcome.CRASHED),
    }
    termination = Termination(ends, time_limit=3.0 * float(of.ends[-1]))
    flown = entry(bank, of)
    return dataclasses.replace(flown, termination=termination, step=GLIDE_STEP)


def exact_inverse() -> Scenario:
    """The paper's regulator about the flight of the exact inverse, with stored gains."""
    return tracked(regulator(reference(exact=True)))
