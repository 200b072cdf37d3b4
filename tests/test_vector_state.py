"""Position and velocity as vectors: their angles, their rates and derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from external_cases import ballistic_vehicle
from helpers import MARS_ROTATION, mars_planet
from vector_cases import MU, RADIUS

from jentry.motion import (
    Controls,
    EntryState,
    VectorDynamics,
    VectorState,
    entry_dynamics,
)
from jentry.units import degree
from jentry.world import ConstantWind, Ellipsoid, ZonalGravity


POINTS = {
    "ordinary": (0.3, 0.4, 900.0, -0.5, 2.0),
    "other turns": (-4.0, -1.2, 900.0, 0.5, 6.2),
    "at the north pole": (0.3, 90 * degree, 900.0, -0.5, 2.0),
    "at the south pole": (4.0, -90 * degree, 900.0, -0.5, 2.0),
    "upwards": (0.3, 0.4, 900.0, 90 * degree, 2.0),
    "downwards": (0.3, 0.4, 900.0, -90 * degree, -5.0),
    "at rest": (0.3, 0.4, 0.0, 0.0, 2.0),
    "down at a pole": (0.3, 90 * degree, 900.0, -90 * degree, 2.0),
    "at rest at a pole": (0.3, 90 * degree, 0.0, 0.0, 2.0),
}


@jax.jit
def there_and_back(state):
    return VectorState.of(state).entry_state


@pytest.mark.parametrize("name", POINTS)
def test_vectors_have_the_angles_that_they_are_made_of(name):
    state = EntryState(50e3, *POINTS[name])
    for one, other in zip(
        jax.tree.leaves(there_and_back(state)), jax.tree.leaves(state), strict=True
    ):
        # Near a pole the latitude is that of a cosine of 6e-17.
        np.testing.assert_allclose(one, other, rtol=1e-14, atol=1e-14)


def test_single_precision_has_them_too():
    for numbers in POINTS.values():
        state = EntryState(50e3, *numbers)
        single = jax.tree.map(lambda x: x.astype(jnp.float32), state)
        for one, other in zip(
            jax.tree.leaves(there_and_back(single)),
            jax.tree.leaves(state),
            strict=True,
        ):
            np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-3)


@jax.jit
def rates(state, controls, gravity_harmonic):
    """By vectors and by angles, about an oblate planet in wind."""
    planet = dataclasses.replace(
        mars_planet(rotation_rate=MARS_ROTATION, wind=ConstantWind(30.0, -20.0, 5.0)),
        gravity=ZonalGravity(MU, RADIUS, {"j2": gravity_harmonic, "j3": 1e-4}),
        shape=Ellipsoid(RADIUS, 0.01),
    )
    vehicle = ballistic_vehicle(115.0, 0.18)
    return (
        VectorDynamics().rates(planet, vehicle, state, controls),
        entry_dynamics(planet, vehicle, state, controls),
    )


def test_rates_of_the_angles_are_those_of_entry_dynamics():
    draw = np.random.default_rng(20261129)
    for _ in range(20):
        low = [20e3, -7.0, -1.4, 300.0, -1.4, -7.0]
        high = [90e3, 7.0, 1.4, 7000.0, 1.4, 7.0]
        state = EntryState(*draw.uniform(low, high))
        bank = jnp.asarray(draw.uniform(-3, 3))
        controls = Controls.from_bank(bank, jnp.asarray(0.0))
        found, expected = rates(state, controls, jnp.asarray(2e-3))
        for one, other in zip(
            jax.tree.leaves(found), jax.tree.leaves(expected), strict=True
        ):
            # Rounding of terms that partly cancel, of 1e2 m/s2 and m/s.
            np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-13)


@jax.jit
def derivatives(numbers):
    """Of all rates of the vectors over the numbers of a state, first and second."""

    def flat(numbers):
        planet = mars_planet(
            rotation_rate=MARS_ROTATION, wind=ConstantWind(*jnp.zeros(3))
        )
        motion = VectorState.of(EntryState(*numbers))
        controls = Controls.from_bank(jnp.asarray(0.7), jnp.asarray(0.0))
        vehicle = ballistic_vehicle(115.0, 0.18)
        moved = VectorDynamics().motion_rates(planet, vehicle, motion, controls)
        seen = motion.entry_state
        return jnp.stack(jax.tree.leaves((moved.altitude, moved.velocity, seen)))

    forward, backward = jax.jacfwd(flat), jax.jacrev(flat)
    return forward(numbers), backward(numbers), jax.jacfwd(backward)(numbers)


@pytest.mark.parametrize("name", POINTS)
def test_derivatives_are_finite_everywhere(name):
    forward, backward, second = derivatives(jnp.asarray([50e3, *POINTS[name]]))
    np.testing.assert_allclose(forward, backward, rtol=1e-9, atol=1e-9)
    assert np.all(np.isfinite(second))
