"""Predictions of the onboard model of a Mars entry, shared by test files."""

import equinox as eqx
import jax.numpy as jnp
from helpers import bank_profile, mars_scenario

from jentry.motion import Controls, EquatorialDynamics
from jentry.onboard import Factors, OnboardModel, propagate


SCENARIO = mars_scenario()
MODEL = OnboardModel(SCENARIO.planet, SCENARIO.vehicle)
START = SCENARIO.initial_state
ENDS = (
    lambda state: state.velocity - 503.0,
    lambda state: state.altitude - 10e3,
    lambda state: 135e3 - state.altitude,
)
"""Of the scenario, and of a flight that skips out"""


def one(x):
    return jnp.asarray(x, dtype=float)


def profile(time, state):
    """The command that the scenario flies open loop."""
    cosine = bank_profile().cos_bank(state.velocity)
    return Controls(0.0 * cosine, cosine, jnp.sqrt(1.0 - cosine * cosine))


def constant_bank(angle):
    def command(time, state):
        return Controls.from_bank(angle + 0.0 * time, 0.0 * time)

    return command


def predicted(
    step=3.0, lift=1.0, drag=1.0, cosine=None, steps=128, state=START, model=MODEL
):
    """In the plane: under the profile, or at a constant cosine of the bank."""
    cosine = None if cosine is None else one(cosine)
    return _predicted(one(step), one(lift), one(drag), cosine, steps, state, model)


@eqx.filter_jit
def _predicted(step, lift, drag, cosine, steps, state, model):
    def command(time, state):
        return Controls(0.0 * time, cosine + 0.0 * time, 0.0 * time)

    return propagate(
        model,
        state,
        profile if cosine is None else command,
        ENDS,
        step=step,
        steps=steps,
        factors=Factors(lift, drag),
        dynamics=EquatorialDynamics(),
    )


def downrange(state):
    """m along the equator."""
    return state.longitude * MODEL.planet.radius
