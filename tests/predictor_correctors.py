"""Scenarios, predictions and decisions of predictor-correctors, shared by test files."""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from helpers import fly_compiled

from jentry._computed_once import computed_once
from jentry.flight import FixedStep
from jentry.missions import find_mission
from jentry.missions.mars import predictor_corrector as mars
from jentry.onboard import Factors, measure


def number(x):
    return jnp.asarray(float(x))


@computed_once
def in_plane():
    return find_mission("mars-range-tracking").scenario(
        "predictor-corrector", world="in-plane"
    )


@computed_once
def in_space():
    return mars.guided()


def start_of(scenario):
    law = scenario.law
    angle = scenario.vehicle.trim_angle_of_attack
    return measure(law.model.planet, law.model.vehicle, scenario.initial_state, angle)


@eqx.filter_jit
def predicted(
    law, seen, numbers, sign, in_space, factors=Factors(), reverses_in=math.inf
):
    zero = 0.0 * seen.drag
    return law.predicted(zero, seen, factors, numbers, sign, in_space, reverses_in)


def decided(law, seen, numbers):
    _, held = law.init(seen)
    held = dataclasses.replace(held, numbers=jnp.asarray(numbers))
    return law.update(0.0 * seen.drag, seen, (), held)[1]


@functools.cache
def underway():
    """The nominal flight, and what is measured after 80 s of it."""
    flight = fly_compiled(in_plane(), FixedStep(), 10.0)
    state = jax.tree.map(lambda x: x[8], flight.history.states)
    model = in_plane().law.model
    angle = in_plane().vehicle.trim_angle_of_attack
    return flight, measure(model.planet, model.vehicle, state, angle)
