"""RLV: the glide, the lag of the attitude, and laws that modulate the angle of attack.

Source: R. Zhang, H. Li, R. Zhang, "Angle-of-Attack Modulation in Trajectory Tracking for a
Reusable Launch Vehicle". What the paper leaves open is stated where it is chosen.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp

from ..._computed_once import computed_once
from ..._programs import cached
from ...flight.scenario import Scenario, Target
from ...flight.termination import AltitudeBelow, Termination, VelocityBelow
from ...guidance.angle_of_attack_modulation import (
    AttitudeLag,
    DynamicalModulation,
    ModulationGains,
)
from ...guidance.composition import (
    BankLimits,
    ContinuousComposition,
    SampledComposition,
    compose,
)
from ...guidance.cycle import FixedCycle
from ...guidance.lateral import VelocityReversals
from ...guidance.law import AbstractLaw, Sampled
from ...guidance.shuttle import Gate, ShuttleBank, ShuttleModulation
from ...motion.attitude import Response, SecondOrderAttitude
from ...motion.constraints import usual_constraints
from ...motion.state import EntryState
from ...onboard.measurement import Accelerometers
from ...onboard.model import OnboardModel
from ...onboard.reference import Reference
from ...onboard.velocity_domain import VelocityDomain
from ...planning.glide import plan_glide
from ...units import degree, foot, km, standard_gravity
from ...world.gravity import InverseSquareGravity
from ...world.perturbed_atmosphere import (
    DensityWave,
    GroundWave,
    PerturbedAtmosphere,
)
from ...world.planet import Planet
from ...world.smoothed_atmosphere import SmoothedAtmosphere, smoothed
from ...world.us_standard_atmosphere import USStandardAtmosphere1976
from .airframe import ScheduledAngleOfAttack, vehicle
from .deviations import AngleOfAttackDeviation, DragDeviation


END_VELOCITY = 1600.0
"""Velocity at the end, m/s"""
CYCLE = 0.1
"""Guidance cycle, s"""
STEP = 0.05
"""Length of a step, s"""
JUDGED_BELOW = 7000.0
"""Velocity below which the drag error counts, m/s"""
REVERSALS = 7000.0, 6000.0, 5000.0, 4000.0, 3000.0, 2000.0
"""Velocities of the bank reversals, m/s"""
LARGEST_BANK = 80.0 * degree
BANK_INCREMENT = 12.0 * degree
TURN_RATE, TURN_ACCELERATION = 5.0 * degree, 1.7 * degree
"""Limits of the paper for angle of attack and bank, rad/s and rad/s2"""

LAG_DAMPING = 0.9
"""Damping ratio of the angle of attack"""

_RADIUS = 6371.0 * km


@computed_once
def air() -> SmoothedAtmosphere:
    """The US Standard Atmosphere 1976, smoothed over 1.5 km."""
    return cached(smoothed)(USStandardAtmosphere1976())


def earth() -> Planet:
    """The Earth at rest, as in the onboard model."""
    return Planet(
        radius=_RADIUS,
        gravity=InverseSquareGravity(standard_gravity * _RADIUS**2),
        atmosphere=air(),
    )


def actual_earth() -> Planet:
    """The Earth of the scenario, with density perturbations that are nominally zero.

    The trend at 3 sigma is 10 % at 30 km, 25 % at 80 km and at most 35 % above. The waves
    have lengths of 25 and 8 km over the altitude, and of 800 km along the track.
    """
    known = earth()
    return eqx.tree_at(
        lambda p: p.atmosphere,
        known,
        PerturbedAtmosphere(
            air(),
            (DensityWave(0.0, 25.0 * km), DensityWave(0.0, 8.0 * km)),
            low=30.0 * km,
            high=30.0 * km + 50.0 * km * (0.35 - 0.10) / 0.15,
            share_low=0.10,
            share_high=0.35,
            ground_waves=(GroundWave(0.0, 800.0 * km, _RADIUS),),
        ),
    )


@computed_once
def plan() -> Reference:
    """The planned reference: constant heating, then a glide near equilibrium."""
    return cached(plan_glide)(earth(), vehicle(), ScheduledAngleOfAttack())


def attitude(frequency: float) -> SecondOrderAttitude:
    """Attitude (46) with the limits of the paper, at rest at 40 and 30 degrees.

    The bandwidth of the angle of attack, rad/s, is not printed and determines the results.
    """
    rate, acceleration = TURN_RATE, TURN_ACCELERATION
    return SecondOrderAttitude(
        angle_of_attack_response=Response(
            frequency, LAG_DAMPING, rate, acceleration, 0.0, 60.0 * degree
        ),
        bank_response=Response(
            0.6, 1.0, rate, acceleration, -LARGEST_BANK, LARGEST_BANK
        ),
        first_angle_of_attack=40.0 * degree,
        first_bank_angle=30.0 * degree,
    )


def model() -> OnboardModel:
    return OnboardModel(earth(), vehicle())


def gate() -> Gate:
    """The gate of the bank law, of both angle-of-attack laws and of their measures."""
    return Gate()


def shuttle_bank(period: float = CYCLE) -> Sampled:
    """The bank law of both angle-of-attack laws, with six bank reversals."""
    lateral = VelocityReversals(jnp.array(REVERSALS))
    return Sampled(ShuttleBank(plan(), gate=gate(), lateral=lateral), period)


def limits(increment: float = BANK_INCREMENT) -> BankLimits:
    """Limits of the bank increment (rad) that an angle-of-attack law may request."""
    return BankLimits(increment, LARGEST_BANK)


def start() -> EntryState:
    """The initial state of the flight."""
    return EntryState(
        altitude=120.0 * km,
        longitude=0.0,
        latitude=0.0,
        velocity=7700.0,
        flight_path_angle=-1.0 * degree,
        heading=90.0 * degree,
    )


def entry(law: AbstractLaw, frequency: float) -> Scenario:
    """The entry from 120 km to 1600 m/s, with an attitude of a bandwidth (rad/s).

    The target has the altitude of the plan at the end. It has no place, since the paper has
    none. So the downrange error is the range from the entry.
    """
    reference = plan().over_index(jnp.asarray(END_VELOCITY))
    end = {name: values[0] for name, values in reference.items()}
    return Scenario(
        planet=actual_earth(),
        vehicle=vehicle(),
        initial_state=start(),
        guidance=law,
        termination=Termination(
            {
                "velocity": VelocityBelow(velocity=END_VELOCITY),
                "ground": AltitudeBelow(altitude=0.0),
            },
            time_limit=4000.0,
        ),
        target=Target(end["altitude"], END_VELOCITY, 0.0),
        angle_of_attack_error=0.0,
        attitude=attitude(frequency),
        constraints={
            **usual_constraints(),
            "drag_deviation": DragDeviation(reference=plan(), below=JUDGED_BELOW),
            "angle_of_attack_deviation": AngleOfAttackDeviation(
                reference=plan(), below=gate().velocity
            ),
        },
        step=STEP,
    )


def modulated(
    frequency: float,
    gains: ModulationGains,
    lag: AttitudeLag | None = None,
    period: float = CYCLE,
    increment: float = BANK_INCREMENT,
) -> Scenario:
    """The paper's law, with an attitude of a bandwidth (rad/s)."""
    law = DynamicalModulation(
        reference=plan(),
        domain=VelocityDomain(model()),
        gains=gains,
        lag=lag,
        gate=gate(),
        cycle=FixedCycle(period),
    )
    bank = shuttle_bank(period)
    return entry(compose(law, bank, limits(increment)), frequency)


def modulation() -> Scenario:
    """The paper's law, with gains for an attitude bandwidth of 5 rad/s."""
    return modulated(5.0, ModulationGains())


def modulation_fast_observer() -> Scenario:
    """The paper's law with a faster observer, for an attitude bandwidth of 8 rad/s."""
    return modulated(5.0, ModulationGains(observer_pole=1500.0))


def shuttle(divisor: float = 1.0) -> Scenario:
    """The Shuttle's law with f = 1.

    The largest drag error of the nominal flight is 8.46e-3 g. With explicit steps of 0.05 s
    for the attitude it would be 7.96e-3 g: the gain of the law is high, so a lag of a part
    of a step has an effect (`tests/test_rlv.py`).
    """
    law = ShuttleModulation(plan(), model(), divisor, gate=gate())
    return entry(compose(Sampled(law, CYCLE), shuttle_bank(), limits()), 5.0)


def shuttle_quarter() -> Scenario:
    """The Shuttle's law with f = 0.25: by far the better baseline."""
    return shuttle(divisor=0.25)


def shuttle_as_flown() -> Scenario:
    """The Shuttle's law in its own cycle, with its dead band and its limit.

    The angle of attack is held within a drag error of 0.15 ft/s2, and a decision changes it
    by at most 2 degrees. If 2 degrees limited the deviation from the reference instead, the
    drag error after a bank reversal would be a third of g.
    """
    period = 1.92
    law = ShuttleModulation(
        plan(), model(), dead_band=0.15 * foot, limit=2.0 * degree, gate=gate()
    )
    return entry(compose(Sampled(law, period), shuttle_bank(period), limits()), 5.0)


def lag_inverted() -> Scenario:
    """The paper's law with the lag of the attitude inverted, in cycles of 0.2 s.

    Frequency and pole are scheduled with one over the drag: they are 0.5 and 1.1 rad/s at
    all times. These are initial values of tuning for an attitude of 3 rad/s:
    `benchmarks/tuned-rlv.toml` has the tuned gains.
    """
    gains = ModulationGains(
        frequency=1200.0,
        damping=1.0,
        observer_pole=3000.0,
        bank_deviation=4.0,
        bank_rate=-0.15,
        scheduled_at=3.0,
    )
    return modulated(5.0, gains, AttitudeLag(5.0, LAG_DAMPING), 0.2)


def lag_inverted_fast() -> Scenario:
    """The law `lag-inverted` in cycles of 0.05 s, with gains for sensor noise.

    Frequency and pole are 1.0 and 4.0 rad/s at all times, chosen in the linear model of
    `benchmarks/drag_noise.py`. The bank feedback is about that tuned for `lag-inverted`.
    """
    gains = ModulationGains(
        frequency=2600.0,
        damping=0.75,
        observer_pole=10500.0,
        bank_deviation=7.3,
        bank_rate=-0.026,
        scheduled_at=3.0,
    )
    lag = AttitudeLag(5.0, LAG_DAMPING)
    return modulated(5.0, gains, lag, 0.05, 20.5 * degree)


def attitude_3(scenario: Scenario) -> Scenario:
    """An attitude bandwidth of 3 rad/s in angle of attack: the hard case."""
    return _with_attitude(scenario, 3.0)


def attitude_8(scenario: Scenario) -> Scenario:
    """An attitude bandwidth of 8 rad/s in angle of attack."""
    return _with_attitude(scenario, 8.0)


def _with_attitude(scenario: Scenario, frequency: float) -> Scenario:
    """The scenario with a bandwidth (rad/s), also in a law that inverts the lag."""
    slower = dataclasses.replace(scenario, attitude=attitude(frequency))
    law = scenario.guidance
    angle = (
        law.angle_of_attack
        if isinstance(law, ContinuousComposition | SampledComposition)
        else None
    )
    if not isinstance(angle, DynamicalModulation) or angle.lag is None:
        return slower
    lag = AttitudeLag(frequency, LAG_DAMPING)
    law = dataclasses.replace(law, angle_of_attack=dataclasses.replace(angle, lag=lag))
    return dataclasses.replace(slower, guidance=law)


def noise(scenario: Scenario) -> Scenario:
    """Noise of the sensed drag and lift of 2e-4 g in each sample."""
    sensed = Accelerometers(noise=2e-4 * standard_gravity)
    return dataclasses.replace(scenario, accelerometers=sensed)
