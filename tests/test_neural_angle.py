"""The angle of attack that a neural law commands."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled
from neural_laws import (
    ANGLES,
    MIDDLE,
    PERIOD,
    SOLVER,
    assert_same,
    gliding_scenario_of,
    law_of,
    network_of,
    other_law,
    sensed,
    state_at,
)

from jentry.guidance.neural_law import (
    ANGLE_INPUT,
    INPUTS,
    AngleOfAttackLimits,
    inputs_of,
)
from jentry.units import degree


def angle_flown(law):
    history = fly_compiled(gliding_scenario_of(law), SOLVER, PERIOD).history
    flying = np.isfinite(np.asarray(history.time))
    return history, flying, np.asarray(history.controls.angle_of_attack)[flying]


def test_the_angle_of_attack_of_a_flight_keeps_its_limits():
    """Of its range and its rate, from the trim angle on; and bank and angle differ."""
    limits = AngleOfAttackLimits(2.0 * degree, 14.0 * degree, 0.5 * degree)
    law = law_of(network_of(size=300.0, angle=True), angles=limits)
    history, _, angle = angle_flown(law)
    steps = np.diff(np.append(8.0 * degree, angle))
    assert np.max(np.abs(steps)) <= 0.5 * degree * PERIOD + 1e-12
    assert np.max(np.abs(steps)) > 0.9 * 0.5 * degree * PERIOD
    assert 2.0 * degree < np.min(angle) and np.max(angle) < 14.0 * degree
    assert np.ptp(angle) > 3.0 * degree
    assert np.ptp(np.asarray(history.decisions.bank)[: len(angle)]) > 0.2


def test_the_second_output_is_the_angle_of_attack():
    """Constant outputs: the bank and the angle of attack that they mean, by hand."""
    network = network_of(angle=True)
    zero = jax.tree.map(jnp.zeros_like, network.layers)
    network = eqx.tree_at(lambda n: n.layers, network, zero)
    bias = jnp.array([np.arctanh(0.25), np.arctanh(-0.5)])
    network = eqx.tree_at(lambda n: n.layers[-1].bias, network, bias)
    history, flying, angle = angle_flown(law_of(network, angles=ANGLES))
    bank = np.asarray(history.decisions.bank)[flying]
    assert bank[-1] == pytest.approx(0.25 * math.pi, abs=1e-9)
    assert angle[-1] == pytest.approx((10.0 - 0.5 * 15.0) * degree, abs=1e-9)


def test_the_network_reads_the_angle_of_attack_that_is_measured():
    law = law_of(angles=ANGLES)
    aimed = gliding_scenario_of(law).law
    seen = dataclasses.replace(
        sensed(state_at(**MIDDLE), law=law), angle_of_attack=jnp.asarray(4 * degree)
    )
    read = aimed.reads(seen, jnp.asarray(0.2))
    assert law.network.names[-1] == ANGLE_INPUT
    assert float(read[-1]) == pytest.approx((4.0 - 10.0) / 15.0, rel=1e-12)
    known = inputs_of(law.model, aimed.aim, seen, jnp.asarray(0.2))
    np.testing.assert_array_equal(read[:-1], known)


def test_beyond_the_training_the_angle_of_attack_is_that_of_the_law_beside():
    network = network_of(size=20.0, angle=True)
    never = eqx.tree_at(
        lambda n: n.input_ranges, network, jnp.full((len(INPUTS) + 1, 2), 1e3)
    )
    beside = law_of(never, beside=other_law(), angles=ANGLES)
    flown_by = lambda law: fly_compiled(gliding_scenario_of(law), SOLVER, None)
    assert_same(flown_by(beside).state, flown_by(other_law()).state)
    trusted = law_of(network, beside=other_law(), angles=ANGLES)
    alone = law_of(network, angles=ANGLES)
    assert_same(flown_by(trusted).state, flown_by(alone).state)
