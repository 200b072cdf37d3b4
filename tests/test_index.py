"""Indices of a reference: their values, and their rates by forward differentiation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, mars_entry, mars_planet, mars_scenario, mars_vehicle
from laws import observer_law
from worlds import all_atmospheres, all_gravities, tabulated_aerodynamics

from jentry._math import derivatives_along
from jentry.flight import FixedStep, Outcome
from jentry.guidance.drag_tracking import _expanded, drag_dynamics
from jentry.motion import Controls, EntryState, air_data, entry_dynamics
from jentry.motion.index import (
    AbstractIndex,
    AltitudeIndex,
    DownrangeIndex,
    EnergyIndex,
    TimeIndex,
    VelocityIndex,
)
from jentry.onboard import Measurement, OnboardModel, index_motion, measure
from jentry.onboard.flow import sensed_flow, twice_along
from jentry.planning import open_loop
from jentry.planning.reference_flight import (
    ReferenceFlight,
    plan_drag_reference,
)
from jentry.units import degree, km
from jentry.world import (
    ExponentialAtmosphere,
    Planet,
    TabulatedAerodynamics,
    TabulatedAtmosphere,
    Vehicle,
)


ANGLE = 0.2


class MachIndex(AbstractIndex):
    """A user's own, in three lines."""

    def value(self, planet, time, state):
        here = planet.above(state.longitude, state.latitude)
        return state.velocity / here.atmosphere.speed_of_sound(state.altitude)


class DynamicPressureIndex(AbstractIndex):
    def value(self, planet, time, state):
        velocity = state.velocity
        here = planet.above(state.longitude, state.latitude)
        return jnp.log(here.density(state.altitude) * velocity * velocity)


def states(key, count):
    low = jnp.array([15 * km, -0.5, -0.5, 500.0, -40 * degree, 0.5])
    high = jnp.array([90 * km, 0.5, 0.5, 7000.0, 10 * degree, 2.5])
    draws = jax.random.uniform(key, (count, 6), minval=low, maxval=high)
    return EntryState(*draws.T)


def test_values_of_the_indices():
    planet, state = mars_planet(), mars_entry()
    far = eqx.tree_at(lambda s: s.longitude, state, jnp.asarray(0.125))
    expected = [
        (TimeIndex(), 12.0),
        (VelocityIndex(), 6750.0),
        (EnergyIndex(), 0.5 * 6750.0**2 - 4.28283e13 / (3397e3 + 126.1e3)),
        (AltitudeIndex(), 126.1e3),
        (DownrangeIndex(state), 0.125 * 3397e3),
    ]
    for index, value in expected:
        found = float(index.value(planet, jnp.asarray(12.0), far))
        assert found == pytest.approx(value, rel=1e-14)


# The forms expanded by hand that forward differentiation has taken the place of.


def energy_by_hand(model, measurement, rate, lift):
    state, drag = measurement.state, measurement.drag
    sin = jnp.sin(state.flight_path_angle)
    gravity = model.planet.gravity.acceleration(model.planet.radius + state.altitude)
    drift = -rate * state.velocity - drag * (-drag - gravity * sin)
    return -drag * state.velocity, drift, 0.0 * drag


def velocity_by_hand(model, measurement, rate, lift):
    state, drag = measurement.state, measurement.drag
    velocity, path = state.velocity, state.flight_path_angle
    sin, cos = jnp.sin(path), jnp.cos(path)
    radius = model.planet.radius + state.altitude
    gravity = model.planet.gravity.acceleration(radius)
    turn = (velocity / radius - gravity / velocity) * cos
    gravity_rate = -2.0 * gravity * velocity * sin / radius
    drift = -rate - gravity_rate * sin - gravity * cos * turn
    return -drag - gravity * sin, drift, -gravity * cos * lift / velocity


@pytest.mark.parametrize(
    ("index", "by_hand"),
    [(EnergyIndex(), energy_by_hand), (VelocityIndex(), velocity_by_hand)],
    ids=["energy", "velocity"],
)
def test_rates_are_those_expanded_by_hand(index, by_hand, key):
    """With a drag of 1.3 times the modelled one, which is what a law senses."""
    planet, vehicle = mars_planet(), mars_vehicle()
    model = OnboardModel(planet, vehicle)

    @jax.jit
    @jax.vmap
    def both(state):
        zero = 0.0 * state.altitude
        drag = 1.3 * air_data(planet, vehicle, state, zero).drag
        measurement = Measurement(state, 0.4 * drag, drag, zero, zero)
        rate = drag_dynamics(model, measurement, zero).rate
        found = index_motion(index, zero, measurement, model, zero, rate)
        lift = 0.18 * drag
        return (found.rate, found.drift, found.gain), by_hand(
            model, measurement, rate, lift
        )

    found, expected = both(states(key, 100))
    rate, drift, _ = expected
    for one, other, size in zip(found, expected, (rate, drift, drift), strict=True):
        # Rounding: gravity cancels in the rates of the energy, whose gain is zero.
        close = 1e-12 * np.max(np.abs(size))
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=close)


def test_drag_dynamics_are_equations_8_9_and_11(key):
    """By forward differentiation, with 1.3 times the modelled drag."""
    planet, vehicle = mars_planet(), mars_vehicle()
    model = OnboardModel(planet, vehicle)

    @jax.jit
    @jax.vmap
    def both(state):
        zero = 0.0 * state.altitude
        drag = 1.3 * air_data(planet, vehicle, state, zero).drag
        measurement = Measurement(state, drag, drag, zero, zero)
        lift = 0.18 * drag
        flow = sensed_flow(model, zero)
        found = twice_along(flow, lambda p: p.drag, measurement, zero, lift)
        return found, _expanded(model, measurement, lift)

    found, expected = both(states(key, 100))
    for name in ("value", "rate", "drift", "gain"):
        one, other = getattr(found, name), getattr(expected, name)
        # Rounding of sums whose terms cancel.
        scale = np.abs(expected.drift) if name == "drift" else np.abs(other)
        size = scale + (np.abs(found.rate) if name == "rate" else 0.0)
        np.testing.assert_allclose(one / size, other / size, rtol=0, atol=1e-12)


# Any atmosphere, gravity and aerodynamics.


def any_vehicle():
    return Vehicle(
        992.0,
        16.0,
        aerodynamics=tabulated_aerodynamics(),
        trim_angle_of_attack=ANGLE,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("atmosphere", "gravity"),
    [
        ("exponential", "constant"),
        ("standard", "inverse square"),
        ("table", "inverse square"),
        ("perturbed", "constant"),
        ("exponential", "zonal"),
    ],
)
def test_rates_are_those_along_the_motion(atmosphere, gravity, key):
    """Of any index and of the drag, by the equations of motion of the package."""
    gravity, atmosphere = all_gravities[gravity](), all_atmospheres[atmosphere]()
    planet = Planet(3397 * km, gravity=gravity, atmosphere=atmosphere)
    model = OnboardModel(planet, any_vehicle())
    origin = mars_entry()
    indices = MachIndex(), DynamicPressureIndex(), DownrangeIndex(origin), EnergyIndex()

    @jax.jit
    @jax.vmap
    def both(state, cos_bank):
        zero = 0.0 * cos_bank
        angle = zero + ANGLE
        controls = Controls(angle, cos_bank, zero)

        def flow(point):
            time, state = point
            rates = entry_dynamics(planet, model.vehicle, state, controls)
            return jnp.ones_like(time), rates

        def quantities(point):
            values = [index.value(planet, *point) for index in indices]
            air = air_data(planet, model.vehicle, point[1], angle)
            return jnp.stack([*values, air.drag])

        measurement = measure(planet, model.vehicle, state, angle)
        motions = [
            index_motion(index, zero, measurement, model, angle) for index in indices
        ]
        motions.append(drag_dynamics(model, measurement, angle))
        found = [(m.value, m.rate, m.drift + m.gain * cos_bank) for m in motions]
        exact = derivatives_along(flow, quantities, (zero, state))
        return jnp.asarray(found).T, jnp.stack(exact)

    found, exact = both(states(key, 40), jnp.linspace(-0.9, 0.9, 40))
    # Rounding of sums whose terms cancel.
    scale = np.max(np.abs(exact), axis=0, keepdims=True)
    np.testing.assert_allclose(found / scale, exact / scale, rtol=1e-9, atol=1e-12)


class PathIndex(AbstractIndex):
    def value(self, planet, time, state):
        return state.flight_path_angle


def test_an_index_whose_rate_contains_the_bank_is_refused():
    model = OnboardModel(mars_planet(), mars_vehicle())
    zero = jnp.asarray(0.0)
    measurement = measure(model.planet, model.vehicle, mars_entry(), zero)
    with pytest.raises(ValueError, match="PathIndex depends on the flight-path angle"):
        index_motion(PathIndex(), zero, measurement, model, zero)


def wavy_atmosphere():
    """That of Mars as a table, with a scale height that changes by half."""
    altitudes = jnp.linspace(0.0, 130e3, 66)
    waves = 1.0 + 0.2 * jnp.sin(altitudes / 12e3)
    return TabulatedAtmosphere(altitudes, 0.0158 * jnp.exp(-altitudes / 9354.5) * waves)


def lander_with_drag_rise():
    machs = jnp.asarray([0.5, 2.0, 5.0, 30.0])
    drag = jnp.asarray([0.62, 0.60, 0.55, 0.54])
    lift = jnp.asarray([0.09, 0.10, 0.11, 0.10])
    angles = jnp.asarray([-0.5, 0.5])
    aerodynamics = TabulatedAerodynamics(
        angles, machs, jnp.stack([lift, lift]), jnp.stack([drag, drag])
    )
    return Vehicle(992.0, 16.0, aerodynamics=aerodynamics)


@pytest.mark.slow
def test_drag_is_tracked_in_any_atmosphere_with_any_aerodynamics():
    """With a table of the atmosphere, and lift and drag over the Mach number.

    The law flies to where its reference does, open loop.
    """
    planet = Planet(
        3397 * km, gravity=mars_planet().gravity, atmosphere=wavy_atmosphere()
    )
    vehicle = lander_with_drag_rise()
    scenario = eqx.tree_at(
        lambda s: (s.planet, s.vehicle), mars_scenario(), (planet, vehicle)
    )
    profile = scenario.guidance.cos_bank
    flight = ReferenceFlight.of(open_loop(scenario, profile, 400.0), 0.2)
    reference = eqx.filter_jit(plan_drag_reference)(flight, EnergyIndex(), 0.0, 500, 2)
    law = observer_law(reference)
    law = eqx.tree_at(lambda law: law.model, law, OnboardModel(planet, vehicle))
    planned = open_loop(scenario, profile, 503.0)
    tracked = eqx.tree_at(lambda s: s.guidance, planned, law)
    ends = []
    for flown in (planned, tracked):
        ended = fly_compiled(flown, FixedStep(0.2))
        assert ended.outcome == Outcome.REACHED
        ends.append(float(ended.state.longitude) * 3397e3)
    # m; what the observer leaves of a reference that it has to learn the rate of.
    assert abs(ends[1] - ends[0]) < 100.0, ends


def test_scale_height_is_that_of_the_atmosphere():
    table = OnboardModel(
        Planet(
            3397 * km,
            gravity=mars_planet().gravity,
            atmosphere=ExponentialAtmosphere(0.0158, 9354.5),
            density_scale=1.4,
        ),
        mars_vehicle(),
    )
    there = jax.tree.map(jnp.asarray, EntryState(40e3, 0.0, 0.0, 5e3, 0.0, 0.0))
    found = float(table.scale_height(there))
    assert found == pytest.approx(9354.5, rel=1e-14)
