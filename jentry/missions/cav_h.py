"""CAV-H glider, Bézier inverse dynamics with a neural predictor of the final velocity.

Source: H. Zhou, T. Rahman, W. Chen, "Neural Network Assisted Inverse Dynamic Guidance for
Terminally Constrained Entry Flight", 2014. What the paper leaves open is stated where it
is chosen.
"""

import functools

from ..campaign.dispersions import Dispersion, Normal, Uniform, add
from ..flight.scenario import Scenario, Target
from ..flight.termination import AltitudeBelow, Outcome, TargetPassed, Termination
from ..guidance.anchoring import AbstractAnchoring, StoredParameters, Subdivision
from ..guidance.attitude import FlightLimits
from ..guidance.bezier import Arrival, BezierGuidance, CycleSchedule
from ..guidance.velocity_control import (
    AbstractVelocityControl,
    NewtonAdjustment,
    NoVelocityControl,
)
from ..motion.state import EntryState
from ..onboard.bezier import BezierParameters
from ..onboard.model import OnboardModel
from ..onboard.track import Track
from ..units import degree, km, standard_gravity
from ..world.aerodynamics import ExponentialAerodynamics
from ..world.atmosphere import ExponentialAtmosphere
from ..world.gravity import InverseSquareGravity
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from .mission import Mission


RADIUS = 6371.0 * km
TARGET_LATITUDE = 55.9067 * degree
"""6216.538 km due north: with the paper's k1 and k2 the velocity there is its 2630 m/s"""

FINAL_VELOCITY = 2630.0
"""m/s, Table 1"""


def earth() -> Planet:
    """At rest, as in the paper. The heat rate 1.0e-6 sqrt(density) velocity^3.5 W/m2 is
    what its figure of 1.5 MW/m2 amounts to.
    """
    return Planet(
        radius=RADIUS,
        gravity=InverseSquareGravity(standard_gravity * RADIUS**2),
        atmosphere=ExponentialAtmosphere(surface_density=1.225, scale_height=7200.0),
        heating_coefficient=1.0e-6,
        heating_exponent=3.5,
    )


def glider() -> Vehicle:
    """907 kg and 0.4839 m2; a published fit to the tables of the Common Aero Vehicle.

    Below 10 degrees, where the tables begin, the drag keeps its value: otherwise the
    range becomes 15 750 km, and the dispersions of Table 2 cannot be flown.
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


def glide(
    parameters: BezierParameters,
    anchoring: AbstractAnchoring = StoredParameters(),
    velocity_control: AbstractVelocityControl = NoVelocityControl(),
    schedule: CycleSchedule = CycleSchedule(),
    acceleration_loop: bool = True,
) -> Scenario:
    """Table 1. Angle of attack from 0 to 20 degrees and bank to 85 are assumed."""
    planet, vehicle = earth(), glider()
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
        model=OnboardModel(planet, vehicle),
        limits=FlightLimits(
            least_angle_of_attack=0.0,
            largest_angle_of_attack=20.0 * degree,
            largest_bank=85.0 * degree,
            load_factor=2.0,
            dynamic_pressure=200e3,
            heat_rate=2e6,
        ),
        anchoring=anchoring,
        velocity_control=velocity_control,
        schedule=schedule,
        acceleration_loop=acceleration_loop,
    )
    return Scenario(
        planet=planet,
        vehicle=vehicle,
        initial_state=start,
        guidance=law,
        termination=Termination(
            {
                "target": TargetPassed(track, planet.radius),
                "ground": AltitudeBelow(0.0, Outcome.CRASHED),
            },
            time_limit=2000.0,
        ),
        target=Target(
            altitude=arrival.altitude,
            velocity=FINAL_VELOCITY,
            downrange=RADIUS * TARGET_LATITUDE,
            flight_path_angle=arrival.flight_path_angle,
            heading=arrival.heading,
        ),
    )


def stored() -> Scenario:
    """The paper's law with its k1 and k2, and no adjustment."""
    return glide(BezierParameters(k1=0.848, k2=0.717))


def newton() -> Scenario:
    return glide(
        BezierParameters(k1=0.6, k2=0.7),
        Subdivision(),
        NewtonAdjustment(FINAL_VELOCITY),
    )


@functools.cache
def _initial_state() -> dict[str, Dispersion]:
    """Table 2, three sigma as printed."""

    def moved(where, three_sigma):
        return Dispersion(where, Normal(0.0, three_sigma / 3.0), apply=add)

    return {
        "range": moved(lambda s: s.initial_state.latitude, 1.5 * km / RADIUS),
        "cross range": moved(lambda s: s.initial_state.longitude, 1.5 * km / RADIUS),
        "altitude": moved(lambda s: s.initial_state.altitude, 1.5 * km),
        "velocity": moved(lambda s: s.initial_state.velocity, 75.0),
        "flight-path angle": moved(
            lambda s: s.initial_state.flight_path_angle, 0.06 * degree
        ),
        "azimuth": moved(lambda s: s.initial_state.heading, 0.06 * degree),
    }


def _factors(distribution) -> dict[str, Dispersion]:
    return {
        "density": Dispersion(lambda s: s.planet.density_scale, distribution),
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, distribution),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, distribution),
    }


@functools.cache
def normal() -> dict[str, Dispersion]:
    """Table 2 with the factors normal, 10 % at three sigma."""
    return _initial_state() | _factors(Normal(1.0, 0.1 / 3.0))


@functools.cache
def uniform() -> dict[str, Dispersion]:
    """Table 2 with the factors uniform within 10 %."""
    return _initial_state() | _factors(Uniform(0.9, 1.1))


MISSION = Mission(
    name="cav-h",
    title="CAV-H glider, Bézier inverse dynamics with a neural predictor",
    source='Zhou, Rahman and Chen, "Neural Network Assisted Inverse Dynamic Guidance '
    'for Terminally Constrained Entry Flight"',
    variants={"stored": stored, "newton": newton},
    dispersions={"normal": normal, "uniform": uniform},
    gains=("guidance.parameters",),
)
