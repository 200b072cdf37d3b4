"""Mars lander under a neural law, trained through flights in hard air.

Choices of our own.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx
import jax

from ..._computed_once import computed_once
from ...fields import Scalar
from ...flight.flight import Flight
from ...flight.miss import misses
from ...flight.scenario import Scenario
from ...guidance.neural_law import PURPOSE, NeuralLaw
from ...onboard.model import OnboardModel
from ...onboard.recurrent_network import RecurrentNetwork, load_recurrent_network
from ...units import km
from .air_with_waves import hard_air, wider
from .predictor_corrector import guided


if TYPE_CHECKING:
    from ...learning.law_training import LawTraining


FOLDER = Path(__file__).parent / "networks"
"""Folder of the weights that come with the package"""

EXCESS = 1000.0
"""Excess of the velocity at the end, m/s, that counts as much as a miss of 1 km"""


@computed_once
def law_network(folder: Path = FOLDER) -> RecurrentNetwork:
    """The stored network of the law. Raises `ValueError` for a file with another one."""
    network, _ = load_recurrent_network(folder / "law.npz", PURPOSE)
    return network


def with_network(network: RecurrentNetwork) -> Scenario:
    """The lander under a neural law with a network."""
    start = guided()
    law = NeuralLaw(network=network, model=OnboardModel(start.planet, start.vehicle))
    return eqx.tree_at(lambda s: s.guidance, start, law)


def neural() -> Scenario:
    """A recurrent network that commands a signed bank every 2 s, trained in hard air."""
    return with_network(law_network())


def residuals(scenario: Scenario, flight: Flight) -> tuple[Scalar, ...]:
    """Errors of downrange and crossrange, km, and a share of the excess velocity.

    A flight ends at the end altitude or at the end velocity. Without a cost of the excess
    the law comes down faster, and has less time to miss.
    """
    missed = misses(scenario, flight)
    excess = jax.nn.relu(flight.state.velocity - scenario.target.velocity)
    return missed.downrange / km, missed.crossrange / km, excess / EXCESS


def training() -> "LawTraining":
    """Through flights in the hard air, with all errors 1.5 times as wide.

    A law that is trained on the errors themselves comes nearer to the target with them, and
    loses flights if they are 1.5 times as wide.
    """
    from ...learning.law_training import LawTraining  # optax takes a while

    return LawTraining(
        teacher=hard_air(guided()),
        with_network=lambda network: hard_air(with_network(network)),
        dispersions=wider(),
        residuals=residuals,
    )
