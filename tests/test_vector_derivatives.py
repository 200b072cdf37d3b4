"""Derivatives of flights as vectors, and flights about an oblate planet."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import oblate
import pytest
from external_cases import NOWHERE, ballistic_vehicle
from helpers import ConstantBank, fly_compiled
from vector_cases import SINGULAR, STEP

from jentry.flight import FixedStep, Scenario, Termination, fly
from jentry.motion import EntryState, VectorDynamics
from jentry.units import degree, km
from jentry.world import (
    ConstantWind,
    Ellipsoid,
    ExponentialAtmosphere,
    Planet,
    ZonalGravity,
)


DIFFERENTIATED = (
    "over a pole",
    "a fall from rest",
    "up and down",
    "in a head wind without lift",
)


@pytest.mark.slow
def test_derivatives_of_flights_agree_with_differences():
    cases = [SINGULAR[name] for name in DIFFERENTIATED]
    # One structure, so that one program serves all.
    scenarios = jax.tree.map(
        lambda *x: jnp.stack(x), *(case.scenario(VectorDynamics()) for case in cases)
    )
    starts = jnp.stack([jnp.stack(jax.tree.leaves(case.state)) for case in cases])

    def end(scenario, numbers):
        scenario = dataclasses.replace(scenario, initial_state=EntryState(*numbers))
        flight = fly(scenario, FixedStep(STEP))
        state = flight.state
        outward = jnp.cos(state.latitude)
        return jnp.stack(
            [
                state.altitude / km,
                state.velocity / 100.0,
                flight.time,
                1e3 * state.latitude,
                1e3 * jnp.sin(state.longitude) * outward,
            ]
        )

    @jax.jit
    def both(numbers):
        forward = jax.vmap(jax.jacfwd(end, 1))(scenarios, numbers)
        return forward, jax.vmap(jax.jacrev(end, 1))(scenarios, numbers)

    forward, backward = both(starts)
    np.testing.assert_allclose(forward, backward, rtol=1e-8, atol=1e-8)
    flown = jax.jit(lambda numbers: jax.vmap(end)(scenarios, numbers))
    for place, step in enumerate((1.0, 1e-5, 1e-5, 1e-2, 1e-5, 1e-5)):
        away = np.tile(step * np.eye(6)[place], (len(cases), 1))
        slope = (flown(starts + away) - flown(starts - away)) / (2.0 * step)
        # Second order in the step, of numbers of about one; and rounding over it.
        np.testing.assert_allclose(
            np.asarray(forward)[..., place], slope, rtol=2e-5, atol=2e-5
        )
    assert np.all(np.any(np.asarray(forward) != 0.0, axis=(1, 2)))


@pytest.mark.slow
@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (30.0, -20.0, 4.0)])
def test_an_oblate_planet_from_one_side_of_its_pole_to_the_other(wind):
    """With J2 to J4, geodetic altitude of the air, wind, lift and rotation."""
    start = EntryState(110 * km, 0.3, 86 * degree, 7600.0, -3 * degree, 0.4 * degree)
    planet = Planet(
        6371 * km,
        gravity=ZonalGravity(
            oblate.EARTH.parameter,
            oblate.EARTH.reference_radius,
            {f"j{n}": value for n, value in oblate.EARTH.harmonics.items()},
        ),
        atmosphere=ExponentialAtmosphere(1.225, 7200.0),
        rotation_rate=oblate.EARTH.rotation_rate,
        shape=Ellipsoid(oblate.EARTH.equatorial_radius, oblate.EARTH.flattening),
        wind=ConstantWind(*wind),
    )
    bank = 60 * degree
    scenario = Scenario(
        planet,
        ballistic_vehicle(300.0, 0.3),
        start,
        ConstantBank(bank),
        Termination({}, 250.0),
        NOWHERE,
        dynamics=VectorDynamics(),
        constraints={},
    )
    flight = fly_compiled(scenario, FixedStep(0.05))

    def drag(altitude, speed):
        return 0.5 * 1.225 * np.exp(-altitude / 7200.0) * speed**2 / 300.0

    lift = lambda altitude, speed: 0.3 * drag(altitude, speed)
    begin = oblate.as_vectors(oblate.EARTH, 6371 * km, start, 0.0)
    expected = oblate.flown(oblate.EARTH, *begin, 250.0, drag, lift, bank, wind)
    position, velocity = oblate.as_vectors(oblate.EARTH, 6371 * km, flight.state, 250.0)
    assert flight.state.latitude < 86 * degree
    assert np.cos(flight.state.longitude - start.longitude) < 0.0
    # A wind of 30 m/s turns by half a turn within the two steps about the pole.
    close = 1e-4 if any(wind) else 1e-5
    assert np.linalg.norm(position - expected[0]) < close
    assert np.linalg.norm(velocity - expected[1]) < close
