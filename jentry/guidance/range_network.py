"""A network in place of the prediction: how far a flight at a constant bank goes."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fields import Flag, Scalar
from ..motion.state import EntryState
from ..onboard.estimation import Factors
from ..onboard.model import OnboardModel
from ..onboard.navigation import measure
from ..onboard.network import Network


PURPOSE = "range at a constant bank, to a velocity or an altitude"

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


class Answer(NamedTuple):
    """What a network says of a flight."""

    range: Scalar
    """Arc on the surface to the end, m"""
    knows: Flag
    """Whether all that it has read is within the ranges of its training"""


class RangeNetwork(eqx.Module):
    """The range of the rest of a flight, by a network that has learnt predictions.

    It gives the mean deceleration to the end, (v^2 - v_f^2) / (2 range), of which the
    logarithm goes over to that of the drag as the end comes near. It is of one vehicle,
    one end and one shape of the bank, and answers within the ranges of its training only.
    """

    network: Network

    def __check_init__(self):
        if self.network.names != INPUTS:
            raise ValueError(
                f"the network reads {', '.join(self.network.names)}: the range is read "
                f"from {', '.join(INPUTS)}"
            )

    def __call__(
        self,
        model: OnboardModel,
        state: EntryState,
        angle_of_attack: Scalar,
        factors: Factors,
        number: Scalar,
        end_velocity: Scalar,
    ) -> Answer:
        """Range from a state at a constant bank, and whether that is known."""
        read = features(model, state, angle_of_attack, factors, number)
        square = state.velocity**2 - end_velocity**2
        knows = self.network.knows(read) & (square > 0.0)
        # On both sides of what is chosen, so that no derivative comes from out there.
        inside = jnp.where(knows, read, self.network.input_mean)
        square = jnp.where(knows, square, 0.0)
        return Answer(0.5 * square * jnp.exp(-self.network(inside)), knows)


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
