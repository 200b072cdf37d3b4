"""Decisions of the entry guidance of Apollo: what it sees, and when its phases end."""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jentry._computed_once import computed_once
from jentry.guidance import SkipPrediction
from jentry.guidance.apollo.law import (
    BALLISTIC,
    FINAL,
    INITIAL_ROLL,
    UP_CONTROL,
    WAITING,
)
from jentry.missions import find_mission
from jentry.onboard import measure


FOOT, G, VS = 0.3048, 32.2, 25766.1973
"""m; feet and seconds, as the flight program says"""

MISSION = find_mission("apollo-10")


# In the frame that does not rotate.


@computed_once
def scenario():
    return MISSION.scenario(law="apollo")


def vectors(longitude, latitude):
    (sa, ca), (sb, cb) = ((np.sin(x), np.cos(x)) for x in (longitude, latitude))
    up = np.array([cb * ca, cb * sa, sb])
    return up, np.array([-sa, ca, 0.0]), np.array([-sb * ca, -sb * sa, cb])


def sensed(force, **changes):
    """Measurement at the entry with a specific force, of a lift of three fifths."""
    flown = scenario()
    state = dataclasses.replace(flown.initial_state, **changes)
    measurement = measure(flown.planet, flown.vehicle, state, jnp.zeros(()))
    lift, drag = jnp.asarray(0.6 * force), jnp.asarray(0.8 * force)
    return dataclasses.replace(measurement, lift=lift, drag=drag)


def test_velocity_is_inertial_and_the_target_moves():
    flown, measurement = scenario(), sensed(5.0)
    planet = flown.planet
    seen, inertial, destination = flown.law.seen(measurement)
    # Those of the toolbox, in an inertial frame.
    assert float(seen.velocity) == pytest.approx(11_067.15, rel=1e-12)
    sine = math.sin(math.radians(-6.6198381))
    assert float(seen.rate) == pytest.approx(11_067.15 * sine, rel=1e-9)
    heading = math.degrees(float(inertial.state.heading))
    assert heading == pytest.approx(71.9317, rel=1e-9)
    assert float(seen.drag) == 5.0
    # The target of the toolbox after 1000 s for each rad, by vectors.
    here, *_ = vectors(math.radians(174.24384), math.radians(-23.51457))
    arc = 0.3
    for _ in range(30):
        turned = math.radians(194.8501) + 7.292115e-5 * 1000.0 * arc
        there, *_ = vectors(turned, math.radians(-15.4121))
        arc = math.atan2(np.linalg.norm(np.cross(here, there)), here @ there)
    # Three passes; the rest of the range is the motion in 0.1 s.
    assert float(seen.range_to_go) == pytest.approx(arc, rel=3e-4)
    along, left = (float(destination.downrange), float(destination.crossrange))
    radius = float(planet.radius)
    assert math.hypot(along, left) == pytest.approx(radius * arc, rel=1e-3)


def decided(phase, force, lift_to_drag=0.3, plan=None, started=0.0, **changes):
    """Decision in a phase, with a measurement as of `sensed`."""
    law, measurement = scenario().law, sensed(force, **changes)
    _, held = law.init(measurement)
    put = lambda h: (h.phase, h.lift_to_drag, h.search.started)
    held = eqx.tree_at(
        put, held, tuple(map(jnp.asarray, (phase, lift_to_drag, started)))
    )
    if plan is not None:
        held = eqx.tree_at(lambda h: h.search.plan, held, plan)
    return law.update(jnp.asarray(100.0), measurement, (), held)[1]


@pytest.mark.parametrize(
    ("phase", "force", "after"),
    [
        (WAITING, 0.049 * G * FOOT, WAITING),
        (WAITING, 0.051 * G * FOOT, INITIAL_ROLL),
        (BALLISTIC, 6.4 * FOOT, BALLISTIC),
        (BALLISTIC, 6.6 * FOOT, FINAL),
        (FINAL, 1.0 * FOOT, FINAL),
    ],
)
def test_phases_end_at_their_drag(phase, force, after):
    assert float(decided(phase, force).phase) == after


@pytest.mark.parametrize(
    ("force", "path", "faster", "after"),
    [
        (5.9, 1.0, -100.0, BALLISTIC),
        (6.1, 1.0, -100.0, UP_CONTROL),
        (5.9, 1.0, 100.0, UP_CONTROL),  # still above the velocity of the pull-out
        (60.0, -1.0, -100.0, UP_CONTROL),
        (60.0, -1.0, -7000.0, FINAL),  # descends below the exit velocity
        (60.0, 1.0, -7000.0, UP_CONTROL),
    ],
)
def test_up_control_ends_at_the_exit_or_in_a_descent(force, path, faster, after):
    """`faster` than the pull-out, in ft/s; the plan leaves at 6 ft/s2."""
    first = [jnp.asarray(x * FOOT) for x in (32_000.0, -400.0, 200.0)]
    plan = SkipPrediction().plan(*first, jnp.asarray(0.15), jnp.zeros(()))
    # The velocity of the measurement is relative to the Earth, which turns by about 0.41
    # km/s here: found by what the law sees.
    speed = float(plan.pull_out_velocity) + faster * FOOT
    changes = {"flight_path_angle": jnp.radians(path)}
    for _ in range(20):
        velocity = changes.get("velocity", jnp.asarray(speed))
        changes["velocity"] = velocity
        seen, *_ = scenario().law.seen(sensed(1.0, **changes))
        changes["velocity"] = velocity + speed - seen.velocity
    found = decided(UP_CONTROL, force * FOOT, plan=plan, **changes)
    assert float(found.phase) == after


def test_initial_roll_chooses_the_drags_of_the_program():
    found = decided(WAITING, 0.06 * G * FOOT)
    leq = (11_067.15 / (VS * FOOT)) ** 2 - 1.0
    assert float(found.constant_drag) / FOOT == pytest.approx(90 * leq + 40, rel=1e-9)
    assert float(found.ending_drag) / FOOT == pytest.approx(
        min(1.3 * leq**3 + 0.2, 1.5) * G, rel=1e-9
    )
    slow = decided(WAITING, 0.06 * G * FOOT, velocity=jnp.asarray(7600.0))
    assert float(slow.phase) == BALLISTIC


def passes_to_the_right(law, measurement):
    """Sine of the arc by which the vehicle passes to the right of the target."""
    here, east, north = vectors(math.radians(174.24384), math.radians(-23.51457))
    heading = math.radians(71.9317)
    ahead = math.sin(heading) * east + math.cos(heading) * north
    turned = math.radians(194.8501) + 7.292115e-5 * 1000.0 * float(
        law.seen(measurement)[0].range_to_go
    )
    there, *_ = vectors(turned, math.radians(-15.4121))
    return -there @ np.cross(ahead, here)


def banked(law, side, share, floor):
    """Side and bank, degrees, of the initial roll with a share of the lift upwards, in a
    corridor of a half width, m."""
    measurement = sensed(8.0)
    _, held = law.init(measurement)
    up = share * law.prediction.lift_to_drag
    values = jnp.asarray(INITIAL_ROLL), jnp.asarray(side), jnp.asarray(up)
    put = lambda h: (h.phase, h.bank.side, h.lift_to_drag)
    held = eqx.tree_at(put, held, tuple(values))
    corridor = lambda law: (law.final.lateral.floor, law.final.lateral.widening)
    law = eqx.tree_at(corridor, law, (jnp.asarray(floor), jnp.zeros(())))
    bank = law.update(jnp.asarray(30.0), measurement, (), held)[1].bank
    angle = math.atan2(float(bank.sin_bank), float(bank.cos_bank))
    return float(bank.side), math.degrees(angle)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["right", "left"])
def test_bank_near_full_lift_turns_to_the_target_only(side):
    law = scenario().law
    to_the_target = -np.sign(passes_to_the_right(law, sensed(8.0)))
    smallest = 15.0 if side == to_the_target else 0.0
    # A corridor so wide that the side stays.
    found, bank = banked(law, side, 1.0, 1e7)
    assert found == side
    assert bank == pytest.approx(side * smallest, abs=1e-9)


@pytest.mark.parametrize("lift", [1.0, -1.0], ids=["up", "down"])
def test_corridor_is_halved_near_full_lift(lift):
    """The vehicle banks away from the target; by LIMITL/D a new side has no bank yet."""
    law = scenario().law
    passes = passes_to_the_right(law, sensed(8.0))
    away, miss = np.sign(passes), float(law.final.planet.radius) * abs(passes)
    for share, floor, side, bank in (
        (0.97, 1.9 * miss, -away, math.degrees(math.acos(0.97 * lift))),
        (0.97, 2.1 * miss, away, math.degrees(math.acos(0.97 * lift))),
        (0.5, 1.1 * miss, away, math.degrees(math.acos(0.5 * lift))),
        (0.5, 0.9 * miss, -away, math.degrees(math.acos(0.5 * lift))),
    ):
        found = banked(law, away, lift * share, floor)
        assert found == (side, pytest.approx(side * bank, abs=1e-9))
