"""CAV-H glide: the toolbox's numbers, its motion by scipy, and what its page says."""

import dataclasses
import functools

import cartesian
import jax.numpy as jnp
import numpy as np
import pytest
from first_sets import populations
from helpers import ConstantBank, fly_compiled, truths, with_leaf
from pages import assert_says
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from jentry._computed_once import computed_once
from jentry.flight import FixedStep, fly
from jentry.missions import find_mission
from jentry.motion.constraints import HeatRate, PathPoint
from jentry.motion.state import Controls
from jentry.units import degree, foot, km


MISSION = find_mission("cav-h-glide")
TOOLBOX = truths("cav_h_glide.csv")
EARTH, GLIDER, LIMITS = (TOOLBOX[name] for name in ("earth", "glider", "limits"))
ENTRY, TARGET = TOOLBOX["entry"], TOOLBOX["target"]
ROTATION = 7.292115e-5
"""rad/s, WGS 84"""


@computed_once
def scenario():
    return MISSION.scenario()


def unit(place):
    """From the centre of the Earth."""
    longitude, latitude = (
        place[f"{name}_deg"] * degree for name in ("longitude", "latitude")
    )
    level = np.cos(latitude)
    return np.array(
        [level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)]
    )


def energy(altitude, velocity):
    radius = EARTH["radius_m"] + altitude
    return 0.5 * velocity**2 - EARTH["gravitational_parameter_m3_s2"] / radius


END = energy(TARGET["altitude_m"], TARGET["velocity_m_s"])


def density(altitude):
    height = altitude / km
    return EARTH["surface_density_kg_m3"] * np.exp(
        -EARTH["inverse_scale_height_1_km"] * height
    )


def force(coefficient, altitude, airspeed):
    """m/s2"""
    area = GLIDER["reference_area_m2"] / GLIDER["mass_kg"]
    return 0.5 * density(altitude) * airspeed**2 * area * GLIDER[coefficient]


def test_the_numbers_are_those_of_the_toolbox():
    flown, bank = scenario(), TOOLBOX["bank"]
    planet, vehicle, state = flown.planet, flown.vehicle, flown.initial_state
    law, limits = flown.guidance, flown.constraints
    for ours, theirs in (
        (planet.radius, EARTH["radius_m"]),
        (
            planet.gravity.gravitational_parameter,
            EARTH["gravitational_parameter_m3_s2"],
        ),
        (planet.atmosphere.surface_density, EARTH["surface_density_kg_m3"]),
        (planet.atmosphere.scale_height, km / EARTH["inverse_scale_height_1_km"]),
        (planet.rotation_rate, ROTATION),
        (vehicle.mass, GLIDER["mass_kg"]),
        (vehicle.reference_area, GLIDER["reference_area_m2"]),
        (vehicle.aerodynamics.lift_coefficient, GLIDER["lift_coefficient"]),
        (vehicle.aerodynamics.drag_coefficient, GLIDER["drag_coefficient"]),
        (state.altitude, ENTRY["altitude_m"]),
        (state.longitude, ENTRY["longitude_deg"] * degree),
        (state.latitude, ENTRY["latitude_deg"] * degree),
        (state.velocity, ENTRY["velocity_m_s"]),
        (state.flight_path_angle, ENTRY["flight_path_angle_deg"] * degree),
        (state.heading, ENTRY["heading_deg"] * degree),
        (limits["load_factor"].limit, LIMITS["load_factor"]),
        (limits["dynamic_pressure"].limit, LIMITS["dynamic_pressure_kPa"] * km),
        (limits["heat_rate"].limit, LIMITS["heat_rate_kW_m2"] * km),
        (flown.target.altitude, TARGET["altitude_m"]),
        (flown.target.velocity, TARGET["velocity_m_s"]),
        (law.shape.final, bank["final_deg"] * degree),
        (law.shape.largest, bank["largest_deg"] * degree),
        (law.shape.largest * (1.0 - law.shape.first), bank["first_deg"] * degree),
        (law.shape.end, END),
        (law.end.energy, END),
        (flown.termination.conditions["energy"].energy, END),
    ):
        assert float(ours) == pytest.approx(theirs, rel=1e-13)


def test_the_heat_rate_is_that_of_the_toolbox_which_is_of_a_nose_of_one_foot():
    flown, formula = scenario(), TOOLBOX["heat_rate"]
    state = dataclasses.replace(flown.initial_state, altitude=jnp.asarray(50.0 * km))
    nothing = jnp.zeros(())
    level = Controls.from_bank(nothing, nothing)
    point = PathPoint.of(flown.planet, flown.vehicle, state, level)
    velocity, air = ENTRY["velocity_m_s"], density(50.0 * km)
    ours = float(HeatRate().value(point))
    power = velocity ** formula["exponent"]
    theirs = km * formula["coefficient"] * np.sqrt(air) * power
    assert ours == pytest.approx(theirs, rel=1e-12)
    # Detra, Kemp and Riddell: 17600 Btu/(ft2 s) at 26000 ft/s in air as at sea level, one
    # foot; a Btu is 1055.056 J. They print three digits.
    share = (velocity / (26_000.0 * foot)) ** 3.15 * np.sqrt(air / density(0.0))
    assert ours == pytest.approx(17_600.0 * 1055.056 / foot**2 * share, rel=2e-4)
    assert float(flown.vehicle.nose_radius) == foot


def test_the_target_is_its_point():
    radius, here, there = EARTH["radius_m"], unit(ENTRY), unit(TARGET)
    east = np.cross([0.0, 0.0, 1.0], here)
    east /= np.linalg.norm(east)
    heading = ENTRY["heading_deg"] * degree
    ahead = np.sin(heading) * east + np.cos(heading) * np.cross(here, east)
    target = scenario().target
    along = radius * np.arctan2(there @ ahead, there @ here)
    across = radius * np.arcsin(there @ np.cross(here, ahead))
    assert float(target.downrange) == pytest.approx(along, rel=1e-12)
    assert float(target.crossrange) == pytest.approx(across, rel=1e-9)
    arc = radius * np.arccos(here @ there) / km
    assert_says("a point 10970 km away", arc)


BANK = 65.0 * degree


def by_hand():
    """Down to the energy of the target at a bank to the right, by vectors."""
    radius = EARTH["radius_m"]

    def slope(_, y):
        high = np.linalg.norm(y[:3]) - radius
        air = {
            name: functools.partial(force, f"{name}_coefficient", high)
            for name in ("lift", "drag")
        }
        change = cartesian.acceleration(
            y[:3],
            y[3:],
            gravitational_parameter=EARTH["gravitational_parameter_m3_s2"],
            rotation_rate=ROTATION,
            wind=np.zeros(3),
            bank_angle=BANK,
            **air,
        )
        return np.concatenate([y[3:], change])

    def spent(_, y):
        return energy(np.linalg.norm(y[:3]) - radius, np.linalg.norm(y[3:])) - END

    spent.terminal = True
    here, velocity = unit(ENTRY), ENTRY["velocity_m_s"]
    east, north, up = cartesian.local_axes(here)
    heading, path = (
        ENTRY[f"{name}_deg"] * degree for name in ("heading", "flight_path_angle")
    )
    level = np.sin(heading) * east + np.cos(heading) * north
    start = np.concatenate(
        [
            (radius + ENTRY["altitude_m"]) * here,
            velocity * (np.cos(path) * level + np.sin(path) * up),
        ]
    )
    solved = solve_ivp(
        slope,
        (0.0, 4000.0),
        start,
        method="DOP853",
        rtol=1e-10,
        atol=1e-5,
        events=spent,
    )
    return solved.t[-1], solved.y[:3, -1], solved.y[3:, -1]


def test_the_motion_is_that_of_newtons_law():
    flown = with_leaf(scenario(), lambda s: s.guidance, ConstantBank(BANK))
    flight = fly_compiled(flown)
    time, place, velocity = by_hand()
    radius = EARTH["radius_m"]
    ours = cartesian.from_entry_state(radius, flight.state, np)
    # Steps of 0.5 s, of fourth order.
    assert float(flight.time) == pytest.approx(time, abs=1e-3)
    assert ours[0] == pytest.approx(place, abs=1.0)
    assert ours[1] == pytest.approx(velocity, abs=1e-2)


def glide(bank):
    """Altitude of the level glide to the east at the energy of the target, m."""
    _, _, up = unit(TARGET)
    eastward = 2.0 * ROTATION * np.sqrt(1.0 - up**2)

    def push(altitude):
        radius = EARTH["radius_m"] + altitude
        gravity = EARTH["gravitational_parameter_m3_s2"] / radius**2
        velocity = np.sqrt(2.0 * (END + gravity * radius))
        lift = force("lift_coefficient", altitude, velocity) * np.cos(bank)
        return lift + velocity**2 / radius + eastward * velocity - gravity

    return brentq(push, 10.0 * km, 40.0 * km)


@pytest.mark.slow
def test_the_nominal_flight_glides_as_the_toolbox_has_it():
    """Its bank goes from 70 to 60 degrees, and its altitude is that of the glide."""
    flight = fly(scenario(), FixedStep(), history=2.0)
    history = flight.history
    there = np.isfinite(history.time)
    time = np.asarray(history.time)[there]
    cosine, sine = (
        np.asarray(x)[there]
        for x in (history.controls.cos_bank, history.controls.sin_bank)
    )
    bank = np.degrees(np.arccos(cosine))
    # The last reversals leave the damping something to do, within 15 s of the end.
    assert np.median(bank[-30:]) == pytest.approx(60.0, abs=0.5)
    middle = (time > 800.0) & (time < 1200.0)
    assert bank[middle] == pytest.approx(69.0, abs=3.0)
    reversals = np.count_nonzero(np.diff(np.sign(sine[sine != 0.0])))
    assert_says("It reverses 8 times", reversals)
    end = flight.state
    spent = energy(float(end.altitude), float(end.velocity))
    assert spent == pytest.approx(END, rel=1e-9)
    # It descends by a degree, and to the south-east, where less of the rotation lifts it.
    assert float(end.altitude) == pytest.approx(glide(60.0 * degree), abs=200.0)


# What the pages say.


def saved(variant, heading, reading="everything"):
    return populations.saved()["cav-h-glide", variant, reading, heading]


def test_what_is_said_of_the_glide():
    every = [
        np.max(saved(variant, "miss over ground, maximum, km", reading))
        for variant, reading in populations.ROWS["cav-h-glide"]
        if "inertial" not in variant and "aided" not in variant
    ]
    runs = populations.SETS * 50 * len(every)
    assert_says(
        "All 6400 flights end within 0.8 km", runs, np.ceil(10.0 * max(every)) / 10.0
    )
    highest = glide(0.0) / km
    assert_says("29.6 km with all of the lift upwards", highest)
    assert_says("and 24.8 km at 60 degrees", glide(60.0 * degree) / km, 60.0)
    assert highest < TARGET["altitude_m"] / km
    ratio = GLIDER["lift_coefficient"] / GLIDER["drag_coefficient"]
    assert_says("907 kg and a lift-to-drag ratio of 3.28", GLIDER["mass_kg"], ratio)
