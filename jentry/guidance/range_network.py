"""A network that replaces the prediction of the range at a constant bank.

A network can also predict in three dimensions. Over a planet at rest, in still air, a bank
that does not change sign bends the path in the same way in every direction, and a bank to
the other side gives the mirror image. The end of the flight relative to the present great
circle therefore depends on the same inputs as the range. Latitude and heading do not
matter.
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
from ..onboard.measurement import measure
from ..onboard.model import OnboardModel, require_sphere, require_still_air
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
"""Altitudes (m) and velocity (m/s) at which `basis` evaluates the model"""

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
"""Relative tolerance, for rounding, in the comparison with the basis of a network"""


class Answer(NamedTuple):
    """Prediction of a network for a flight."""

    range: Scalar
    """Arc on the surface to the end, m; in three dimensions the downrange along the present
    great circle"""
    across: Scalar
    """Distance of the end from that great circle to the side of the bank, m; 0 in the
    vertical plane"""
    knows: Flag
    """Whether all inputs are within the ranges of the training"""


class RangeNetwork(eqx.Module):
    """Range of the rest of a flight, by a network that was trained on predictions.

    The output of the network is the logarithm of the mean deceleration to the end, (v^2 -
    v_f^2) / (2 range). It tends to the logarithm of the drag as the end comes near. A
    network is valid for one model, one end condition and one shape of the bank. For
    another model or end, and beyond the ranges of its training, it has no answer.

    In three dimensions a second network predicts the displacement to the side of the bank.
    Its output is the logarithm of a factor on sin(bank) ln(v / v_f) times the range ahead.
    The factor tends to half of L/D as the end comes near, where gravity is small beside
    the drag.
    """

    network: Network
    of: Vector = table()
    """Model and end condition for which the network was trained, as from `basis`"""
    across: Network | None = None
    """Network of the displacement to the side; None for a network of the vertical plane"""

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
        """Whether the network was trained on predictions in three dimensions."""
        return self.across is not None

    @property
    def networks(self) -> tuple[Network, ...]:
        """The network of the range and, in three dimensions, that of the displacement."""
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
        """End of a flight from a state at a constant bank, and whether it is known.

        `end` is the velocity (m/s) and the altitude (m); the first that is met ends it.
        """
        read = features(model, state, angle_of_attack, factors, number)
        square = state.velocity**2 - end[0] ** 2
        asked = basis(model, state, angle_of_attack, end)
        same = jnp.all(jnp.abs(asked - self.of) <= _SAME * jnp.abs(self.of))
        knows = same & (square > 0.0) & (model.planet.rotation_rate == 0.0)
        for network in self.networks:
            knows &= network.knows(read)
        # On both sides of the selection, so that the unused branch has no derivative.
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
        """Place at which the flight of an answer ends, for a sign of the bank.

        Only longitude and latitude of the returned state are those of the end. In the
        vertical plane the longitude counts from zero, as in a prediction.
        """
        if not self.in_space:
            return dataclasses.replace(state, longitude=answer.range / planet.radius)
        longitude, latitude = from_ground_track(
            planet, state, answer.range, -sign * answer.across
        )
        return dataclasses.replace(state, longitude=longitude, latitude=latitude)


def range_of(square: Scalar, output: Scalar) -> Scalar:
    """Range, m, from the output of its network. `square` is v^2 - v_f^2, m2/s2."""
    return 0.5 * square * jnp.exp(-output)


def full_turn(number: Scalar, velocities: Scalar) -> Scalar:
    """Angle by which a path turns at a lift-to-drag ratio of 1 without other effects, rad.

    **Arguments:**

    - `number`: number of the bank, whose cosine is 2 `number` - 1.
    - `velocities`: ratio of the present velocity to that at the end.
    """
    return 2.0 * safe_sqrt(number * (1.0 - number)) * jnp.log(velocities)


def across_of(ahead: Scalar, turn: Scalar, output: Scalar) -> Scalar:
    """Arc to the side, m, from the arc ahead (m), `full_turn` and the network's output."""
    return ahead * turn * jnp.exp(output)


def basis(
    model: OnboardModel,
    state: EntryState,
    angle_of_attack: Scalar,
    end: tuple[Scalar, Scalar],
) -> Vector:
    """Parameters of a prediction other than its initial state, in the order of `BASIS`.

    Lift and drag are evaluated at two altitudes, so that they also characterise the
    atmosphere. The values do not depend on the altitude and velocity of `state`.
    """
    require_still_air(model.planet, "a network of the range")
    require_sphere(model.planet, "a network of the range")
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
    """Inputs of the network, in the order of `INPUTS`."""
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
