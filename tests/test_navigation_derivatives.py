"""Derivatives of a flight through inertial navigation and its filter, the end included."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_navigation_filter import ALTIMETER, DOPPLER, DRAG, TERRAIN, aided

from jentry import FixedStep, fly
from jentry.addresses import leaves_by_address, replace_leaves
from jentry.flight import VelocityBelow
from jentry.units import km


VARIED = {
    "initial_state.velocity": 10.0,
    "guidance.bank_angle": 0.05,
    "navigation.knowledge.up": 300.0,
    "navigation.knowledge.velocity_east": 0.5,
    "accelerometers.bias_forward": 1e-3,
    "navigation.gyroscopes.drift_pitch": 1e-6,
    "navigation.filter.knowledge.up": 60.0,
    "navigation.filter.sensors.altimeter.assumed": 2.0,
    "navigation.filter.sensors.drag.noise": 0.01,
}
"""Addresses of parameters, and how far each is moved"""


def scenario_of(sensors):
    scenario = aided(sensors, seconds=100.0)
    state = dataclasses.replace(
        scenario.initial_state, altitude=jnp.asarray(50 * km), velocity=jnp.asarray(4e3)
    )
    ends = dataclasses.replace(
        scenario.termination,
        conditions={"slow": VelocityBelow(jnp.asarray(1500.0), by="navigation")},
    )
    return dataclasses.replace(scenario, initial_state=state, termination=ends)


@pytest.mark.slow
def test_derivatives_are_differences():
    """Forward and reverse, to one part in a million of each output's largest derivative."""
    sensors = {"altimeter": dataclasses.replace(ALTIMETER, assumed=jnp.asarray(15.0))}
    sensors |= {"doppler": DOPPLER, "drag": DRAG, "terrain": TERRAIN}
    scenario = scenario_of(sensors)
    sizes = np.array(list(VARIED.values()))

    leaves = leaves_by_address(scenario)

    def moved(steps):
        values = {
            address: leaves[address] + step
            for address, step in zip(VARIED, list(steps * sizes), strict=True)
        }
        return replace_leaves(scenario, values)

    @jax.jit
    def end(steps):
        flight = fly(moved(steps), FixedStep(0.5))
        known = flight.knowledge
        return jnp.stack(
            [
                flight.time,
                flight.state.altitude,
                1e7 * flight.state.longitude,
                known.error.up,
                known.error.velocity_up,
                known.deviation.up,
                known.normalised_error_squared,
            ]
        )

    here = jnp.zeros(len(VARIED))
    assert float(end(here)[0]) < 99.0
    expected = np.empty((7, len(VARIED)))
    for i, unit in enumerate(np.eye(len(VARIED))):
        central = lambda h, unit=unit: (
            np.asarray(end(jnp.asarray(h * unit)) - end(jnp.asarray(-h * unit)))
            / (2 * h)
        )
        expected[:, i] = (4 * central(1e-2) - central(2e-2)) / 3
    found = np.asarray(jax.jit(jax.jacfwd(end))(here))
    weights = 1.0 / np.max(np.abs(expected), axis=1)
    assert np.all(np.max(np.abs(expected), axis=1) > 0.0)
    np.testing.assert_allclose(
        found * weights[:, None], expected * weights[:, None], rtol=0, atol=1e-6
    )
    reverse = jax.jit(
        jax.grad(lambda steps: jnp.sum(end(steps) * jnp.asarray(weights)))
    )
    np.testing.assert_allclose(reverse(here), weights @ found, rtol=0, atol=1e-10)
