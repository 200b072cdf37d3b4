"""CAV-H, numerical predictor-corrector: to point and velocity, by the bank alone."""

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
"""s; the bank is smooth within a guidance cycle"""

ANGLE_OF_ATTACK = 6.0 * degree
"""With it the nominal flight banks by 36 to 56 degrees, which leaves room to either side,
and bears 1.63 of the 2 g that are allowed. Chosen: below 10 degrees the drag is the same
at any"""


def guided() -> Scenario:
    """Two numbers of the bank, for range and altitude where the velocity is the final one.

    The paper's law flies straight ahead and turns the angle of attack. Here that is
    constant, and what lift is too much is banked aside, to one side and the other. With
    the damping the first number is for the range and the second one for the altitude.
    Path angle and heading at the target are not aimed at.

    Reversals are at once here. A small factor makes more of them, up to a dozen or so,
    which end nearer the target and nearer the paper's heading.
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
