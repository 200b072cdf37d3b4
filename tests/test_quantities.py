"""Quantities of a flight against numbers by hand: air, loads, heat, arcs on the ground."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    ahead,
    fly_compiled,
    free_scenario,
    mars_entry,
    mars_planet,
    mars_vehicle,
)
from worlds import ANGLES, MACHS, all_gravities, tabulated_aerodynamics

from jentry.flight import FixedStep, Termination
from jentry.guidance import BankProfile
from jentry.motion import (
    AirData,
    Controls,
    EntryState,
    air_data,
    convective_heat_rate,
    detra_kemp_riddell_heat_rate,
    energy,
    entry_dynamics,
    equatorial_dynamics,
    from_ground_track,
    ground_track,
    load_factor,
)
from jentry.onboard import OnboardModel, PolynomialProfile
from jentry.units import degree, km
from jentry.world import (
    AbstractAerodynamics,
    ConstantWind,
    ExponentialAtmosphere,
    Planet,
    PolynomialAerodynamics,
    Vehicle,
)


def scalars(*numbers):
    return [jnp.asarray(x, float) for x in numbers]


# Heat and load.


@pytest.mark.parametrize(
    ("exponent", "expected"),
    [
        # 1.9027e-4 sqrt(4e-4 / 0.25) 5000^3 = 1.9027e-4 0.04 1.25e11
        (3, 951_350.0),
        # and 5000^3.5 = 1.25e11 sqrt(5000)
        (3.5, 951_350.0 * 70.71067811865476),
    ],
)
def test_heat_rate_of_sutton_and_graves(exponent, expected):
    found = convective_heat_rate(*scalars(4e-4, 5000.0, 0.25, 1.9027e-4), exponent)
    assert float(found) == pytest.approx(expected, rel=1e-14)


def test_heat_rate_of_detra_kemp_and_riddell():
    """1.1037e8 / sqrt(0.25) sqrt(0.01) at circular speed; 2^3.15 is 8.876555777."""
    at = {"density": 0.01225, "nose_radius": 0.25, "surface_density": 1.225}
    at = {name: jnp.asarray(value) for name, value in at.items()}
    for velocity, factor in ((7925.0, 1.0), (15850.0, 8.876555777)):
        speeds = {"velocity": velocity, "circular_velocity": 7925.0}
        speeds = {name: jnp.asarray(value) for name, value in speeds.items()}
        found = detra_kemp_riddell_heat_rate(**at, **speeds)
        assert float(found) == pytest.approx(2.2074e7 * factor, rel=1e-9)


def test_load_factor_is_of_lift_and_drag_in_standard_gravities():
    air = AirData(*scalars(1e-3, 5e3, 1.2e4, 15.0, 3.0, 4.0, 0.0))
    assert float(load_factor(air)) == pytest.approx(5.0 / 9.80665, rel=1e-15)


# The flow in wind.

WIND = (80.0, -35.0, 6.0)
STATE = EntryState(31 * km, 0.3, 0.5, 1900.0, -11 * degree, 70 * degree)


def windy():
    return mars_planet(wind=ConstantWind(*WIND), density_scale=1.3)


def flow():
    """Airspeed and density by hand: velocity to east, north and up, less the wind."""
    path, heading = -11 * degree, 70 * degree
    level = 1900.0 * np.cos(path)
    over = np.array(
        [level * np.sin(heading), level * np.cos(heading), 1900.0 * np.sin(path)]
    )
    airspeed = np.linalg.norm(over - np.array(WIND))
    return airspeed, 1.3 * 0.0158 * np.exp(-31e3 / 9354.5)


def test_mach_number_and_pressure_are_of_the_airspeed():
    """Tables see the Mach number over the air: also the one that a law measures."""
    table = tabulated_aerodynamics()
    vehicle = Vehicle(992.0, 16.0, aerodynamics=table, lift_scale=0.9, drag_scale=1.1)
    angle = jnp.asarray(13 * degree)
    air = air_data(windy(), vehicle, STATE, angle)
    airspeed, density = flow()
    assert abs(airspeed - 1900.0) > 50.0
    sound = np.sqrt(1.4 * 287.05287 * 246.0)
    expected = {
        "airspeed": airspeed,
        "density": density,
        "dynamic_pressure": 0.5 * density * airspeed**2,
        "mach": airspeed / sound,
    }
    for name, value in expected.items():
        assert float(getattr(air, name)) == pytest.approx(value, rel=1e-13), name
    assert ANGLES[0] < angle < ANGLES[-1] and MACHS[0] < air.mach < MACHS[-1]
    mach, speed = scalars(airspeed / sound, airspeed)
    lift, drag = table.coefficients(angle, mach, speed)
    force = 0.5 * density * airspeed**2 * 16.0 / 992.0
    assert float(air.lift) == pytest.approx(0.9 * float(lift) * force, rel=1e-12)
    assert float(air.drag) == pytest.approx(1.1 * float(drag) * force, rel=1e-12)


def test_a_fit_over_airspeed_is_of_the_airspeed():
    class Linear(AbstractAerodynamics):
        def coefficients(self, angle_of_attack, mach, airspeed):
            return 1e-3 * airspeed, 2e-3 * airspeed

    vehicle = Vehicle(992.0, 16.0, aerodynamics=Linear())
    air = air_data(windy(), vehicle, STATE, jnp.asarray(0.0))
    airspeed, density = flow()
    assert float(air.drag) == pytest.approx(
        0.5 * density * airspeed**3 * 2e-3 * 16.0 / 992.0, rel=1e-12
    )


@pytest.mark.parametrize("rotation_rate", [0.0, 7.088e-5, -2e-4])
@pytest.mark.parametrize("wind", [None, (80.0, 0.0, 6.0)], ids=["calm", "wind"])
def test_flight_along_the_equator_is_flight_at_latitude_zero(rotation_rate, wind):
    changes = {} if wind is None else {"wind": ConstantWind(*wind)}
    planet = mars_planet(rotation_rate=rotation_rate, **changes)
    # The lateral force is the one thing that it leaves out.
    for path, cos_bank in ((-14.0, 0.4), (6.0, -0.8)):
        state = EntryState(41 * km, 0.3, 0.0, 5300.0, path * degree, 90 * degree)
        banked = Controls(0.0, cos_bank, np.sqrt(1.0 - cos_bank**2))
        level = Controls(0.0, cos_bank, 0.0)
        vehicle = mars_vehicle()
        in_plane = equatorial_dynamics(planet, vehicle, state, banked)
        free = entry_dynamics(planet, vehicle, state, level)
        for name, rate in vars(free).items():
            ours = float(getattr(in_plane, name))
            # Sums of terms up to 15 m/s2, over 5300 m/s; cos(90 deg) is 6e-17.
            close = 1e-12 if name in ("altitude", "velocity") else 1e-16
            assert ours == pytest.approx(float(rate), rel=1e-13, abs=close), name
        assert (in_plane.latitude, in_plane.heading) == (0.0, 0.0)


# What a flight keeps of its constraints.


@pytest.mark.slow
def test_constraints_of_a_flight_are_those_of_its_states():
    """At the angle of attack that is flown, over the air, with this planet's heat."""
    aerodynamics = PolynomialAerodynamics([0.1, 0.8], [0.4, 0.0, 0.9])
    planet = Planet(
        3397 * km,
        gravity=mars_planet().gravity,
        atmosphere=ExponentialAtmosphere(0.0158, 9354.5),
        wind=ConstantWind(*WIND),
        heating_coefficient=2e-6,
        heating_exponent=3.4,
    )
    vehicle = Vehicle(
        992.0,
        16.0,
        aerodynamics=aerodynamics,
        trim_angle_of_attack=0.02,
        nose_radius=0.36,
    )
    law = BankProfile(PolynomialProfile([0.5]), angle_of_attack=0.25)
    scenario = dataclasses.replace(
        free_scenario(),
        planet=planet,
        vehicle=vehicle,
        guidance=law,
        termination=Termination({}, 100.0),
    )
    flight = fly_compiled(scenario, FixedStep(1.0), 20.0)
    history = jax.tree.map(np.asarray, flight.history)
    path, heading = history.states.flight_path_angle, history.states.heading
    level = history.states.velocity * np.cos(path)
    over = [level * np.sin(heading), level * np.cos(heading)]
    over = np.stack([*over, history.states.velocity * np.sin(path)])
    airspeed = np.linalg.norm(over - np.array(WIND)[:, None], axis=0)
    density = 0.0158 * np.exp(-history.states.altitude / 9354.5)
    pressure = 0.5 * density * airspeed**2
    lift, drag = (
        c * pressure * 16.0 / 992.0 for c in (0.1 + 0.8 * 0.25, 0.4 + 0.9 * 0.25 * 0.25)
    )
    expected = {
        "drag": drag,
        "dynamic_pressure": pressure,
        "heat_rate": 2e-6 * np.sqrt(density / 0.36) * airspeed**3.4,
        "load_factor": np.hypot(lift, drag) / 9.80665,
    }
    assert len(airspeed) == 5
    for name, values in expected.items():
        found = getattr(history.constraints, name)
        np.testing.assert_allclose(found, values, rtol=1e-12, err_msg=name)
        # Everything still grows after 100 s: the peak is the last value or later.
        assert getattr(flight.peaks, name) >= np.max(values)
    np.testing.assert_allclose(history.controls.angle_of_attack, 0.25)


# Energy, arcs, and what the onboard model says of itself.


@pytest.mark.parametrize("name", all_gravities)
def test_energy_is_kinetic_and_potential(name):
    gravity = all_gravities[name]()
    planet = eqx.tree_at(lambda p: p.gravity, mars_planet(), gravity)
    radius = 3397e3 + 31e3
    newton, s, ratio = -4.28283e13 / radius, np.sin(STATE.latitude), 3396e3 / radius
    j2 = 1.9566e-3 * ratio**2 * (1.5 * s**2 - 0.5)
    j3 = 3.1e-5 * ratio**3 * (2.5 * s**3 - 1.5 * s)
    potential = {
        "inverse square": newton,
        "constant": 3.7 * radius,
        "zonal": newton * (1.0 - j2 - j3),
    }
    expected = 0.5 * 1900.0**2 + potential[name]
    assert float(energy(planet, STATE)) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("start", [(0.0, 0.0), (20.0, 35.0), (-170.0, -60.0)])
@pytest.mark.parametrize("heading", [90.0, 60.0, -120.0, 5.0])
def test_ground_track_is_ahead_and_to_the_left(start, heading):
    """Along the great circle first, then across it at a right angle."""
    planet = mars_planet()
    angles = scalars(*np.radians([*start, heading]))
    longitude, latitude, heading_angle = angles
    origin = EntryState(50 * km, longitude, latitude, 5e3, 0.0, heading_angle)
    for along, left in ((11.0, 0.0), (11.0, 2.0), (30.0, -3.0), (100.0, 1.0)):
        *foot, there = ahead(start, heading, along)
        *place, _ = ahead(foot, there - 90.0, left)
        state = EntryState(
            0.0, *scalars(*np.radians(place)), 1e3, 0.0, jnp.asarray(0.0)
        )
        found = np.array([float(x) for x in ground_track(planet, origin, state)])
        # On the surface, wherever above it the vehicle is.
        expected = np.radians([along, left]) * 3397e3
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-7)
        back = np.degrees(from_ground_track(planet, origin, *scalars(*expected)))
        turned = (back[0] - place[0] + 180.0) % 360.0 - 180.0
        np.testing.assert_allclose([turned, back[1] - place[1]], 0.0, atol=1e-11)


def test_the_pole_has_its_latitude_from_everywhere():
    """Also where rounding makes its sine a little more than 1."""
    planet, latitudes = mars_planet(), np.linspace(-80.0, 80.0, 2001) * degree

    @jax.vmap
    def of_the_pole(latitude):
        origin = EntryState(*scalars(0.0, 0.0), latitude, *scalars(5e3, 0.0, 0.0))
        north = planet.radius * (0.5 * np.pi - latitude)
        return from_ground_track(planet, origin, north, jnp.zeros_like(latitude))[1]

    # An angle is as far from it as the root of twice what its sine lacks.
    np.testing.assert_allclose(of_the_pole(latitudes), 0.5 * np.pi, atol=5e-8)


def test_what_the_onboard_model_says_of_itself():
    aerodynamics = PolynomialAerodynamics([0.1, 0.8], [0.4, 0.0, 0.9])
    vehicle = Vehicle(
        900.0,
        15.0,
        aerodynamics=aerodynamics,
        trim_angle_of_attack=0.2,
        lift_scale=0.9,
        drag_scale=1.2,
    )
    model = OnboardModel(mars_planet(), vehicle)
    lift, drag = 0.9 * 0.26, 1.2 * 0.436
    state, angle = mars_entry(), jnp.asarray(0.2)
    assert float(model.lift_to_drag(state, angle)) == pytest.approx(
        lift / drag, rel=1e-14
    )
    expected = 900.0 / (drag * 15.0)
    assert float(model.ballistic_coefficient(state, angle)) == pytest.approx(
        expected, rel=1e-14
    )
    height = float(model.scale_height(state))
    assert height == pytest.approx(9354.5, rel=1e-14)


@pytest.mark.parametrize("sine", [0.6, -0.6, 0.0])
def test_bank_angle_has_the_side_of_its_sine(sine):
    for cosine in (0.8, -0.8):
        size = np.hypot(cosine, sine)
        controls = Controls(0.0, cosine / size, sine / size)
        expected = np.arctan2(sine, cosine)
        assert float(controls.bank_angle) == pytest.approx(expected, rel=1e-14)
