"""CAV-H glider, Bézier inverse dynamics with a neural predictor of the final velocity.

Source: H. Zhou, T. Rahman, W. Chen, "Neural Network Assisted Inverse Dynamic Guidance for
Terminally Constrained Entry Flight", 2014. What the paper leaves open is stated where it
is chosen.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..._computed_once import computed_once
from ...flight.scenario import Scenario, Target
from ...flight.termination import AltitudeBelow, Outcome, TargetPassed, Termination
from ...guidance.bezier.allocation import FlightLimits
from ...guidance.bezier.anchoring import (
    AbstractAnchoring,
    StoredParameters,
    Subdivision,
)
from ...guidance.bezier.curve import BezierParameters
from ...guidance.bezier.law import Arrival, BezierGuidance
from ...guidance.bezier.prediction import AbstractVelocityPredictor, FlownModel
from ...guidance.bezier.velocity_control import (
    AbstractVelocityControl,
    Epochs,
    NewtonAdjustment,
    NoVelocityControl,
    PolynomialAdjustment,
)
from ...guidance.cycle import ShorteningCycle
from ...motion.constraints import (
    Constraints,
    DynamicPressure,
    HeatRate,
    LoadFactor,
    usual_constraints,
)
from ...motion.state import EntryState
from ...onboard.measurement import Accelerometers
from ...onboard.model import OnboardModel
from ...onboard.profile_estimation import FactorPrior, ProfileEstimator
from ...onboard.track import Track
from ...planning.bezier_curve import k2_polynomials
from ...units import degree, km, standard_gravity
from ...world.aerodynamics import ExponentialAerodynamics
from ...world.atmosphere import AbstractAtmosphere, ExponentialAtmosphere
from ...world.gravity import InverseSquareGravity
from ...world.perturbed_atmosphere import DensityWave, PerturbedAtmosphere
from ...world.planet import Planet
from ...world.us_standard_atmosphere import USStandardAtmosphere1976
from ...world.vehicle import Vehicle
from .dispersions import (
    AMPLITUDES,
    FACTOR_DEVIATION,
    RADIUS,
    TREND_ALTITUDES,
    TREND_DEVIATIONS,
    WAVELENGTHS,
)
from .stored_networks import network_predictor


TARGET_LATITUDE = 55.9067 * degree
"""Latitude of the target, rad, 6216.538 km due north: with the paper's k1 and k2 the
velocity there is its 2630 m/s"""

PIVOT = 37.5 * km
"""Altitude in the middle of the flight, m"""

LARGEST_BANK = 85.0 * degree
"""Largest bank to either side, assumed"""

FINAL_VELOCITY = 2630.0
"""Velocity at the target, m/s: Table 1"""


def earth() -> Planet:
    """The Earth at rest, as in the paper.

    The heat rate 1.0e-6 sqrt(density) velocity^3.5 W/m2 agrees with its figure, 1.5 MW/m2.
    """
    return Planet(
        radius=RADIUS,
        gravity=InverseSquareGravity(standard_gravity * RADIUS**2),
        atmosphere=ExponentialAtmosphere(surface_density=1.225, scale_height=7200.0),
        heating_coefficient=1.0e-6,
        heating_exponent=3.5,
    )


def disturbed(air: AbstractAtmosphere) -> PerturbedAtmosphere:
    """The actual atmosphere; it equals that of the onboard model until it is dispersed."""
    low, high = TREND_ALTITUDES
    waves = tuple(DensityWave(0.0, wavelength) for wavelength in WAVELENGTHS)
    return PerturbedAtmosphere(air, waves, low=low, high=high)


def glider() -> Vehicle:
    """The glider: 907 kg, 0.4839 m2, a published fit to the Common Aero Vehicle's tables.

    The tables begin at 10 degrees. Below, the drag is constant: otherwise the range becomes
    15 750 km, and the dispersions of Table 2 cannot be flown.
    """
    aerodynamics = ExponentialAerodynamics(
        lift_slope=2.9451,
        lift_tail=0.2949,
        lift_decay=3.3943e-4,
        lift_constant=-0.2355,
        drag_curvature=2.3795,
        drag_tail=0.3983,
        drag_decay=1.0794e-3,
        drag_constant=0.0234,
        least_angle_of_attack=10.0 * degree,
    )
    return Vehicle(
        907.0, 0.4839, aerodynamics=aerodynamics, trim_angle_of_attack=10.0 * degree
    )


def constraints() -> Constraints:
    """The path constraints (11) with the limits of Table 1, which the law respects."""
    return usual_constraints() | {
        "heat_rate": HeatRate(2e6),
        "dynamic_pressure": DynamicPressure(200e3),
        "load_factor": LoadFactor(2.0),
    }


def glide(
    parameters: BezierParameters,
    anchoring: AbstractAnchoring = StoredParameters(),
    velocity_control: AbstractVelocityControl = NoVelocityControl(),
    cycle: ShorteningCycle = ShorteningCycle(),
    acceleration_loop: bool = True,
) -> Scenario:
    """The scenario of Table 1, with a choice of parts of the law.

    An angle of attack from 0 to 20 degrees and a bank up to 85 degrees are assumed.
    """
    known, vehicle = earth(), glider()
    planet = eqx.tree_at(lambda p: p.atmosphere, known, disturbed(known.atmosphere))
    start = EntryState(
        altitude=50.0 * km,
        longitude=0.0,
        latitude=0.0,
        velocity=7500.0,
        flight_path_angle=-0.001 * degree,
        heading=0.0,
    )
    track = Track(start.longitude, start.latitude, 0.0, TARGET_LATITUDE)
    arrival = Arrival(25.0 * km, -0.6 * degree, 0.0)
    law = BezierGuidance(
        parameters=parameters,
        track=track,
        arrival=arrival,
        model=OnboardModel(known, vehicle),
        limits=FlightLimits(
            least_angle_of_attack=0.0,
            largest_angle_of_attack=20.0 * degree,
            largest_bank=LARGEST_BANK,
        ),
        anchoring=anchoring,
        velocity_control=velocity_control,
        cycle=cycle,
        acceleration_loop=acceleration_loop,
    )
    return Scenario(
        planet=planet,
        vehicle=vehicle,
        initial_state=start,
        guidance=law,
        termination=Termination(
            {
                "target": TargetPassed(track=track),
                "ground": AltitudeBelow(altitude=0.0, outcome=Outcome.CRASHED),
            },
            time_limit=2000.0,
        ),
        target=Target(
            altitude=arrival.altitude,
            velocity=FINAL_VELOCITY,
            downrange=RADIUS * TARGET_LATITUDE,
            flight_path_angle=arrival.flight_path_angle,
            heading=arrival.heading,
            origin=start,
        ),
        accelerometers=Accelerometers(),
        constraints=constraints(),
    )


def stored() -> Scenario:
    """The paper's law with its k1 and k2, without adjustment."""
    return glide(BezierParameters(k1=0.848, k2=0.717))


def model_inversion() -> Scenario:
    """The paper's law as printed, with the angle of attack from the onboard model only."""
    return glide(BezierParameters(k1=0.848, k2=0.717), acceleration_loop=False)


def adjusted(
    predictor: AbstractVelocityPredictor, epochs: Epochs = Epochs(every=None)
) -> Scenario:
    """The paper's law with equation (38)."""
    scenario = stored()
    table = k2_polynomials(scenario, predictor)
    control = PolynomialAdjustment(
        to_go=table.to_go,
        nominal_k2=0.717,
        nominal_velocity=table.nominal_velocity,
        polynomials=table.polynomials,
        predictor=predictor,
        epochs=epochs,
    )
    return eqx.tree_at(lambda s: s.guidance.velocity_control, scenario, control)


@computed_once
def adjusted_once() -> Scenario:
    """The law with (38) at the start, and a prediction with the onboard model."""
    return adjusted(FlownModel())


@computed_once
def adjusted_at_epochs() -> Scenario:
    """The law with (38) every 25th guidance cycle, by the polynomial of the range to go."""
    return adjusted(FlownModel(), Epochs(every=25))


@computed_once
def network_once() -> Scenario:
    """The law with (38) at the start, and a network with the estimated factors as input."""
    return adjusted(network_predictor("stored"))


@computed_once
def state_network_once() -> Scenario:
    """The law with (38) at the start, and the paper's network with only the state as input.

    Two vehicles with equal states and different factors end at velocities that differ by
    hundreds of m/s: such a network cannot distinguish them.
    """
    return adjusted(network_predictor("state-only"))


def subdivided(
    velocity_control: AbstractVelocityControl = NoVelocityControl(),
) -> Scenario:
    """A law beyond the paper: the curve is held, and its third control point is adjusted.

    k1 is that of the notes to the paper. k2 is the initial value of the first adjustment.
    """
    return glide(BezierParameters(k1=0.6, k2=0.7), Subdivision(), velocity_control)


def newton() -> Scenario:
    """The subdivided curve, adjusted every 25th cycle by Newton's method on the model."""
    return subdivided(NewtonAdjustment(FINAL_VELOCITY, FlownModel(16)))


def _learning(departure: FactorPrior, caution: float | None = None) -> Scenario:
    estimator = ProfileEstimator(departure, caution=caution)
    return eqx.tree_at(lambda s: s.guidance.estimator, newton(), estimator)


def _constant_and_slope() -> tuple[float, float]:
    """Standard deviations at `PIVOT` of trend and factor together, and of the slope."""
    low, high = TREND_ALTITUDES
    at_low, at_high = TREND_DEVIATIONS
    slope = (at_high - at_low) / (high - low)
    return math.hypot(at_low + slope * (PIVOT - low), FACTOR_DEVIATION), slope


def learning() -> Scenario:
    """The law `newton`, with factors over the altitude that are estimated in flight.

    The prior has the trend and the waves of `waves-sensed`, but not their phases.
    """
    constant, slope = _constant_and_slope()
    amplitudes = jnp.array(AMPLITUDES) / math.sqrt(2.0)
    return _learning(
        FactorPrior(jnp.array(WAVELENGTHS), amplitudes, constant, slope, PIVOT)
    )


def learning_correlated() -> Scenario:
    """The law `learning` with a prior that has only the correlation length of the waves.

    The length is 2.7 km: this correlation has the curvature at zero of that of the waves.
    The caution is chosen: near the target a vehicle can no longer correct a velocity that
    is too high, but it can correct one that is too low.
    """
    variances = 0.5 * np.array(AMPLITUDES) ** 2
    numbers = 2.0 * math.pi / np.array(WAVELENGTHS)
    variance = np.sum(variances)
    length = math.sqrt(variance / np.sum(variances * numbers**2))
    constant, slope = _constant_and_slope()
    departure = FactorPrior.correlated(
        length,
        math.sqrt(variance),
        PIVOT - 17.5 * km,
        PIVOT + 17.5 * km,
        constant=constant,
        slope=slope,
    )
    return _learning(departure, caution=0.5)


def newton_network() -> Scenario:
    """The subdivided curve, adjusted by Newton's method on the network."""
    return subdivided(
        NewtonAdjustment(FINAL_VELOCITY, network_predictor("subdivision"))
    )


def us_1976(scenario: Scenario) -> Scenario:
    """US Standard Atmosphere 1976, also in the onboard model."""
    air = USStandardAtmosphere1976()
    places = lambda s: (
        s.planet.atmosphere.undisturbed,
        s.guidance.model.planet.atmosphere,
    )
    return eqx.tree_at(places, scenario, (air, air))
