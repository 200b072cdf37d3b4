"""Inertial navigation of the missions: worlds `inertial` and `aided`, and dispersions."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any, NamedTuple

from .._computed_once import computed_once
from ..campaign.dispersions import Dispersion
from ..campaign.distributions import Normal, Uniform
from ..flight.closed_loop import guidance_period
from ..flight.scenario import Scenario
from ..onboard.inertial import Gyroscopes, KnowledgeError
from ..onboard.measurement import BodyAccelerometers, PerfectAccelerometers
from ..onboard.model import OnboardModel
from ..onboard.navigation import InertialNavigation, InertialNoise, PerfectNavigation
from ..onboard.navigation_filter import NavigationFilter
from ..onboard.navigation_sensors import (
    AbstractNavigationSensor,
    Altimeter,
    DragAltitude,
    TerrainPosition,
)
from ..units import degree, foot, hour, micro_g, nautical_mile


SHUTTLE_TILT = 0.26 * degree / 3.0
"""Standard deviation of the attitude of the Space Shuttle at its entry, rad:
"accurate to within 0.26 degree at the 400,000 foot altitude entry interface"
(abstract of "Shuttle Orbiter Stellar-Inertial Reference System"). We read it as
three sigma about each axis"""


class Errors(NamedTuple):
    """Standard deviations of the errors of an inertial navigation, the same for each axis.

    Those of the instruments are by default of the Honeywell HG9900, a ring-laser unit:
    brochure N61-1638-000-000, one sigma, as the documentation of NavToolkit
    (`hg9900_model`) repeats it. It has no misalignment and no random walk of the velocity;
    these are chosen.
    """

    position: float
    """Knowledge of the position at the start, m"""
    velocity: float
    """Knowledge of the velocity at the start, in m and s"""
    tilt: float
    """Knowledge of the attitude at the start, rad"""
    bias: float = 25.0 * micro_g
    """Bias of the accelerometers, in m and s"""
    scale_error: float = 100e-6
    """Scale error of the accelerometers, as a share of the force"""
    misalignment: float = 5e-5
    """Misalignment of the accelerometers, rad; chosen"""
    drift: float = 0.0035 * degree / hour
    """Drift of the gyroscopes, in rad and s"""
    velocity_random_walk: float = 1e-4
    """Random walk of the velocity, m and s; chosen"""
    angle_random_walk: float = 0.002 * degree / math.sqrt(hour)
    """Random walk of the attitude, in rad and s"""

    def filter(
        self, cycle: float, sensors: Mapping[str, AbstractNavigationSensor]
    ) -> NavigationFilter:
        """A filter that assumes these standard deviations, with a cycle, s."""
        start = self.position, self.velocity, self.tilt
        return NavigationFilter(
            KnowledgeError(*(size for size in start for _ in _LOCAL)),
            sensors,
            BodyAccelerometers(
                *(self.bias for _ in _BODY),
                *(self.scale_error for _ in _SCALED),
                *(self.misalignment for _ in _TURNS),
            ),
            Gyroscopes(*(self.drift for _ in _TURNS)),
            self.velocity_random_walk,
            self.angle_random_walk,
            cycle=cycle,
        )


Sensors = dict[str, AbstractNavigationSensor]


def near(cycle: float, seconds: float) -> float:
    """The multiple of a cycle (s) that is nearest to a time, s; at least the cycle."""
    return cycle * max(1, round(seconds / cycle))


def doubt(dispersions: Mapping[str, Dispersion], *names: str) -> float:
    """Standard deviation of the product of dispersed factors, as a share of it."""
    moments = (dispersions[name].distribution.moments() for name in names)
    return math.hypot(*(float(size) / float(mean) for mean, size in moments))


def drag_altitude(
    model: OnboardModel, doubt: float, lasting: float, cycle: float
) -> DragAltitude:
    """Altitude from drag, about every 10 s while the drag exceeds 1 m/s2; both chosen.

    The dispersions change the density by one factor in the whole flight: many measurements
    know the altitude no better than one. The filter takes them to be independent, so it
    assumes the deviation of one times the square root of their number. Accelerometers have
    their own errors, so the sensor has no noise.

    **Arguments:**

    - `model`: planet and vehicle as known on board.
    - `doubt`: standard deviation of density, drag coefficient and mass together, as a share
      of the drag.
    - `lasting`: usual time of a flight, s.
    - `cycle`: that of the filter, s.
    """
    every = near(cycle, 10.0)
    assumed = doubt * math.sqrt(max(1.0, lasting / every))
    return DragAltitude(model, 0.0, 1.0, assumed=assumed, cycle=every)


def shuttle_sensors(
    model: OnboardModel, doubt: float, lasting: float, cycle: float
) -> Sensors:
    """Sensors of the Space Shuttle, with the arguments of `drag_altitude`.

    Altitude from drag in the radio blackout (NASA CR-141765, 1974), and the position by the
    radio beacons TACAN "from altitudes of about 150,000 feet" (abstract of "Data management
    of Shuttle radiofrequency navigation aids", 1982). Their noise is chosen: half a
    nautical mile at three sigma along each axis over the ground, each second. The Shuttle
    measured distance and bearing instead.
    """
    return {
        "drag": drag_altitude(model, doubt, lasting, cycle),
        "tacan": TerrainPosition(
            0.5 * nautical_mile / 3.0, 150_000 * foot, cycle=near(cycle, 1.0)
        ),
    }


def satellite_sensors(cycle: float) -> Sensors:
    """A receiver of navigation satellites below 40 km: position and altitude.

    Orion has such a receiver at its entry (A. Barth and others, "Post-Flight Analysis of
    the Guidance, Navigation and Control Performance During Orion Exploration Flight Test
    1", AAS 15-134, 2015). Its noise of 10 m along each axis, and the altitude below which
    the radio blackout is over, are chosen.
    """
    below, every = 40e3, near(cycle, 1.0)
    return {
        "satellites": TerrainPosition(10.0, below, cycle=every),
        "satellite_altitude": Altimeter(10.0, below, cycle=every),
    }


_LOCAL = "east", "north", "up"
_BODY = "forward", "right", "down"
_SCALED = "forward", "down"
_TURNS = "roll", "pitch", "yaw"


@dataclasses.dataclass(frozen=True)
class Inertial:
    """The inertial navigation of a mission: two worlds, and dispersions of its errors."""

    errors: Errors
    decided: tuple[str, ...]
    """Names of the end conditions that the vehicle decides by what it believes"""
    usual: Callable[[], Mapping[str, Dispersion]]
    """Function that returns the usual dispersions of the mission"""
    sensors: Callable[[float], Sensors]
    """Function that returns the sensors of the world `aided` by name, for the cycle of the
    filter, s"""

    def world(self, scenario: Scenario) -> Scenario:
        """Inertial navigation in place of a perfect one; its errors are in `knowledge`.

        The law and the navigation read the same accelerometers. The random walks are added
        at each guidance cycle, or each second for a continuous law. Raises `ValueError`
        for a scenario with other accelerometers.
        """
        if not isinstance(scenario.accelerometers, PerfectAccelerometers):
            raise ValueError(
                f"accelerometers are {type(scenario.accelerometers).__name__}, and "
                "inertial navigation has others, which the law reads as well: leave out "
                "the world that brings them"
            )
        noise = InertialNoise(
            self.errors.velocity_random_walk,
            self.errors.angle_random_walk,
            cycle=guidance_period(scenario) or 1.0,
        )
        conditions = {
            name: dataclasses.replace(condition, by="navigation")
            if name in self.decided
            else condition
            for name, condition in scenario.termination.conditions.items()
        }
        return dataclasses.replace(
            scenario,
            accelerometers=BodyAccelerometers(),
            navigation=InertialNavigation(noise=noise),
            termination=dataclasses.replace(
                scenario.termination, conditions=conditions
            ),
        )

    def aided(self, scenario: Scenario) -> Scenario:
        """The world `inertial`, whose navigation a filter corrects by the sensors.

        The filter assumes the standard deviations of `errors`, by which `knowledge`
        disperses. Raises `ValueError` like `world`.
        """
        scenario = self.world(scenario)
        navigation = scenario.navigation
        assert isinstance(navigation, InertialNavigation)
        assert navigation.noise is not None
        cycle = navigation.noise.cycle
        aiding = self.errors.filter(cycle, self.sensors(cycle))
        navigation = dataclasses.replace(navigation, filter=aiding)
        return dataclasses.replace(scenario, navigation=navigation)

    @computed_once
    def knowledge(self) -> dict[str, Dispersion]:
        """Errors of the inertial navigation alone, for both worlds."""
        errors = self.errors
        table = {}
        for words, address, ends, size in (
            ("position", "navigation.knowledge.", _LOCAL, errors.position),
            ("velocity", "navigation.knowledge.velocity_", _LOCAL, errors.velocity),
            ("tilt", "navigation.knowledge.tilt_", _LOCAL, errors.tilt),
            ("bias", "accelerometers.bias_", _BODY, errors.bias),
            ("scale error", "accelerometers.scale_error_", _SCALED, errors.scale_error),
            (
                "misalignment",
                "accelerometers.misalignment_",
                _TURNS,
                errors.misalignment,
            ),
            ("drift", "navigation.gyroscopes.drift_", _TURNS, errors.drift),
        ):
            for end in ends:
                lens, normal = _lens(address + end), Normal(0.0, size)
                table[f"{words} {end}"] = Dispersion(lens, normal)
        seed = Dispersion(_lens("navigation.seed"), Uniform(0.0, 1.0))
        return table | {"navigation noise": seed}

    @computed_once
    def usual_and_knowledge(self) -> dict[str, Dispersion]:
        """The usual dispersions and `knowledge` together, for both worlds."""
        return dict(self.usual()) | self.knowledge()


def _lens(address: str) -> Callable[[Any], Any]:
    part = attrgetter(address)

    def lens(scenario: Any) -> Any:
        if isinstance(scenario.navigation, PerfectNavigation):
            raise ValueError(
                f"navigation is PerfectNavigation, without {address}: choose the world "
                "inertial or aided, such as --world inertial"
            )
        return part(scenario)

    return lens
