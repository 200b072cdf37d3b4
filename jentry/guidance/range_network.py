"""A network in place of the prediction: how far a flight at a constant bank goes.

In three dimensions too: over a planet at rest, in still air, a bank that keeps its side
bends the path alike in every direction, and to the other side as its mirror image. Where
the flight ends, seen along the great circle that is flown now, is a matter of what the
range depends on as well; neither latitude nor heading has a part in it.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._math import safe_sqrt
from ..fields import Flag, Scalar, Vector, table
from ..motion.quantities import from_ground_track
from ..motion.state import EntryState
from ..onboard.estimation import Factors
from ..onboard.model import OnboardModel, require_still_air
from ..onboard.navigation import measure
from ..onboard.network import Network
from ..world.planet import Planet


PURPOSE = "range at a constant bank, to a velocity or an altitude"
AHEAD = f"{PURPOSE}: in three dimensions, along the great circle flown now"
ACROSS = f"{PURPOSE}: in three dimensions, from the great circle flown now"

INPUTS = (
    "altitude, 10 km",
    "velocity, km/s",
    "flight-path angle, 0.1 rad",
    "ln of the drag, m/s2",
    "ln of the factor of the drag",
    "ln of the factor of the lift over that of the drag",
    "number of the bank",
)

OUTPUT = "ln((v^2 - v_f^2) / (2 x 1 m/s2)): velocity v, at the end v_f, range x"
OUTPUT_ACROSS = (
    "ln(y / (x sin(bank) ln(v / v_f))): velocity v, at the end v_f, range x along the "
    "great circle, y from it to the side of the bank"
)


_ALTITUDES, _VELOCITY = (20e3, 50e3), 3000.0
"""m and m/s, where `basis` looks at the model"""

BASIS = (
    "velocity at the end, m/s",
    "altitude at the end, m",
    "radius of the planet, m",
    "gravity at 20 km, m/s2",
    *(
        f"{force} at 3 km/s and {1e-3 * altitude:g} km, m/s2"
        for altitude in _ALTITUDES
        for force in ("lift", "drag")
    ),
)

_SAME = 1e-6
"""Share by which what a network is of may differ, by rounding"""


class Answer(NamedTuple):
    """What a network says of a flight."""

    range: Scalar
    """Arc on the surface to the end, m; in three dimensions along the great circle that is
    flown now, as a downrange"""
    across: Scalar
    """From that great circle to the end, m, to the side of the bank; 0 in the plane"""
    knows: Flag
    """Whether all that it has read is within the ranges of its training"""


class RangeNetwork(eqx.Module):
    """The range of the rest of a flight, by a network that has learnt predictions.

    It gives the mean deceleration to the end, (v^2 - v_f^2) / (2 range), of which the
    logarithm goes over to that of the drag as the end comes near. It is of one model, one
    end and one shape of the bank: asked about another model or another end it knows
    nothing, and so it does beyond the ranges of its training.

    In three dimensions a second network tells how far the bank leads to the side. It gives
    the factor on sin(bank) ln(v / v_f) times the range ahead, which goes over to half of
    L/D as the end comes near, where gravity is small beside the drag.
    """

    network: Network
    of: Vector = table()
    """What it has been trained for, as `basis` tells it"""
    across: Network | None = None
    """To the side of the bank; None of the vertical plane"""

    def __check_init__(self):
        if self.of.shape != (len(BASIS),):
            raise ValueError(
                f"of has shape {self.of.shape}: a network of the range is of "
                f"{', '.join(BASIS)}"
            )
        for network in self.networks:
            if network.names != INPUTS:
                raise ValueError(
                    f"the network reads {', '.join(network.names)}: the range is read "
                    f"from {', '.join(INPUTS)}"
                )

    @property
    def in_space(self) -> bool:
        """Whether it has learnt predictions in three dimensions."""
        return self.across is not None

    @property
    def networks(self) -> tuple[Network, ...]:
        """That of the range and, in three dimensions, that to the side."""
        return (self.network,) if self.across is None else (self.network, self.across)

    def __call__(
        self,
        model: OnboardModel,
        state: EntryState,
        angle_of_attack: Scalar,
        factors: Factors,
        number: Scalar,
        end: tuple[Scalar, Scalar],
    ) -> Answer:
        """Where a flight from a state ends at a constant bank, and whether that is known.

        `end` is the velocity (m/s) and the altitude (m) at the first of which it ends.
        """
        read = features(model, state, angle_of_attack, factors, number)
        square = state.velocity**2 - end[0] ** 2
        asked = basis(model, state, angle_of_attack, end)
        same = jnp.all(jnp.abs(asked - self.of) <= _SAME * jnp.abs(self.of))
        knows = same & (square > 0.0) & (model.planet.rotation_rate == 0.0)
        for network in self.networks:
            knows &= network.knows(read)
        # On both sides of what is chosen, so that no derivative comes from out there.
        inside = jnp.where(knows, read, self.network.input_mean)
        square = jnp.where(knows, square, 0.0)
        ahead = range_of(square, self.network(inside))
        if self.across is None:
            return Answer(ahead, jnp.zeros_like(ahead), knows)
        turned = full_turn(number, jnp.where(knows, state.velocity / end[0], 1.0))
        return Answer(ahead, across_of(ahead, turned, self.across(inside)), knows)

    def place(
        self, planet: Planet, state: EntryState, answer: Answer, sign: Scalar | float
    ) -> EntryState:
        """Where such a flight from a state ends, with a bank of a sign.

        Of the state only the place has that of the end: in the vertical plane, as of a
        prediction, a longitude from zero on.
        """
        if not self.in_space:
            return dataclasses.replace(state, longitude=answer.range / planet.radius)
        longitude, latitude = from_ground_track(
            planet, state, answer.range, -sign * answer.across
        )
        return dataclasses.replace(state, longitude=longitude, latitude=latitude)


def range_of(square: Scalar, output: Scalar) -> Scalar:
    """Range, m, of the output of its network. `square` is v^2 - v_f^2, m2/s2."""
    return 0.5 * square * jnp.exp(-output)


def full_turn(number: Scalar, velocities: Scalar) -> Scalar:
    """By which a path turns at a lift-to-drag ratio of 1, if all else is small, rad.

    **Arguments:**

    - `number`: of the bank, whose cosine is 2 `number` - 1.
    - `velocities`: that now over that at the end.
    """
    return 2.0 * safe_sqrt(number * (1.0 - number)) * jnp.log(velocities)


def across_of(ahead: Scalar, turn: Scalar, output: Scalar) -> Scalar:
    """Arc to the side, m, of that ahead, of `full_turn` and of the output."""
    return ahead * turn * jnp.exp(output)


def basis(
    model: OnboardModel,
    state: EntryState,
    angle_of_attack: Scalar,
    end: tuple[Scalar, Scalar],
) -> Vector:
    """What a prediction stands on besides where it begins, in the order of `BASIS`.

    Lift and drag are looked at in two places, so that they tell the air as well. Of the
    state only what these have nothing to do with counts.
    """
    require_still_air(model.planet, "a network of the range")
    seen = []
    for altitude in _ALTITUDES:
        there = dataclasses.replace(
            state, altitude=jnp.full_like(state.altitude, altitude), velocity=_VELOCITY
        )
        forces = measure(model.planet, model.vehicle, there, angle_of_attack)
        seen += [forces.lift, forces.drag]
    planet = model.planet
    gravity = planet.gravity.acceleration(planet.radius + _ALTITUDES[0])
    return jnp.stack([jnp.asarray(x) for x in (*end, planet.radius, gravity, *seen)])


def features(
    model: OnboardModel,
    state: EntryState,
    angle_of_attack: Scalar,
    factors: Factors,
    number: Scalar,
) -> Float[Array, " inputs"]:
    """What the network reads, in the order of `INPUTS`."""
    believed = measure(model.planet, model.vehicle, state, angle_of_attack)
    return jnp.stack(
        [
            1e-4 * state.altitude,
            1e-3 * state.velocity,
            10.0 * state.flight_path_angle,
            jnp.log(believed.drag * factors.drag),
            jnp.log(factors.drag),
            jnp.log(factors.lift / factors.drag),
            number,
        ]
    )
