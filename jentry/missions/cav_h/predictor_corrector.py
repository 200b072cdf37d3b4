"""CAV-H, numerical predictor-corrector to a point and a velocity, with the bank only."""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp

from ...flight.scenario import Scenario
from ...guidance.bank_shapes import TwoEndedBankShape
from ...guidance.glide_damping import GlideDamping
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import PredictedCrossrange
from ...guidance.predictor_corrector import PredictorCorrector
from ...motion.index import VelocityIndex
from ...onboard.model import OnboardModel
from ...onboard.profiles import PolynomialProfile
from ...units import degree
from .scenario import FINAL_VELOCITY, LARGEST_BANK, earth, glider, stored


STEP = 0.5
"""Length of a step, s; the bank is smooth within a guidance cycle"""

ANGLE_OF_ATTACK = 6.0 * degree
"""Chosen angle of attack. The bank of the nominal flight is then 36 to 56 degrees, which
leaves a margin to either side, and its load factor is 1.63 g of the allowed 2 g. Below 10
degrees the drag does not depend on the angle of attack"""


def guided() -> Scenario:
    """Predictor-corrector: two bank numbers for range and altitude at the final velocity.

    The paper's law flies straight ahead and changes the angle of attack. Here the angle of
    attack is constant, and excess lift is banked to one side or the other. With the
    damping the first number determines the range and the second one the altitude. The law
    does not control flight-path angle and heading at the target.

    Bank reversals take no time here. A small factor makes more of them, up to about a
    dozen; the flights then end nearer to the target and to the paper's heading.
    """
    paper = stored()
    law = PredictorCorrector(
        model=OnboardModel(earth(), glider()),
        shape=TwoEndedBankShape(
            end=FINAL_VELOCITY, final=50.0 * degree, largest=LARGEST_BANK
        ),
        end=GuidedEnd(velocity=FINAL_VELOCITY),
        lateral=PredictedCrossrange(factor=2.0, most=20.0),
        angle_of_attack=PolynomialProfile(jnp.array([ANGLE_OF_ATTACK])),
        damping=GlideDamping(lowest=math.cos(LARGEST_BANK)),
        index=VelocityIndex(),
        in_space=False,
        step=5.0,
        steps=400,
    )
    guided = eqx.tree_at(lambda s: s.guidance, paper, law)
    return dataclasses.replace(guided, step=STEP)
