"""CAV-H under a neural law that commands bank and angle of attack, trained through waves.

Choices of our own.
"""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx

from ...fields import Scalar
from ...flight.flight import Flight
from ...flight.miss import misses
from ...flight.scenario import Scenario
from ...guidance.cycle import FixedCycle
from ...guidance.neural_law import AngleOfAttackLimits, NeuralLaw
from ...motion.constraints import excesses, tightened
from ...onboard.model import OnboardModel
from ...onboard.recurrent_network import RecurrentNetwork
from ...units import degree
from ..stored_law import law_network
from . import predictor_corrector
from .dispersions import waves_sensed
from .scenario import LARGEST_BANK, earth, glider, stored


if TYPE_CHECKING:
    from ...learning.law_training import LawTraining


FOLDER = Path(__file__).parent / "networks"
"""Folder of the weights that come with the package"""

PERIOD, STEP = 4.0, 2.0
"""Guidance cycle and step, s: the glide lasts half an hour"""

LEAST_ANGLE, LARGEST_ANGLE = 4.0 * degree, 16.0 * degree
"""Range of the angle of attack, rad"""

ANGLE_RATE = 1.0 * degree
"""Largest rate of the angle of attack, rad/s"""

BANK_RATE = 5.0 * degree
"""Largest rate of the bank, rad/s"""

VELOCITY, ALTITUDE, CROSSRANGE, DIRECTION = 20.0, 200.0, 200.0, 0.2 * degree
"""Errors at the target that count as one: m/s, m, m, and rad for path angle and heading"""

MARGIN = 0.02
"""Share of a path limit below it from which an excess counts"""

EXCESS = 0.01
"""Sum of the excesses, as shares of their limits, that counts as one"""


def with_network(network: RecurrentNetwork) -> Scenario:
    """The glider under a neural law with a network."""
    law = NeuralLaw(
        network=network,
        model=OnboardModel(earth(), glider()),
        turn_rate=BANK_RATE,
        largest_bank=LARGEST_BANK,
        cycle=FixedCycle(PERIOD),
        angles=AngleOfAttackLimits(LEAST_ANGLE, LARGEST_ANGLE, ANGLE_RATE),
    )
    guided = eqx.tree_at(lambda s: s.guidance, stored(), law)
    return dataclasses.replace(guided, step=STEP)


def neural() -> Scenario:
    """A recurrent network that commands bank and angle of attack, trained in waves."""
    return with_network(law_network(FOLDER, with_angle=True))


def residuals(scenario: Scenario, flight: Flight) -> tuple[Scalar, ...]:
    """Errors where the flight ends, and the sum of the excesses of path limits.

    A flight that passes the target has no error along the track, which is not among them.
    """
    missed = misses(scenario, flight)
    assert missed.flight_path_angle is not None and missed.heading is not None
    limits = tightened(scenario.constraints, MARGIN)
    beyond = sum(excesses(limits, flight.peaks).values())
    return (
        missed.velocity / VELOCITY,
        missed.altitude / ALTITUDE,
        missed.crossrange / CROSSRANGE,
        missed.flight_path_angle / DIRECTION,
        missed.heading / DIRECTION,
        beyond / EXCESS,
    )


def training() -> "LawTraining":
    """Through flights in waves of the density that no onboard model knows."""
    from ...flight.solver import FixedStep
    from ...learning.law_training import LawTraining  # optax takes a while
    from ...learning.neural_law import robust_mean
    from ...learning.weight_steps import AdamSteps, GaussNewtonSteps
    from ...tuning.losses import power_mean

    return LawTraining(
        teacher=predictor_corrector.guided(),
        with_network=with_network,
        dispersions=waves_sensed(),
        residuals=residuals,
        methods=(
            AdamSteps(robust_mean, steps=250, flights=128),
            GaussNewtonSteps(robust_mean, steps=60, flights=512),
            GaussNewtonSteps(power_mean, steps=40, flights=512, large=100.0),
        ),
        solver=FixedStep(STEP),
        with_angle=True,
        taught_flights=64,
    )
