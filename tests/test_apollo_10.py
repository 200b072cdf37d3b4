"""Apollo 10: the toolbox's numbers, its motion by scipy, and what its page says."""

import numpy as np
import pytest
from entry_vectors import axes, velocity_of
from first_sets import populations
from helpers import ConstantBank, fly_compiled, truths, with_leaf
from pages import PAGES, assert_says
from scipy.integrate import solve_ivp

from jentry._computed_once import computed_once
from jentry.missions import find_mission
from jentry.units import degree, foot, km, slug


MISSION = find_mission("apollo-10")
TOOLBOX = truths("apollo_10.csv")
ROTATION = 7.292115e-5
"""rad/s, WGS 84"""


@computed_once
def scenario():
    return MISSION.scenario()


def start():
    """Place and velocity of the entry, relative to the Earth, by vectors."""
    printed = TOOLBOX["entry"]
    angles = {
        k.removesuffix("_deg"): v * degree
        for k, v in printed.items()
        if k.endswith("_deg")
    }
    frame = axes(angles["longitude"], angles["latitude"])
    place = printed["radius_m"] * frame[0]
    inertial = velocity_of(
        frame,
        printed["velocity_m_s"],
        angles["flight_path_angle"],
        angles["heading"],
    )
    return place, inertial - np.cross([0.0, 0.0, ROTATION], place)


def test_the_numbers_are_those_of_the_toolbox():
    flown, earth, capsule = scenario(), TOOLBOX["earth"], TOOLBOX["capsule"]
    planet, vehicle, heating = flown.planet, flown.vehicle, TOOLBOX["heating"]
    scale_height = km / earth["inverse_scale_height_1_km"]
    unit = heating["kW_m2_per_Btu_ft2_s"] * km
    of_velocity = heating["of_velocity_in_km_s_Btu_ft2_s"] / km**3
    limits, target = TOOLBOX["limits"], TOOLBOX["target"]
    for ours, theirs in (
        (planet.radius, earth["radius_m"]),
        (
            planet.gravity.gravitational_parameter,
            earth["gravitational_parameter_m3_s2"],
        ),
        (planet.atmosphere.surface_density, earth["surface_density_kg_m3"]),
        (planet.atmosphere.scale_height, scale_height),
        (planet.heating_coefficient, unit * of_velocity),
        (vehicle.nose_radius, 1.0),
        (vehicle.mass, capsule["mass_kg"]),
        (vehicle.reference_area, capsule["reference_area_m2"]),
        (vehicle.aerodynamics.lift_coefficient, capsule["lift_coefficient"]),
        (vehicle.aerodynamics.drag_coefficient, capsule["drag_coefficient"]),
        (flown.constraints["load_factor"].limit, limits["load_factor"]),
        (
            flown.constraints["dynamic_pressure"].limit,
            limits["dynamic_pressure_kPa"] * km,
        ),
        (flown.constraints["heat_rate"].limit, limits["heat_rate_kW_m2"] * km),
        (flown.target.altitude, target["altitude_m"]),
        (flown.target.velocity, target["velocity_m_s"]),
    ):
        assert float(ours) == pytest.approx(theirs, rel=1e-14)


def test_the_entry_relative_to_the_earth_is_that_of_its_vectors():
    place, velocity = start()
    state = scenario().initial_state
    altitude, longitude, latitude, speed, path, heading = (
        float(getattr(state, name))
        for name in (
            "altitude",
            "longitude",
            "latitude",
            "velocity",
            "flight_path_angle",
            "heading",
        )
    )
    frame = axes(longitude, latitude)
    radius = altitude + TOOLBOX["earth"]["radius_m"]
    assert radius * frame[0] == pytest.approx(place, abs=1e-6)
    ours = velocity_of(frame, speed, path, heading)
    assert ours == pytest.approx(velocity, abs=1e-8)


def test_the_target_is_its_point():
    flown, printed = scenario(), TOOLBOX["target"]
    # By vectors: ahead of the velocity relative to the Earth, and to its left.
    radius, (place, velocity) = TOOLBOX["earth"]["radius_m"], start()
    up = place / np.linalg.norm(place)
    level = velocity - (velocity @ up) * up
    ahead = level / np.linalg.norm(level)
    to, *_ = axes(*(printed[f"{n}_deg"] * degree for n in ("longitude", "latitude")))
    along = radius * np.arctan2(to @ ahead, to @ up)
    across = radius * np.arcsin(to @ np.cross(up, ahead))
    assert float(flown.target.downrange) == pytest.approx(along, rel=1e-12)
    assert float(flown.target.crossrange) == pytest.approx(across, rel=1e-9)


BANK = 60.0 * degree


def by_hand():
    """Down to the altitude of the end at a bank to the right: vectors, Coriolis and all."""
    earth, capsule = TOOLBOX["earth"], TOOLBOX["capsule"]
    spin = np.array([0.0, 0.0, ROTATION])
    area = capsule["reference_area_m2"] / capsule["mass_kg"]

    def slope(_, y):
        place, velocity = y[:3], y[3:]
        radius, speed = np.linalg.norm(place), np.linalg.norm(velocity)
        height = (radius - earth["radius_m"]) / km
        density = earth["surface_density_kg_m3"] * np.exp(
            -earth["inverse_scale_height_1_km"] * height
        )
        pressure = 0.5 * density * speed**2 * area
        along, up = velocity / speed, place / radius
        right = np.cross(along, up)
        right /= np.linalg.norm(right)
        lift = np.cos(BANK) * np.cross(right, along) + np.sin(BANK) * right
        air = pressure * (
            capsule["lift_coefficient"] * lift - capsule["drag_coefficient"] * along
        )
        gravity = -earth["gravitational_parameter_m3_s2"] / radius**2 * up
        turning = -2.0 * np.cross(spin, velocity) - np.cross(
            spin, np.cross(spin, place)
        )
        return np.concatenate([velocity, air + gravity + turning])

    def low(_, y):
        return (
            np.linalg.norm(y[:3]) - earth["radius_m"] - TOOLBOX["target"]["altitude_m"]
        )

    low.terminal = True
    solved = solve_ivp(
        slope,
        (0.0, 1200.0),
        np.concatenate(start()),
        method="DOP853",
        rtol=1e-11,
        atol=1e-6,
        events=low,
    )
    return solved.t[-1], solved.y[:3, -1], solved.y[3:, -1]


def test_the_motion_is_that_of_newtons_law():
    flown = with_leaf(scenario(), lambda s: s.guidance, ConstantBank(BANK))
    flight = fly_compiled(flown)
    time, place, velocity = by_hand()
    end = flight.state
    frame = axes(float(end.longitude), float(end.latitude))
    radius = float(end.altitude) + TOOLBOX["earth"]["radius_m"]
    # Steps of 0.5 s, of fourth order.
    assert float(flight.time) == pytest.approx(time, abs=1e-3)
    assert radius * frame[0] == pytest.approx(place, abs=0.5)
    speed = float(end.velocity)
    ours = velocity_of(frame, speed, float(end.flight_path_angle), float(end.heading))
    assert ours == pytest.approx(velocity, abs=1e-3)


# What the pages say.


def saved(variant, heading, reading="everything"):
    return populations.saved()["apollo-10", variant, reading, heading]


def test_what_is_said_of_apollo_10():
    others = "unlimited", "predictor-corrector world inertial"
    # Flights under the guidance of Apollo are in a table of their own.
    within = [
        row
        for row in populations.ROWS["apollo-10"]
        if row[0] not in others and not row[0].startswith("apollo")
    ]
    misses, loads, rates, pressures = (
        max(np.max(saved(variant, heading, reading)) for variant, reading in within)
        for heading in (
            "miss, maximum, km",
            "load factor, maximum",
            "heat rate, maximum, MW/m2",
            "dynamic pressure, maximum, kPa",
        )
    )
    misses = max(misses, np.max(saved("unlimited", "miss, maximum, km")))
    limits = TOOLBOX["limits"]
    assert "All of these flights end within 1.3 km" in PAGES and 1.2 < misses < 1.3
    assert loads < limits["load_factor"] and rates < 1e-3 * limits["heat_rate_kW_m2"]
    # A formula for slug/ft3 and thousands of ft/s, given kg/m3 and km/s.
    english = (1.0 / foot) ** 3 / np.sqrt(slug / foot**3)
    assert_says("that would give 1.56 times as much", english)
    assert english * rates > 1e-3 * limits["heat_rate_kW_m2"]
    over = 100.0 * (pressures / limits["dynamic_pressure_kPa"] - 1.0)
    assert_says("exceeds its limit by up to 2.6 %", over)
    capsule = TOOLBOX["capsule"]
    ratio = capsule["lift_coefficient"] / capsule["drag_coefficient"]
    assert_says("5498 kg and a lift-to-drag ratio of 0.325", capsule["mass_kg"], ratio)
    along = float(scenario().target.downrange) / km
    high = TOOLBOX["target"]["altitude_m"] / km
    assert_says("a point 2340 km away and 5.7 km high", along, high)
    assert float(scenario().guidance.lateral.most) == 10.0
    away = (
        float(MISSION.scenario_of("predictor-corrector case skip").target.downrange)
        / km
    )
    assert_says("to a point 5000 km away", away)
    assert_says("the ceiling of 125 km", float(scenario().guidance.end.ceiling) / km)
