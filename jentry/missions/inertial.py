"""Inertial navigation of the missions: the world `inertial` and the dispersions for it."""

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
from ..onboard.measurement import BodyAccelerometers, PerfectAccelerometers
from ..onboard.navigation import InertialNavigation, InertialNoise, PerfectNavigation
from ..units import degree, hour, micro_g


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


_LOCAL = "east", "north", "up"
_BODY = "forward", "right", "down"
_SCALED = "forward", "down"
_TURNS = "roll", "pitch", "yaw"


@dataclasses.dataclass(frozen=True)
class Inertial:
    """The inertial navigation of a mission: a world, and dispersions of its errors."""

    errors: Errors
    decided: tuple[str, ...]
    """Names of the end conditions that the vehicle decides by what it believes"""
    usual: Callable[[], Mapping[str, Dispersion]]
    """Function that returns the usual dispersions of the mission"""

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

    @computed_once
    def knowledge(self) -> dict[str, Dispersion]:
        """Errors of the inertial navigation alone, for the world `inertial`."""
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
        """The usual dispersions and `knowledge` together, for the world `inertial`."""
        return dict(self.usual()) | self.knowledge()


def _lens(address: str) -> Callable[[Any], Any]:
    part = attrgetter(address)

    def lens(scenario: Any) -> Any:
        if isinstance(scenario.navigation, PerfectNavigation):
            raise ValueError(
                f"navigation is PerfectNavigation, without {address}: choose the world "
                "inertial, --world inertial"
            )
        return part(scenario)

    return lens
