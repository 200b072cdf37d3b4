"""Scenario: planet, vehicle, initial state, law and end conditions in one pytree."""

import math
from collections.abc import Mapping

import equinox as eqx
import jax
import numpy as np

from .._printed import as_text
from ..fields import (
    QUARTER,
    Scalar,
    optional_scalar,
    scalar,
)
from ..guidance.aim import Aim, OrbitOfScenario, TargetOfScenario, is_aim, told
from ..guidance.law import (
    AbstractLaw,
)
from ..motion.attitude import AbstractAttitude, IdealAttitude
from ..motion.constraints import (
    Constraints,
    usual_constraints,
)
from ..motion.dynamics import AbstractDynamics, EntryDynamics
from ..motion.orbit import OrbitTarget
from ..motion.state import EntryState
from ..onboard.flow_sensing import FlowSensors
from ..onboard.measurement import (
    AbstractAccelerometers,
    PerfectAccelerometers,
)
from ..onboard.navigation import (
    AbstractNavigation,
    PerfectNavigation,
)
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from .termination import Termination


class Target(eqx.Module):
    """Where guided flight should end: laws fly there, and misses are counted from there.

    Downrange and crossrange are arcs on the surface, see `ground_track`. With an origin
    they define a place, which does not change with the start of a flight. Without an
    origin they define the range that each flight covers from its own start. This is for
    laws that use no place, such as `ObserverDragTracking`.

    A law that flies to a place (`RangeTracking`, `PredictorCorrector`) takes it from here.
    On an ellipsoid the altitude is the geodetic one; arcs are on the sphere of
    `Planet.radius`.

    A planned reference and the track of a Bézier curve do not move with the target: `check`
    refuses a track that ends elsewhere.
    """

    altitude: Scalar = scalar(unit="m")
    velocity: Scalar = scalar(unit="m/s")
    downrange: Scalar = scalar(unit="m")
    crossrange: Scalar = scalar(0.0, unit="m")
    flight_path_angle: Scalar | None = optional_scalar(unit="rad", range=QUARTER)
    """Desired flight-path angle; None if there is none"""
    heading: Scalar | None = optional_scalar(unit="rad")
    """Desired heading; None if there is none"""
    origin: EntryState | None = None
    """Place and heading from which downrange and crossrange are counted; None for the
    start of each flight"""

    __str__ = as_text

    @property
    def counted_from(self) -> str:
        """Text that describes from what the downrange and crossrange errors count."""
        if self.origin is None:
            return "range flown from the start of each flight"
        return "place of the target, which does not move with the start"


class Scenario(eqx.Module):
    """One guided entry. Each of its numbers is a leaf: disperse, tune or sweep it."""

    planet: Planet
    vehicle: Vehicle
    initial_state: EntryState
    guidance: AbstractLaw
    termination: Termination
    target: Target | OrbitTarget
    """Where guided flight should end: at a place, or on an orbit after the exit"""
    accelerometers: AbstractAccelerometers = PerfectAccelerometers()
    flow_sensors: FlowSensors | None = None
    """Sensors of the velocity relative to the air; None if guidance has none"""
    navigation: AbstractNavigation = PerfectNavigation()
    """What the vehicle believes of its position and velocity"""
    angle_of_attack_error: Scalar | None = optional_scalar(unit="rad")
    """Error of the measured angle of attack, measured minus actual; None for a perfect
    measurement. The attitude does not depend on it"""
    attitude: AbstractAttitude = IdealAttitude()
    dynamics: AbstractDynamics = EntryDynamics()
    constraints: Constraints = eqx.field(default_factory=usual_constraints)
    """Path constraints that are evaluated in flight, by name: see `Flight.peaks`"""
    located_peaks: tuple[str, ...] = eqx.field(default=(), static=True)
    """Names of the path constraints whose peaks are located: see `Flight.at_peaks`"""
    values_at_end: tuple[str, ...] = eqx.field(default=(), static=True)
    """Names of the path constraints whose values at the end are outputs: see
    `Flight.at_end`"""
    step: float | None = eqx.field(default=None, static=True)
    """Length of the steps of a `FixedStep` that states none, s. If this is None too, a step
    is 0.1 s. For a law with a guidance cycle that varies, which holds its command, it is
    one cycle"""

    @property
    def place(self) -> Target:
        """The target, which must be a place.

        Raises `ValueError` if it is an orbit.
        """
        if isinstance(self.target, OrbitTarget):
            raise ValueError(
                "target is an OrbitTarget, and this needs a place on the ground: give the "
                "scenario target=Target(...)"
            )
        return self.target

    @property
    def law(self) -> AbstractLaw:
        """The guidance law, with the target of the scenario.

        Raises `ValueError` if the law flies to a place and the target is not a place, or to
        an orbit and the target is none.
        """
        parts = jax.tree.leaves(self.guidance, is_leaf=is_aim)
        asks = TargetOfScenario | OrbitOfScenario
        if not any(isinstance(part, asks) for part in parts):
            return self.guidance
        target = self.target
        if isinstance(target, OrbitTarget):
            return told(self.guidance, target)
        to_orbit = any(isinstance(part, OrbitOfScenario) for part in parts)
        if target.origin is None and not to_orbit:
            raise ValueError(
                f"{type(self.guidance).__name__} flies to a place, and target.origin is "
                "None, which leaves the target a range: give the place and heading from "
                "which it is counted, such as Target(..., origin=initial_state)"
            )
        origin = self.initial_state if target.origin is None else target.origin
        aim = Aim(
            origin,
            target.downrange,
            target.crossrange,
            target.altitude,
            target.velocity,
        )
        return told(self.guidance, aim)

    def __check_init__(self):
        for name, kind in _KINDS.items():
            part = getattr(self, name)
            if not isinstance(part, kind):
                found = part.__name__ if isinstance(part, type) else type(part).__name__
                names = " or ".join(each.__name__ for each in kind)
                raise ValueError(
                    f"{name} is of {found}: it must be an object of {names}"
                )
        if isinstance(self.step, jax.Array | np.ndarray):
            raise ValueError(
                f"step is the array {self.step}: it is part of the program, so give a "
                "number of Python, such as step=0.5"
            )
        if self.step is not None and not 0.0 < self.step < math.inf:
            raise ValueError(f"step is {self.step} s: it must be positive and finite")


_KINDS: Mapping[str, tuple[type, ...]] = {
    "planet": (Planet,),
    "vehicle": (Vehicle,),
    "initial_state": (EntryState,),
    "guidance": (AbstractLaw,),
    "termination": (Termination,),
    "target": (Target, OrbitTarget),
    "accelerometers": (AbstractAccelerometers,),
    "flow_sensors": (FlowSensors, type(None)),
    "navigation": (AbstractNavigation,),
    "attitude": (AbstractAttitude,),
    "dynamics": (AbstractDynamics,),
    "constraints": (Mapping,),
}
"""Classes of the parts of a scenario, by name"""
