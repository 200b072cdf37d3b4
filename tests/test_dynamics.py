"""Equations of motion against an independent twin in vectors, and other index forms."""

import cartesian
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_planet, mars_vehicle
from jax.flatten_util import ravel_pytree
from scipy.integrate import solve_ivp

from jentry.motion import (
    Controls,
    EntryState,
    energy,
    entry_dynamics,
    with_respect_to,
)
from jentry.units import degree, km
from jentry.world import ConstantWind


WIND = (60.0, -35.0, 4.0)


def draw(key):
    """A state anywhere, flying anywhere, and a bank angle."""
    low = [20 * km, -3.1, -80 * degree, 300.0, -60 * degree, -3.1, -3.1]
    high = [90 * km, 3.1, 80 * degree, 7000.0, 60 * degree, 3.1, 3.1]
    draws = jax.random.uniform(key, (7,), minval=jnp.array(low), maxval=jnp.array(high))
    *numbers, bank_angle = draws
    return EntryState(*numbers), bank_angle


@eqx.filter_jit
def rates_as_vectors(planet, state, bank_angle):
    """Position, velocity and their rates, from the entry dynamics by the chain rule."""
    controls = Controls(0.0, jnp.cos(bank_angle), jnp.sin(bank_angle))
    rates = entry_dynamics(planet, mars_vehicle(), state, controls)

    def vectors(state):
        return cartesian.from_entry_state(planet.radius, state)

    return jax.jvp(vectors, (state,), (rates,))


@pytest.mark.parametrize("rotation_rate", [0.0, 7.088e-5], ids=["still", "turning"])
@pytest.mark.parametrize("wind", [None, WIND], ids=["calm", "wind"])
def test_dynamics_equal_those_of_vectors(rotation_rate, wind, key):
    changes = {} if wind is None else {"wind": ConstantWind(*WIND)}
    planet = mars_planet(rotation_rate=rotation_rate, **changes)
    for each in jax.random.split(key, 25):
        state, bank_angle = draw(each)
        (position, velocity), rates = rates_as_vectors(planet, state, bank_angle)
        density = 0.0158 * np.exp(-float(state.altitude) / 9354.5)

        def drag(airspeed, density=density):
            return 0.5 * density * airspeed**2 / 115.0

        expected = cartesian.acceleration(
            np.asarray(position),
            np.asarray(velocity),
            gravitational_parameter=4.28283e13,
            rotation_rate=rotation_rate,
            wind=(0.0, 0.0, 0.0) if wind is None else wind,
            drag=drag,
            lift=lambda airspeed, drag=drag: 0.18 * drag(airspeed),
            bank_angle=float(bank_angle),
        )
        np.testing.assert_allclose(rates[0], velocity, rtol=0, atol=1e-12 * 7000.0)
        # Rounding: the rate of the velocity is a difference of terms such as V^2 / r
        # and, near the poles, V^2 tan(latitude) / r, which are larger than itself.
        scale = np.linalg.norm(expected) + 6.0 * float(state.velocity) ** 2 / 3.4e6
        error = np.linalg.norm(rates[1] - expected) / scale
        assert error < 1e-12, (error, state)


def test_flight_over_energy_is_flight_over_time():
    planet, vehicle = mars_planet(), mars_vehicle()
    controls = Controls(0.0, jnp.cos(0.9), jnp.sin(0.9))
    start = EntryState(60 * km, 0.1, 0.2, 6700.0, -12 * degree, 70 * degree)
    flat, unravel = ravel_pytree(start)

    def flow(state):
        return entry_dynamics(planet, vehicle, state, controls)

    def energy_of(state):
        return energy(planet, state)

    @jax.jit
    def over_time(y):
        return ravel_pytree(flow(unravel(y)))[0]

    @jax.jit
    def over_energy(y):
        return ravel_pytree(with_respect_to(flow, energy_of)(unravel(y)))[0]

    def solve(rate, span):
        how = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
        return solve_ivp(lambda x, y: np.asarray(rate(y)), span, flat, **how).y[:, -1]

    end = solve(over_time, (0.0, 80.0))
    energies = float(energy_of(start)), float(energy_of(unravel(jnp.asarray(end))))
    again = solve(over_energy, energies)
    # Two integrations at a tolerance of 1e-12, whose errors grow to some 100 times that.
    np.testing.assert_allclose(again, end, rtol=1e-9)
