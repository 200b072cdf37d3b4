"""Several quantities of a flight over energy: found once, read once, with their error."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_planet, mars_vehicle

from jentry.motion import air_data
from jentry.motion.index import EnergyIndex
from jentry.onboard import OnboardModel, Reference, measure


def drag(time, state):
    return air_data(mars_planet(), mars_vehicle(), state, jnp.zeros_like(time)).drag


def quantities(time, state):
    return {
        "drag": drag(time, state),
        "altitude": state.altitude,
        "flight_path_angle": state.flight_path_angle,
    }


@eqx.filter_jit
def tabulated(flight, power):
    index = EnergyIndex()
    table = flight.tabulate(quantities, index, 2000, None, power)
    return table, flight.interpolation_error(table, quantities, index)


@pytest.mark.slow
@pytest.mark.parametrize(("power", "least", "most"), [(1, 5e-3, 1e-2), (2, 0.0, 2e-7)])
def test_the_error_of_a_table_is_stated(planned, power, least, most):
    """Of the drag, m/s2: the first of 2000 even intervals lasts 25 s of the entry."""
    table, error = tabulated(planned[1], power)
    assert set(error) == {"drag", "altitude", "flight_path_angle"}
    assert least <= float(error["drag"]) < most
    # It is the distance of the table from the flight, also by states of the flight.
    flight = planned[1]
    times, states = jax.tree.map(lambda x: x[5:2200:7], (flight.times, flight.states))

    @jax.jit
    @jax.vmap
    def distance(time, state):
        read = table.with_derivatives(EnergyIndex().value(mars_planet(), time, state))
        return read["drag"][0] - drag(time, state)

    found = float(jnp.max(jnp.abs(distance(times, states))))
    # Rounding of the energy, 1e-9 of its interval, and 300 states in place of the middles.
    assert found < 1.1 * float(error["drag"]) + 1e-7


@pytest.mark.slow
def test_a_reference_has_the_rates_of_its_quantities(planned):
    """On its own flight: of the altitude V sin(gamma), of the drag its own."""
    flight = planned[1]
    reference = Reference(EnergyIndex(), tabulated(flight, 2)[0])
    model = OnboardModel(mars_planet(), mars_vehicle())
    times, states = jax.tree.map(
        lambda x: x[300:2200:37], (flight.times, flight.states)
    )

    @jax.jit
    @jax.vmap
    def read(time, state):
        zero = 0.0 * time
        measurement = measure(model.planet, model.vehicle, state, zero)
        found = reference.at(time, measurement, model, zero)
        climb = state.velocity * jnp.sin(state.flight_path_angle)
        return found, (measurement.drag, state.altitude, climb)

    found, (there, altitude, climb) = read(times, states)
    np.testing.assert_allclose(found["drag"].value, there, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found["altitude"].value, altitude, rtol=0, atol=1e-3)
    # m/s; the error of the value, over an interval of 0.1 s.
    np.testing.assert_allclose(found["altitude"].rate, climb, rtol=0, atol=1e-2)
