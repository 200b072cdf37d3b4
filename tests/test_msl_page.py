"""What the page of the Mars Science Laboratory says, and the first runs of its table."""

import numpy as np
import pytest
from first_sets import assert_first_runs, fly_few, populations
from helpers import fly_compiled, truths
from pages import PAGES, assert_says

from jentry.missions import find_mission
from jentry.missions.msl import laws
from jentry.units import degree, km


TOOLBOX = truths("msl.csv")
PUBLISHED = TOOLBOX["published"]
WINDY = "terminal-point world wind-and-waves"
ALL_ERRORS = "everything-with-wind-and-knowledge"


def saved(choice, reading, heading):
    return populations.saved()["msl", choice, reading, heading]


def ellipse(choice, reading):
    """Length and width of the ellipse of 99 %, km."""
    headings = (f"ellipse of 99 %, {name}, km" for name in ("length", "width"))
    return [float(np.mean(saved(choice, reading, heading))) for heading in headings]


def test_what_is_said_of_the_ellipses():
    whole = ellipse(f"{WINDY} world inertial", ALL_ERRORS)
    assert_says("our ellipse is 13.0 km long and 6.9 km wide", *whole)
    length, width = (PUBLISHED[f"ellipse_{name}_km"] for name in ("length", "width"))
    short = 100.0 * (1.0 - whole[0] / length)
    assert_says("The length is 35 % below the 20 km", short, length)
    narrow = 100.0 * (1.0 - whole[1] / width)
    assert_says("The width is 2 % below the published 7 km", narrow, width)
    parts = {
        "wind": ellipse(WINDY, "wind"),
        "waves": ellipse(WINDY, "waves"),
        "navigation": ellipse("terminal-point world inertial", "knowledge"),
        "vehicle": ellipse("terminal-point", "air-and-vehicle"),
        "entry": ellipse("terminal-point", "entry-errors"),
    }
    lengths = {name: found[0] for name, found in parts.items()}
    assert_says("an ellipse of 9.2 km", lengths["wind"])
    assert_says("the navigation makes 6.2 km", lengths["navigation"])
    assert_says(
        "waves 5.2 km, air and vehicle 4.3 km, and the errors of the entry 0.9 km",
        *(lengths[name] for name in ("waves", "vehicle", "entry")),
    )
    # "The squares add up": to the standard error of 16 sets.
    assert np.hypot.reduce([*lengths.values()]) == pytest.approx(whole[0], rel=0.05)
    calm = ellipse("terminal-point world inertial", "everything-and-knowledge")
    known = ellipse(WINDY, "everything-with-wind")
    assert_says(
        "other errors is 7.2 km long, and without errors of the navigation 11.5 km",
        calm[0],
        known[0],
    )
    widths = parts["navigation"][1], parts["wind"][1]
    assert_says("5.3 km alone, and the wind 3.6 km", *widths)


def test_what_is_said_of_the_flights():
    whole = f"{WINDY} world inertial"
    farthest = np.max(saved(whole, ALL_ERRORS, "miss over ground, maximum, km"))
    within = PUBLISHED["parachute_within_km"]
    assert_says("within 7.7 km of the target, and 12.5 km were", farthest, within)
    for choice, reading in populations.ROWS["msl"]:
        assert not saved(choice, reading, "lost, %").any()
    triggered = ellipse(f"{whole} world range-trigger", ALL_ERRORS)
    share = 100.0 * np.prod(triggered) / np.prod(ellipse(whole, ALL_ERRORS))
    assert_says("is then 7.6 km long and 6.0 km wide", *triggered)
    assert_says("which is 51 % of the area", share)
    off = saved(
        "terminal-point world fitted-air", "everything", "downrange error, median, km"
    )
    assert_says("more than 1.0 km from the target", np.mean(off))
    nearest = saved(
        "predictor-corrector", "everything", "miss over ground, maximum, km"
    )
    assert "comes within 0.1 km" in PAGES and np.max(nearest) < 0.1


def test_what_is_said_of_the_nominal_flight():
    scenario = find_mission("msl").scenario()
    flight, entry = fly_compiled(scenario), scenario.initial_state
    speed, path = float(entry.velocity) / km, float(entry.flight_path_angle) / degree
    assert_says("5.844 km/s and -16.14 degrees relative", speed, path)
    assert_says("a point 634 km away", float(scenario.target.downrange) / km)
    plan = np.degrees(np.arccos(float(laws.plan().cos_bank)))
    assert_says("a constant bank of 49 degrees down to 1100", plan, laws.ALIGNS_BELOW)
    load, mach = float(flight.peaks["load_factor"]), float(flight.at_end["mach"])
    assert_says("(commentary of the landing, NASA) | 11.7 |", load)
    assert_says("(commentary of the landing) | 1.92 |", mach)
    assert_says("before the landing) | 250 s", float(flight.time))
    low = TOOLBOX["mars"]["radius_m"] - PUBLISHED["radius_of_landing_site_m"]
    assert_says("the landing site is 5.9 km below it", low / km)


def test_what_is_said_of_the_relative_path_angle():
    """By the tangent: the sideways velocity that the planet takes away."""
    entry, speed = TOOLBOX["entry"], TOOLBOX["entry"]["velocity_m_s"]
    path, heading = (
        entry[f"{name}_deg"] * degree for name in ("flight_path_angle", "heading")
    )
    carried = (
        TOOLBOX["mars"]["rotation_rate_rad_s"]
        * entry["radius_m"]
        * np.cos(entry["latitude_deg"] * degree)
    )

    def relative(path):
        level = speed * np.cos(path)
        east, north = level * np.sin(heading) - carried, level * np.cos(heading)
        return np.arctan(speed * np.sin(path) / np.hypot(east, north))

    steps = np.array([-1e-4, 1e-4])
    ratio = np.diff(relative(path + steps))[0] / np.diff(steps)[0]
    assert_says("of the relative angle is 4 % larger", 100.0 * (ratio - 1.0))


def test_the_first_runs_are_those_of_the_table():
    rows = ("msl", "terminal-point", "everything")
    assert_first_runs(*rows, *fly_few(*rows))
