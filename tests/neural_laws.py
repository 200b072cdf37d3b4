"""Small neural laws of the Mars lander, with random weights."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from helpers import fly_compiled

from jentry.flight import FixedStep
from jentry.guidance import BankProfile, FixedCycle, NeuralLaw, Sampled
from jentry.guidance.neural_law import (
    INPUTS,
    AngleOfAttackLimits,
    input_names,
    inputs_of,
)
from jentry.missions.mars.drag_tracking import entry, to_the_place
from jentry.motion import EntryDynamics
from jentry.onboard import (
    Measurement,
    OnboardModel,
    PolynomialProfile,
    RecurrentNetwork,
    measure,
)
from jentry.units import degree, km
from jentry.world import PolynomialAerodynamics, Vehicle


PERIOD = 4.0
SOLVER = FixedStep(2.0)
ANGLES = AngleOfAttackLimits(-5.0 * degree, 25.0 * degree, 2.0 * degree)


def network_of(seed=0, memory=3, hidden=(4,), size=1.0, angle=False, flow=False):
    """Random weights, normalised by samples about what occurs."""
    samples = {name: np.array([-2.0, 2.0]) for name in input_names(angle, flow)}
    network = RecurrentNetwork.untrained(
        samples, memory, hidden, 1 + angle, jax.random.key(seed)
    )
    wide = jnp.asarray([[-100.0, 100.0]] * len(samples))
    network = eqx.tree_at(lambda n: n.input_ranges, network, wide)
    last = lambda n: n.layers[-1].weight
    return eqx.tree_at(last, network, replace_fn=lambda w: size * w)


def law_of(network=None, **options):
    start = entry()
    if network is None:
        flow = options.get("reads_flow", False)
        network = network_of(angle="angles" in options, flow=flow)
    return NeuralLaw(
        network=network,
        model=OnboardModel(start.planet, start.vehicle),
        cycle=FixedCycle(PERIOD),
        **options,
    )


def scenario_of(law):
    start = dataclasses.replace(to_the_place(entry()), dynamics=EntryDynamics())
    return dataclasses.replace(start, guidance=law)


def gliding_scenario_of(law):
    """With lift and drag that depend on the angle of attack."""
    start = scenario_of(law)
    vehicle = Vehicle(
        992.0,
        16.0,
        aerodynamics=PolynomialAerodynamics([-0.04, 1.5], [0.5, -0.1, 3.0]),
        trim_angle_of_attack=8.0 * degree,
    )
    return dataclasses.replace(start, vehicle=vehicle)


def teacher():
    """Banks by a polynomial over the velocity, to the right."""
    law = Sampled(BankProfile(PolynomialProfile(jnp.array([0.2, 1e-4]))), PERIOD)
    return scenario_of(law)


def flown(law):
    """With its history, which some tests look at: one program for all of them."""
    return fly_compiled(scenario_of(law), SOLVER, PERIOD)


def aim_of(law):
    return scenario_of(law).law.aim


def sensed(state, lift_factor=1.0, drag_factor=1.0, law=None):
    model = (law or law_of()).model
    angle = model.vehicle.trim_angle_of_attack
    found = measure(model.planet, model.vehicle, state, angle)
    return Measurement(
        state, lift_factor * found.lift, drag_factor * found.drag, angle, angle, {}
    )


def state_at(**moved):
    return dataclasses.replace(
        entry().initial_state, **{n: jnp.asarray(x) for n, x in moved.items()}
    )


def read_at(state, bank=0.0, **factors):
    law = law_of()
    read = inputs_of(
        law.model, aim_of(law), sensed(state, **factors), jnp.asarray(bank)
    )
    return dict(zip(INPUTS, np.asarray(read), strict=True))


MIDDLE = {
    "altitude": 31.0 * km,
    "longitude": 7.3 * degree,
    "latitude": 0.4 * degree,
    "velocity": 3100.0,
    "flight_path_angle": -9.0 * degree,
    "heading": 88.0 * degree,
}


def other_law():
    return Sampled(BankProfile(PolynomialProfile(jnp.array([0.6, 0.0001]))), PERIOD)


def assert_same(a, b):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-9, equal_nan=False)
