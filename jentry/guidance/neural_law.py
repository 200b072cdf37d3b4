"""A recurrent network that commands a signed bank, or that and an angle of attack.

The network reads the measurement in dimensionless numbers, about the onboard model and the
aim. Its memory is that of the law: it can learn to estimate what no single measurement
shows, such as the air below. The command is smooth in all of it. There is no logic of
reversals: the bank has a sign, and turns through zero at a limited rate. Only training can
make such a law.

`jentry.learning.train_neural_law` trains such a law through the flight.
"""

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from .._math import sincos
from ..fields import Scalar, scalar
from ..motion.quantities import (
    course_in_axes,
    direction_to,
    from_ground_track,
)
from ..motion.state import Controls, EntryState
from ..onboard.measurement import Measurement, measure
from ..onboard.model import OnboardModel, require_sphere
from ..onboard.recurrent_network import RecurrentNetwork
from ..units import degree
from ..world.planet import Planet
from .aim import Aim, TargetOfScenario, known
from .cycle import FixedCycle
from .law import AbstractSampledLaw, begun, commanded, decided


PURPOSE = "signed bank from measurements, to a target"
ANGLE_PURPOSE = "signed bank and angle of attack from measurements, to a target"
"""Purposes of the networks, as their model cards state them"""

INPUTS = (
    "velocity",
    "ln of the velocity",
    "altitude to go",
    "flight-path angle",
    "range ahead",
    "range ahead, close to the target",
    "range to the right, over the distance to go",
    "range to the right",
    "ln of the deceleration that is needed",
    "ln of the deceleration that is needed, over the drag of the model",
    "ln of the drag of the model",
    "ln of the sensed drag, over that of the model",
    "ln of the sensed lift, over that of the model",
    "sine of the bank",
    "cosine of the bank",
    "periapsis of a free flight, close to that of the aim's origin",
    "sine of the course to the right of the plane of origin and aim",
)
"""Inputs of the network, dimensionless. Ranges are over the downrange of the aim from its
origin, the altitude over that of the origin, velocities over that of the origin, and
accelerations over the square of that velocity by that downrange. Lift is its magnitude. The
last one is a sine for an aim without crossrange, and the only one that an aim without
downrange has"""

ANGLE_INPUT = "angle of attack, from the middle of its range"
"""Further input of a law that commands the angle of attack: what is measured, over half the
range"""

FLOW_INPUTS = (
    "whether the flow is sensed",
    "sensed wind from behind",
    "sensed wind to the right",
)
"""Further inputs of a law that reads the flow. The wind is the velocity over the ground
minus that over the air, along the level course and normal to it, over `_WIND` of the
velocity of the origin of the aim. Where the flow is not sensed all three are zero"""

_WIND = 0.01
"""Share of the velocity of the origin at which an input of the wind is one"""

_NEAR = 0.003
"""Length, as a share of the downrange of the aim, by which the distance to go is smoothed:
closer, a logarithm of it would only show noise"""

_CLOSE = 0.03
"""Length, as a share of the downrange, over which `range ahead, close to the target` goes
from full size to zero"""

_ASIDE = 0.02
"""Unit of `range to the right`, as a share of the downrange"""

_SHALLOW = 0.1
"""Difference of the periapsis from that of the origin, as a share of the altitude of the
origin, over which the input goes from nothing to one: an error of a tenth of a degree in
the path angle at the entry is a small number, and decides the flight"""

_LEAST_ECCENTRICITY = 1e-3
"""Smoothing of an eccentricity"""

_LEAST_FORCE = 1e-3
"""Smoothing of a specific force, in the unit of accelerations: above the air its logarithm
is constant"""

_LEAST_SINE = 1e-8
"""Smoothing of the sine of a downrange"""

_LEAST_SQUARE = 0.1
"""Smoothing of the difference of squared velocities, as a share of that of the aim"""


def inputs_of(
    model: OnboardModel, aim: Aim, measurement: Measurement, bank: Scalar
) -> Float[Array, " inputs"]:
    """Inputs of the network, in the order of `INPUTS`.

    All are smooth functions of the measurement, also above the air, and where the vehicle
    flies over the aim. `bank` is that commanded before, rad.
    """
    planet, state = model.planet, measurement.state
    require_sphere(planet, "a neural law")
    length, speed = aim.downrange, aim.origin.velocity
    acceleration = speed * speed / length
    place = from_ground_track(planet, aim.origin, aim.downrange, aim.crossrange)
    ahead, right, up = direction_to(*place, state)
    course = _course(planet, aim, state)
    ahead = planet.radius * jnp.arctan2(ahead, up) / length
    right = planet.radius * jnp.arcsin(right) / length
    to_go = _smooth(ahead, _NEAR)

    # Smooth, and positive also where the vehicle is slower than at the aim.
    square, end = (x * x / (speed * speed) for x in (state.velocity, aim.velocity))
    excess = square - end
    excess = 0.5 * (excess + _smooth(excess, _LEAST_SQUARE * end))
    needed = jnp.log(0.5 * excess / to_go)

    def ln(force: Scalar) -> Scalar:
        return jnp.log(_smooth(force / acceleration, _LEAST_FORCE))

    angle = measurement.angle_of_attack
    believed = measure(planet, model.vehicle, state, angle)
    sine, cosine = sincos(bank)
    velocity = state.velocity / speed
    higher = _periapsis(planet, state) - _periapsis(planet, aim.origin)
    return jnp.stack(
        [
            velocity,
            jnp.log(velocity),
            (state.altitude - aim.altitude) / aim.origin.altitude,
            state.flight_path_angle,
            ahead,
            jnp.tanh(ahead / _CLOSE),
            right / to_go,
            right / _ASIDE,
            needed,
            needed - ln(believed.drag),
            ln(believed.drag),
            ln(measurement.drag) - ln(believed.drag),
            ln(measurement.lift) - ln(believed.lift),
            sine,
            cosine,
            jnp.tanh(higher / (_SHALLOW * aim.origin.altitude)),
            course,
        ]
    )


def _periapsis(planet: Planet, state: EntryState) -> Scalar:
    """Radius of the periapsis without air, m, by the velocity relative to the planet."""
    radius = planet.radius + state.altitude
    sine, cosine = sincos(state.flight_path_angle)
    parameter = planet.gravity.acceleration(radius) * radius * radius
    level = state.velocity * cosine
    momentum = radius * level
    latus = momentum * momentum / parameter
    out, across = latus / radius - 1.0, momentum * state.velocity * sine / parameter
    eccentricity = jnp.sqrt(out * out + across * across + _LEAST_ECCENTRICITY**2)
    return latus / (1.0 + eccentricity)


def _course(planet: Planet, aim: Aim, state: EntryState) -> Scalar:
    """Course to the right of the plane of origin and aim: its last input.

    It is the component of the level course along the cross product of the directions of
    origin and aim, over the sine s of the angle of downrange. For an aim without crossrange
    s cancels out. With a sine c of crossrange the plane is turned from that of the origin's
    course by an angle whose tangent is c / s. Near the antipode s is smaller than c. There
    the plane turns back, and at the antipode it is that of the origin's course.
    """
    ahead, left = course_in_axes(aim.origin, state)
    along = jnp.sin(aim.downrange / planet.radius)
    across, cosine = sincos(aim.crossrange / planet.radius)
    scale = jnp.hypot(along, _LEAST_SINE)
    turned = across * along / (scale**8 + across**8) ** 0.25
    return turned * ahead - cosine * left


def flow_inputs_of(aim: Aim, measurement: Measurement) -> Float[Array, " inputs"]:
    """Inputs of the flow, in the order of `FLOW_INPUTS`.

    **Raises:** `ValueError` for a measurement without flow sensors.
    """
    air, state = measurement.air_velocity, measurement.state
    if air is None:
        raise ValueError(
            "the neural law reads the flow, and nothing senses it: give the scenario "
            "flow_sensors, such as FlowSensors(), or leave reads_flow at False"
        )
    _, level = sincos(state.flight_path_angle)
    east, north = sincos(state.heading)
    speed = state.velocity * level
    along = speed - (air.east * east + air.north * north)
    right = air.north * east - air.east * north
    unit = _WIND * aim.origin.velocity
    wind = jnp.stack([along, right]) / unit
    sensed = jnp.where(air.is_sensed, 1.0, 0.0)
    return jnp.append(sensed, jnp.where(air.is_sensed, wind, 0.0))


def input_names(with_angle: bool, with_flow: bool = False) -> tuple[str, ...]:
    """Names of the inputs of a law that commands the angle of attack or reads the flow."""
    return (
        *INPUTS,
        *((ANGLE_INPUT,) if with_angle else ()),
        *(FLOW_INPUTS if with_flow else ()),
    )


def purpose_of(with_angle: bool) -> str:
    """Purpose of a network, with a commanded angle of attack or without."""
    return ANGLE_PURPOSE if with_angle else PURPOSE


def _smooth(x: Scalar, width: Scalar | float) -> Scalar:
    """The magnitude of a number, rounded off where it is smaller than a width."""
    return jnp.sqrt(x * x + width * width)


class AngleOfAttackLimits(eqx.Module):
    """Range and largest rate of a commanded angle of attack."""

    lowest: Scalar = scalar(unit="rad")
    highest: Scalar = scalar(unit="rad")
    turn_rate: Scalar = scalar(unit="rad/s", positive=True)

    def __check_init__(self):
        limits = self.lowest, self.highest
        if any(isinstance(x, Tracer) or not eqx.is_array(x) for x in limits):
            return
        lowest, highest = (float(x) / degree for x in limits)
        if not lowest < highest:
            raise ValueError(
                f"lowest is {lowest:g} degrees and highest {highest:g} degrees: the first "
                "must be below the second"
            )

    def share(self, angle: Scalar) -> Scalar:
        """Angle of attack from the middle of the range, over half of it."""
        middle, half = self._middle_and_half()
        return (angle - middle) / half

    def turned(self, angle: Scalar, output: Scalar, period: float) -> Scalar:
        """Angle of attack (rad) a period (s) after another one (rad), by an output."""
        middle, half = self._middle_and_half()
        return _towards(
            middle + half * jnp.tanh(output), angle, self.turn_rate * period
        )

    def _middle_and_half(self) -> tuple[Scalar, Scalar]:
        return 0.5 * (self.lowest + self.highest), 0.5 * (self.highest - self.lowest)


def _towards(wish: Scalar, now: Scalar, most: Scalar) -> Scalar:
    """A number nearer to another one, by at most a third; smooth."""
    return now + most * jnp.tanh((wish - now) / most)


def _check_aim(aim: Aim | TargetOfScenario) -> None:
    """Refuse an aim whose numbers are the units of inputs, and are zero."""
    if not isinstance(aim, Aim):
        return
    units = {"downrange": aim.downrange, "origin.altitude": aim.origin.altitude}
    for name, unit in units.items():
        if isinstance(unit, Tracer) or not eqx.is_array(unit):
            continue
        if float(unit) == 0.0:
            raise ValueError(
                f"{name} of the aim is zero, and inputs of a neural law are over it: give "
                "it a target some way ahead of an origin above the ground, or another law"
            )


_BEYOND = "decisions_beyond_training"
"""Name of the caveat"""


class NeuralDecision(eqx.Module):
    """Decision of a neural law at a guidance cycle."""

    bank: Scalar
    """Bank, or its difference from that of the law beside; rad, positive to the right"""
    angle_of_attack: Scalar
    """Commanded angle of attack, rad; that of the trim if the network has no `angles`"""
    memory: Float[Array, " memory"]
    """Memory of the network"""
    beside: Any
    """What the law beside holds; None without one"""
    beyond: Scalar
    """1 if an input of this decision or of one before is beyond its range, else 0"""
    decisions: Scalar
    """Number of decisions so far"""
    decisions_beyond: Scalar
    """Number of decisions so far beyond the ranges of the training"""


class NeuralLaw(AbstractSampledLaw[Any, NeuralDecision]):
    """Commands the bank, and the angle of attack with `angles`, by a recurrent network.

    At the start of a cycle the network reads the `INPUTS` and gives y. The bank that it
    wishes is `largest_bank` times tanh(y). A cycle turns towards it by at most `turn_rate`
    times the period. Both limits are smooth. With `angles` the network reads the present
    angle of attack too, and a second output commands it likewise. Without, the vehicle
    flies at its trim angle of attack.

    Another law may fly beside. Then the network is trusted within the ranges of its
    training only. From the first decision beyond them the other law commands alone. With
    `corrects=True` the bank of the network adds to that of the other law, such that a
    network of zeros is that law; with False it replaces it. Where one law takes over from
    the other the command jumps.

    Decisions beyond the ranges of the training appear in `Flight.caveats`. Each input is
    checked alone, so that a flight without this caveat may still be unlike all of the
    training.
    """

    network: RecurrentNetwork
    model: OnboardModel
    turn_rate: Scalar = scalar(20.0 * degree, unit="rad/s", positive=True)
    """Largest rate at which the commanded bank turns"""
    largest_bank: Scalar = scalar(math.pi, unit="rad", positive=True)
    """Largest bank to either side that the network commands"""
    first_bank: Scalar = scalar(0.0, unit="rad")
    """Bank before the first decision; that of a correction too"""
    beside: AbstractSampledLaw | None = None
    """Law that flies beside, with the same cycle; None for the network alone"""
    aim: Aim | TargetOfScenario = TargetOfScenario()
    cycle: FixedCycle = FixedCycle(2.0)
    angles: AngleOfAttackLimits | None = None
    """Limits of the angle of attack; None for a network that commands the bank alone"""
    corrects: bool = eqx.field(default=False, static=True)
    """Whether the network corrects the command of the law beside"""
    reads_flow: bool = eqx.field(default=False, static=True)
    """Whether the network reads the `FLOW_INPUTS` too, for which the scenario needs flow
    sensors"""

    def __check_init__(self):
        names = input_names(self.angles is not None, self.reads_flow)
        outputs, commands = 1, "the bank"
        if self.angles is not None:
            outputs, commands = 2, "bank and angle of attack"
        if self.network.names != names or self.network.outputs != outputs:
            known = self.network.names
            lacking = ", ".join(repr(n) for n in names if n not in known) or "none"
            unknown = ", ".join(repr(n) for n in known if n not in names) or "none"
            raise ValueError(
                f"the network has {self.network.outputs} outputs, and this law {outputs}: "
                f"{commands}. Of the inputs of the law it lacks {lacking}, and the law has "
                f"no {unknown}; both must have the same inputs in the same order: train it "
                "again with `jentry train MISSION --law neural`"
            )
        _check_aim(self.aim)
        if self.corrects and self.angles is not None:
            raise ValueError(
                "corrects is True and angles is given: a correction is of the bank alone; "
                "leave one of them out"
            )
        if self.corrects and self.beside is None:
            raise ValueError(
                "corrects is True and beside is None: give the law to correct, or leave it "
                "at False"
            )
        if self.beside is None:
            return
        if not isinstance(self.beside, AbstractSampledLaw):
            raise ValueError(
                f"beside is a {type(self.beside).__name__}: it must be a sampled law, such "
                "as Sampled(law, period)"
            )
        if self.beside.cycle != self.cycle:
            raise ValueError(
                f"the law beside decides with {self.beside.cycle}, and the neural law with "
                f"{self.cycle}: both must decide together; change one of them"
            )

    def caveats(self, held: NeuralDecision) -> dict[str, Scalar]:
        share = held.decisions_beyond / jnp.maximum(held.decisions, 1.0)
        other = {} if self.beside is None else self.beside.caveats(held.beside)
        if _BEYOND in other:  # of a neural law that flies beside this one
            share = jnp.maximum(share, other[_BEYOND])
        return {**other, _BEYOND: share}

    def init(self, measurement: Measurement) -> tuple[Any, NeuralDecision]:
        zero = 0.0 * measurement.drag
        memory, beside = (), None
        if self.beside is not None:
            memory, beside = begun(self.beside, measurement)
        bank, network = self.first_bank + zero, self.network.start() + zero
        angle = measurement.trim_angle_of_attack + zero
        return memory, NeuralDecision(bank, angle, network, beside, zero, zero, zero)

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: Any,
        held: NeuralDecision,
    ) -> tuple[Any, NeuralDecision]:
        beside = held.beside
        if self.beside is not None:
            memory, beside = decided(self.beside, time, measurement, memory, beside)
        read = self.reads(measurement, held.bank)
        outputs, network = self.network(read, held.memory)
        beyond = jnp.where(self.network.knows(read), 0.0, 1.0)
        angle = held.angle_of_attack
        if self.angles is not None:
            angle = self.angles.turned(angle, outputs[1], self.cycle.period)
        decision = NeuralDecision(
            self.turned(held.bank, outputs[0]),
            angle,
            network,
            beside,
            jnp.maximum(held.beyond, beyond),
            held.decisions + 1.0,
            held.decisions_beyond + beyond,
        )
        return memory, decision

    def reads(self, measurement: Measurement, bank: Scalar) -> Float[Array, " inputs"]:
        """Inputs of the network, with its bank before this decision (rad)."""
        aim = known(self.aim)
        read = inputs_of(self.model, aim, measurement, bank)
        if self.angles is not None:
            read = jnp.append(read, self.angles.share(measurement.angle_of_attack))
        if self.reads_flow:
            read = jnp.append(read, flow_inputs_of(aim, measurement))
        return read

    def turned(self, bank: Scalar, output: Scalar) -> Scalar:
        """Bank (rad) after one cycle from a bank (rad), by the output of the network."""
        wish = self.largest_bank * jnp.tanh(output)
        return _towards(wish, bank, self.turn_rate * self.cycle.period)

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: Any,
        held: NeuralDecision,
    ) -> tuple[Controls, Any]:
        sine, cosine = sincos(held.bank)
        if self.beside is None:
            return Controls(held.angle_of_attack, cosine, sine), ()
        other, rate = commanded(self.beside, time, measurement, memory, held.beside)
        if self.corrects:
            sine, cosine = (
                other.sin_bank * cosine + other.cos_bank * sine,
                other.cos_bank * cosine - other.sin_bank * sine,
            )
        own = held.beyond == 0.0
        angle = other.angle_of_attack
        if self.angles is not None:
            angle = jnp.where(own, held.angle_of_attack, angle)
        controls = Controls(
            angle,
            jnp.where(own, cosine, other.cos_bank),
            jnp.where(own, sine, other.sin_bank),
        )
        return controls, rate
