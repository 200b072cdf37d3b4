"""Apollo 10 under a neural law, trained within its limits.

Choices of our own.
"""

import dataclasses
import functools
from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx

from ...fields import Scalar
from ...flight.flight import Flight
from ...flight.miss import misses
from ...flight.scenario import Scenario
from ...guidance.neural_law import NeuralLaw
from ...motion.constraints import excesses, tightened
from ...onboard.model import OnboardModel
from ...onboard.recurrent_network import RecurrentNetwork
from ...units import km
from ..stored_law import law_network
from .dispersions import everything
from .scenario import LARGEST_BANK, guided


if TYPE_CHECKING:
    from ...learning.law_training import LawTraining


FOLDER = Path(__file__).parent / "networks"
"""Folder of the weights that come with the package"""

STEP = 0.5
"""Length of a step, s: the bank is constant within a guidance cycle"""

MARGIN, EXCESS = 0.02, 0.01
"""Share of a path limit below it from which an excess counts, and sum of the excesses, as
shares of their limits, that counts as much as a miss of 1 km"""


def with_network(network: RecurrentNetwork) -> Scenario:
    """The capsule under a neural law with a network."""
    start = dataclasses.replace(guided(), step=STEP)
    model = OnboardModel(start.planet, start.vehicle)
    law = NeuralLaw(network=network, model=model, largest_bank=LARGEST_BANK)
    return eqx.tree_at(lambda s: s.guidance, start, law)


def neural() -> Scenario:
    """A recurrent network that commands a signed bank every 2 s, within the limits."""
    return with_network(law_network(FOLDER))


def residuals(scenario: Scenario, flight: Flight) -> tuple[Scalar, ...]:
    """Errors of downrange and crossrange, km, and the sum of the excesses of limits.

    A sum is one number, and the derivatives of a flight take a time that is proportional to
    the number of residuals.
    """
    missed = misses(scenario, flight)
    limits = tightened(scenario.constraints, MARGIN)
    beyond = sum(excesses(limits, flight.peaks).values())
    return missed.downrange / km, missed.crossrange / km, beyond / EXCESS


def training() -> "LawTraining":
    """Through flights with all errors, and more of them shallow at the end.

    A shallow entry decides in its first dip how fast it leaves the air. There the
    derivatives are far larger than those of most flights: later steps count these flights
    fully, with errors 1.2 times as wide.
    """
    from ...learning.law_training import LawTraining  # optax takes a while
    from ...learning.neural_law import robust_mean
    from ...learning.weight_steps import AdamSteps, GaussNewtonSteps
    from ...tuning.losses import power_mean

    root_mean_square = functools.partial(power_mean, power=2.0)
    return LawTraining(
        teacher=guided(),
        with_network=with_network,
        dispersions=everything(),
        residuals=residuals,
        methods=(
            AdamSteps(robust_mean, steps=500, flights=128),
            GaussNewtonSteps(robust_mean, steps=60, flights=512),
            GaussNewtonSteps(power_mean, steps=60, flights=512, large=100.0),
            GaussNewtonSteps(root_mean_square, steps=60, flights=512, large=100.0),
        ),
        widths=(1.0, 1.0, 1.2, 1.2),
        judged_by=99.9,
    )
