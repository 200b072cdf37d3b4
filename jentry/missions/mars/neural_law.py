"""Mars lander under a neural law, trained in hard air and with navigation errors.

Choices of our own.
"""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx
import jax

from ...fields import Scalar
from ...flight.flight import Flight
from ...flight.miss import misses
from ...flight.scenario import Scenario
from ...guidance.neural_law import NeuralLaw
from ...onboard.model import OnboardModel
from ...onboard.recurrent_network import RecurrentNetwork
from ...units import km
from ..inertial import Inertial
from ..stored_law import law_network
from .air_with_waves import air_and_vehicle, hard_air, wider
from .predictor_corrector import guided


if TYPE_CHECKING:
    from ...learning.law_training import LawTraining


FOLDER = Path(__file__).parent / "networks"
"""Folder of the weights that come with the package"""

STEP = 0.5
"""Length of a step, s: the bank is constant within a guidance cycle"""

EXCESS = 1000.0
"""Excess of the velocity at the end, m/s, that counts as much as a miss of 1 km"""


def with_network(network: RecurrentNetwork) -> Scenario:
    """The lander under a neural law with a network."""
    start = dataclasses.replace(guided(), step=STEP)
    law = NeuralLaw(network=network, model=OnboardModel(start.planet, start.vehicle))
    return eqx.tree_at(lambda s: s.guidance, start, law)


def neural() -> Scenario:
    """A recurrent network that commands a signed bank every 2 s, trained in hard air.

    It was trained with the navigation errors of the world `aided` too."""
    return with_network(law_network(FOLDER))


def residuals(scenario: Scenario, flight: Flight) -> tuple[Scalar, ...]:
    """Errors of downrange and crossrange, km, and a share of the excess velocity.

    A flight ends at the end altitude or at the end velocity. Without a cost of the excess
    the law comes down faster, and has less time to miss.
    """
    missed = misses(scenario, flight)
    excess = jax.nn.relu(flight.state.velocity - scenario.place.velocity)
    return missed.downrange / km, missed.crossrange / km, excess / EXCESS


def in_hard_air() -> "LawTraining":
    """Training with perfect navigation, with all errors 1.5 times as wide.

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


def training(navigation: Inertial) -> "LawTraining":
    """The law of `in_hard_air`, trained further with a navigation that has errors.

    Only then does it know a navigated state that jumps, where the filter begins to measure.
    A flight with its filter takes several times as long.
    """
    from ...learning.neural_law import robust_mean
    from ...learning.weight_steps import GaussNewtonSteps
    from ...tuning.losses import power_mean

    before, table = in_hard_air(), wider()
    known = {name: table[name] for name in air_and_vehicle()}
    return dataclasses.replace(
        before,
        with_network=lambda network: hard_air(navigation.aided(with_network(network))),
        dispersions=known | dict(navigation.knowledge()),
        methods=(
            GaussNewtonSteps(robust_mean, steps=50, flights=512),
            GaussNewtonSteps(power_mean, steps=40, flights=512, large=100.0),
        ),
        before=before,
    )
