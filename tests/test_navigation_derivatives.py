"""Derivatives of a flight through inertial navigation and its filter, the end included."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from composed_laws import reference
from filter_flights import ALTIMETER, DRAG, KNOWN, SENSING, TURNING, aided
from laws import all_laws

from jentry import FixedStep, fly
from jentry.addresses import leaves_by_address, replace_leaves
from jentry.flight import VelocityBelow
from jentry.units import km
from jentry.world import InverseSquareGravity


FURTHER = {
    "initial_state.velocity": 10.0,
    "navigation.gravity.gravitational_parameter": 1e10,
    "navigation.filter.knowledge.up": 60.0,
    "navigation.filter.sensors.altimeter.assumed": 2.0,
    "navigation.filter.sensors.drag.noise": 0.01,
}
"""Addresses of parameters, and how far each is moved"""


def flying():
    """A law that reads what the vehicle believes, and an end that it decides by that."""
    altimeter = dataclasses.replace(ALTIMETER, assumed=jnp.asarray(15.0))
    scenario = aided({"altimeter": altimeter, "drag": DRAG}, seconds=100.0)
    navigation = dataclasses.replace(
        scenario.navigation, gravity=InverseSquareGravity(4.2829e13)
    )
    state = dataclasses.replace(
        scenario.initial_state, altitude=jnp.asarray(50 * km), velocity=jnp.asarray(4e3)
    )
    ends = {"slow": VelocityBelow(jnp.asarray(1500.0), by="navigation")}
    return dataclasses.replace(
        scenario,
        guidance=all_laws["sampled observer"](reference()),
        navigation=navigation,
        initial_state=state,
        termination=dataclasses.replace(scenario.termination, conditions=ends),
    )


@pytest.mark.slow
def test_derivatives_are_differences():
    """Forward and reverse, to one part in a million of each output's largest derivative,
    with respect to every error and to what the filter assumes."""
    scenario = flying()
    varied = dict(FURTHER)
    for tree, names in (
        ("navigation.knowledge", KNOWN),
        ("accelerometers", SENSING),
        ("navigation.gyroscopes", TURNING),
    ):
        for name, size in leaves_by_address(names).items():
            varied[f"{tree}.{name}"] = 0.3 * float(size)
    assert len(varied) == 25
    sizes = np.array(list(varied.values()))

    leaves = leaves_by_address(scenario)

    def moved(steps):
        values = {
            address: leaves[address] + step
            for address, step in zip(varied, list(steps * sizes), strict=True)
        }
        return replace_leaves(scenario, values)

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

    # One program for the derivatives and for what differences are taken of.
    pushed = jax.jit(lambda steps, along: jax.jvp(end, (steps,), (along,)))
    here = jnp.zeros(len(varied))
    found, expected = np.empty((2, 7, len(varied)))
    for i, unit in enumerate(jnp.eye(len(varied))):

        def central(h, unit=unit):
            ahead, behind = (pushed(x * unit, unit)[0] for x in (h, -h))
            return np.asarray(ahead - behind) / (2 * h)

        value, found[:, i] = pushed(here, unit)
        assert float(value[0]) < 99.0
        expected[:, i] = (4 * central(1e-2) - central(2e-2)) / 3
    weights = 1.0 / np.max(np.abs(expected), axis=1)
    for axis in (0, 1):
        assert np.all(np.max(np.abs(expected), axis=axis) > 0.0)
    np.testing.assert_allclose(
        found * weights[:, None], expected * weights[:, None], rtol=0, atol=1e-6
    )
    reverse = jax.jit(
        jax.grad(lambda steps: jnp.sum(end(steps) * jnp.asarray(weights)))
    )
    np.testing.assert_allclose(reverse(here), weights @ found, rtol=0, atol=1e-10)
