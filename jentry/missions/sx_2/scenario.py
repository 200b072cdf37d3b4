"""SX-2: ground-track tracking by feedback linearization with angle of attack and bank.

Source: S. Bharadwaj, A. V. Rao, K. D. Mease, "Entry Trajectory Tracking Law via Feedback
Linearization", Journal of Guidance, Control, and Dynamics 21(5), 1998. What the paper
leaves open is stated where it is chosen.
"""

import equinox as eqx
import jax.numpy as jnp

from ..._computed_once import computed_once
from ..._math import smoothstep
from ..._programs import cached
from ...fields import Scalar, scalar
from ...flight.scenario import Scenario, Target
from ...flight.termination import AltitudeAbove, AltitudeBelow, EnergyBelow, Termination
from ...guidance.feedback_linearization import (
    AbstractForceKnowledge,
    AbstractLinearization,
    AbstractTrackAngles,
    AttitudeBand,
    EarthFixedAngles,
    FullLinearization,
    GroundTrackModel,
    GroundTrackTracking,
    MeasuredForces,
    ModelledForces,
    SmallAngleLinearization,
)
from ...guidance.law import Sampled
from ...guidance.open_loop import ControlProfiles
from ...guidance.replanning import Adjustment, ReplannedTracking
from ...guidance.tracking_gains import ScheduledEigenvalues, TrackingGains
from ...motion.constraints import (
    Constraints,
    DynamicPressure,
    EquilibriumGlide,
    HeatRate,
    NormalLoadFactor,
    usual_constraints,
)
from ...motion.index import EnergyIndex
from ...motion.quantities import energy, ground_track
from ...motion.state import EntryState
from ...onboard.model import OnboardModel
from ...onboard.profiles import AbstractProfile
from ...onboard.spline import CubicSpline, cubic_spline
from ...planning.ground_track import GroundTrackPlan, plan_ground_track
from ...units import degree, foot, slug
from ...world.aerodynamics import PolynomialAerodynamics
from ...world.atmosphere import ExponentialAtmosphere
from ...world.gravity import InverseSquareGravity
from ...world.planet import Planet
from ...world.vehicle import Vehicle


END_ALTITUDE = 84_000 * foot
END_VELOCITY = 2647 * foot
"""Velocity at the end, m/s: Mach 2.70, where the paper begins terminal area energy
management"""

FIRST_SHARE = 1.02
"""Energy at which the reference begins, as a share of the energy span: it is above 1 for
perturbations that raise the energy"""

STEP = 1.0
"""Length of a step, s. With steps of 0.25 s the end of no flight of 512 moves by more than
0.2 m"""


def earth() -> Planet:
    """The Earth at rest, with the atmosphere of the paper.

    The paper prints lb/ft3 as the unit of the surface density; corrected to slug/ft3.
    Radius and gravity are those of WGS-84. The temperature affects only the Mach number,
    which is 2.70 at the end.
    """
    sound = END_VELOCITY / 2.70
    return Planet(
        radius=6_378_137.0,
        gravity=InverseSquareGravity(3.986004418e14),
        atmosphere=ExponentialAtmosphere(
            surface_density=2.3769e-3 * slug / foot**3,
            scale_height=23_443 * foot,
            isothermal_temperature=sound**2 / (1.4 * 287.05287),
        ),
    )


def vehicle() -> Vehicle:
    """The SX-2: 82 310 lb, 709.2 ft2; polynomials for angles of attack of 5 to 25 deg."""
    return Vehicle(
        mass=2558.277 * slug,
        reference_area=709.2 * foot**2,
        aerodynamics=PolynomialAerodynamics(
            jnp.array([-0.0448, 2.5457]), jnp.array([0.1971, -0.1427, 3.7677])
        ),
        trim_angle_of_attack=20.0 * degree,
    )


def start() -> EntryState:
    """The initial reference state; the paper prints ft/s2 as the unit of the speed."""
    return EntryState(
        altitude=200_000 * foot,
        longitude=0.0,
        latitude=0.0,
        velocity=17_000 * foot,
        flight_path_angle=0.0,
        heading=90.0 * degree,
    )


def energies() -> tuple[Scalar, Scalar]:
    """Energies at the start and at the end of the reference, J/kg."""
    end = eqx.tree_at(
        lambda s: (s.altitude, s.velocity), start(), (END_ALTITUDE, END_VELOCITY)
    )
    return energy(earth(), start()), energy(earth(), end)


class SmoothRise(AbstractProfile):
    """A rise from one value to another by the quintic smoothstep, with two continuous
    derivatives."""

    low: Scalar = scalar(unit="rad")
    high: Scalar = scalar(unit="rad")
    begin: Scalar = scalar(unit="J/kg")
    end: Scalar = scalar(unit="J/kg")

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        span, rise = self.end - self.begin, self.high - self.low
        x = jnp.clip((index - self.begin) / span, 0.0, 1.0)
        step = smoothstep(x)
        first = 30.0 * x**2 * (1.0 - x) ** 2
        second = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
        return self.low + rise * step, rise * first / span, rise * second / span**2


class ReversedBank(AbstractProfile):
    """A bank that is reversed once: a spline times a hyperbolic tangent."""

    size: CubicSpline
    """Bank (rad) over the energy (J/kg), positive to the right at high energy"""
    reversal: Scalar = scalar(unit="J/kg")
    width: Scalar = scalar(unit="J/kg", positive=True)

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        s, s1, s2 = self.size.with_derivatives(index)
        t = jnp.tanh((index - self.reversal) / self.width)
        t1 = (1.0 - t * t) / self.width
        t2 = -2.0 * t * t1 / self.width
        return s * t, s1 * t + s * t1, s2 * t + 2.0 * s1 * t1 + s * t2


_BANK_KNOTS = (0.0, 0.06, 0.15, 0.26, 0.38, 0.52, 0.66, 0.8, 0.92, 1.05)
_BANKS = (21.72, 35.79, 44.74, 44.47, 45.9, 43.82, 44.02, 41.38, 29.36, 24.93)
"""Magnitudes of the reference bank, deg. The paper shows its reference controls only in
figures. With these numbers the flight descends smoothly where a level start begins a
phugoid, and the bank is reversed at about 10 130 ft/s"""


def reference_controls() -> tuple[SmoothRise, ReversedBank]:
    """Reference angle of attack and bank over the energy.

    The bank of the paper is positive to the left; here it is positive to the right.
    """
    first, last = energies()
    span = first - last
    angle = SmoothRise(
        12.0 * degree, 20.0 * degree, last + 0.05 * span, last + 0.60 * span
    )
    knots = last + jnp.array(_BANK_KNOTS) * span
    size = cubic_spline(knots, -jnp.array(_BANKS) * degree)
    return angle, ReversedBank(size, last + 0.345 * span, 0.014 * span)


DOWNRANGE_EIGENVALUES = 18.0, 8.0, 8.0, 0.1
CROSSRANGE_EIGENVALUES = 30.0, 1.2, 1.2
"""Eigenvalues of (50) and (51), in units of one over the energy span"""


def gains() -> TrackingGains:
    """Gains that were found by search; the paper prints none."""
    return TrackingGains.from_eigenvalues(DOWNRANGE_EIGENVALUES, CROSSRANGE_EIGENVALUES)


def schedule() -> ScheduledEigenvalues:
    """The eigenvalues of `gains` at six energies, as initial values of tuning."""
    first, last = energies()
    return ScheduledEigenvalues(
        last + (first - last) * jnp.linspace(0.0, 1.0, 6),
        jnp.tile(jnp.array(DOWNRANGE_EIGENVALUES), (6, 1)),
        jnp.tile(jnp.array(CROSSRANGE_EIGENVALUES), (6, 1)),
    )


def band() -> AttitudeBand:
    """Bounds of (54): 5 degrees about the reference, 5 to 25 degrees, and 80 of bank."""
    return AttitudeBand(5.0 * degree, 5.0 * degree, 25.0 * degree, 80.0 * degree)


def track_model(angles: AbstractTrackAngles = EarthFixedAngles()) -> GroundTrackModel:
    """The model of the nominal motion that the law differentiates."""
    first, last = energies()
    return GroundTrackModel(
        OnboardModel(earth(), vehicle()), *reference_controls(), first - last, angles
    )


def constraints() -> Constraints:
    """The corridor of figure 6: heating, normal load, dynamic pressure, equilibrium glide.

    The paper prints no limits. These are chosen as for an airframe of this class: 60 W/cm2
    at a nose radius of 1 m, 2.5 g, 20 kPa. The flight begins above the equilibrium glide of
    zero bank, where 0.07 g are missing; the limit is 0.1 g.
    """
    return usual_constraints() | {
        "heat_rate": HeatRate(600e3),
        "normal_load_factor": NormalLoadFactor(2.5),
        "dynamic_pressure": DynamicPressure(20e3),
        "equilibrium_glide": EquilibriumGlide(limit=0.1),
    }


def entry() -> Scenario:
    """The flight under the reference controls, without feedback, to the final energy."""
    planet, (_, last) = earth(), energies()
    controls = ControlProfiles(EnergyIndex(), planet, *reference_controls())
    return Scenario(
        planet=planet,
        vehicle=vehicle(),
        initial_state=start(),
        guidance=controls,
        termination=Termination(
            {
                "energy": EnergyBelow(energy=last),
                "ground": AltitudeBelow(altitude=0.0),
                "skip_out": AltitudeAbove(altitude=400_000 * foot),
            },
            time_limit=3000.0,
        ),
        target=Target(0.0, 0.0, 0.0),
        constraints=constraints(),
        step=STEP,
    )


_plan = cached(plan_ground_track)


@computed_once
def _planned(
    linearization: AbstractLinearization, angles: AbstractTrackAngles
) -> GroundTrackPlan:
    first, last = energies()
    beyond = last + FIRST_SHARE * (first - last)
    return _plan(entry(), track_model(angles), last, beyond, linearization)


def tracking(
    linearization: AbstractLinearization = FullLinearization(),
    force_knowledge: AbstractForceKnowledge = ModelledForces(),
    angles: AbstractTrackAngles = EarthFixedAngles(),
    period: float | None = None,
) -> Scenario:
    """The entry with its law, which is continuous or has a guidance cycle (s).

    The target is where the reference ends.
    """
    nominal = entry()
    plan = _planned(linearization, angles)
    law = GroundTrackTracking(
        track_model(angles),
        plan.table,
        gains(),
        band(),
        linearization=linearization,
        force_knowledge=force_knowledge,
    )
    end = plan.end
    downrange, crossrange = ground_track(nominal.planet, start(), end)
    target = Target(
        end.altitude,
        end.velocity,
        downrange,
        crossrange,
        end.flight_path_angle,
        end.heading,
        origin=start(),
    )
    return eqx.tree_at(
        lambda s: (s.guidance, s.target),
        nominal,
        (law if period is None else Sampled(law, period), target),
    )


def full() -> Scenario:
    """The law of the paper's flights: without small angles, and continuous."""
    return tracking()


def scheduled() -> Scenario:
    """The law `full` with eigenvalues that vary with the energy, for `jentry tune`."""
    return eqx.tree_at(lambda s: s.guidance.gains, full(), schedule())


def small_angle() -> Scenario:
    """The law as printed, for small angles."""
    return tracking(SmallAngleLinearization())


def measured() -> Scenario:
    """The law `full` with measured lift and drag, in guidance cycles of 0.1 s."""
    return tracking(force_knowledge=MeasuredForces(), period=0.1)


def replanned() -> Scenario:
    """Reference planned again every 10 s, for the lift and drag measured at that time.

    The paper mentions re-planning and leaves it open. The limits ensure that the changed
    controls are always allowed: they leave 2 degrees of the angle of attack to the
    tracking, and the bank is below 80 degrees.
    """
    scenario = tracking()
    limits = Adjustment(3.0 * degree, 0.4, 15.0 * degree)
    tracked = scenario.guidance
    assert isinstance(tracked, GroundTrackTracking)
    law = ReplannedTracking(law=tracked, limits=limits, end=energies()[1])
    return eqx.tree_at(lambda s: s.guidance, scenario, law)
