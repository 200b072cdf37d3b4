"""The entry guidance of Apollo: its constants, its equations and its phases."""

import functools
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from laws import apollo

from jentry.guidance import (
    ConstantDrag,
    DecelerationLimit,
    InitialRoll,
    SkipPrediction,
    UpControl,
)
from jentry.guidance.apollo.phases import Seen
from jentry.guidance.apollo.search import FOUND, LATER, SLOW, Search, searched
from jentry.missions import find_mission


FOOT, G = 0.3048, 32.2
"""m; feet per second squared"""
VS, RE, HS = 25766.1973, 21202900.0, 28500.0
"""Feet and seconds, as the comments of the program say"""

MISSION = find_mission("apollo-10")


# Constants, from the numbers that the program stores and the scales of their comments.


def test_constants_are_the_stored_numbers():
    speed, force = 2.0 * VS * FOOT, 805.0 * FOOT
    roll, hold, up = InitialRoll(), ConstantDrag(), UpControl()
    skip, limit = SkipPrediction(), DecelerationLimit()
    law = apollo(None)
    circle = 2.0 * math.pi
    for ours, stored, scale in (
        (roll.first_drag, 0.002, force),
        (roll.shallow_velocity, 0.51618016, speed),
        (roll.slow_velocity, 0.523942273, speed),
        (roll.steepness, 1.0 / 0.00260929464, speed),
        (roll.held_drag, 0.008, force),
        (roll.held_drag_growth, 1.0 / 0.30048077 / 64.0, force),
        (roll.largest_held_drag, 0.06, force),
        (roll.constant_drag, 0.049689441, force),
        (roll.constant_drag_growth, 0.44720497 / 4.0, force),
        (hold.drag_gain, 0.0314453125 * 256.0, 1.0 / force),
        (hold.rate_gain, 0.201298418 * 256.0, 1.0 / speed),
        (-hold.search_rate, 0.0135836886, speed),
        (hold.tolerance, 0.0011574074, circle),
        (hold.slow_exit, 0.34929485, speed),
        (hold.lowering, 0.019405269, speed),
        (up.velocity_gain, 1.0 / 0.0057074322, 1.0 / speed),
        (up.rate_gain, 1.0 / 0.29411765, 1.0),
        (up.early_velocity, 0.0097026346, speed),
        (up.fading_drag, 0.049689441, force),
        (up.no_reversal_drag, 0.17391304, force),
        (up.no_dive_drag, 0.2173913, force),
        (limit.limit, 2.0 * 0.16, force),
        (skip.circular_velocity, 0.5, speed),
        (skip.exit_drag, 0.0074534161, force),
        (2.0 * skip.drag_rise * skip.scale_height, 0.0215983264, speed**2 / force),
        (skip.scale_height / skip.radius, 0.00684572901 / 32.0, circle),
        (4.0 * skip.circular_velocity**2 / skip.radius, 0.0247622232, circle * force),
        (skip.final_range, -0.05333333 + 0.3 * 0.0231481481, circle),
        (skip.final_range_per_velocity, 0.167003132, circle / speed),
        (skip.final_range_per_angle, 0.326388889, circle),
        (skip.final_angle, 0.0349, 1.0),
        (law.reentry_drag, 0.0080745342, force),
        (law.last_velocity, 0.019405269, speed),
    ):
        # The stored numbers have five digits or more, and g in them is 32.2 ft/s2.
        assert float(ours) == pytest.approx(stored * scale, rel=5e-5), stored


# The prediction of the range, beside the equations of the program in feet and miles.


def by_hand(velocity, rate, drag, lewd, lower=0.0, lad=0.3):
    """HUNTEST and RANGER for V, RDOT and D in feet: the numbers of a skip, in feet."""
    c1, ch1, q7 = 1.25, 1.0, 6.0
    tem1b = lad if rate < 0 else lewd
    v1 = velocity + rate / tem1b
    a0 = (v1 / velocity) ** 2 * (drag + rate**2 / (tem1b * 2 * c1 * HS))
    v1 -= lower
    alp = 2 * c1 * HS * a0 / (lewd * v1**2)
    fact1, fact2 = v1 / (1 - alp), alp * (alp - 1) / a0
    vl = fact1 * (1 - math.sqrt(q7 * fact2 + alp))
    gammal1 = lewd * (v1 - vl) / vl
    vs1 = min(v1, VS)
    dvl = vs1 - vl
    dhook = ((1 - vs1 / fact1) ** 2 - alp) / fact2
    ahook_dvl = 0.25 * (dhook / q7 - 1)
    gammal = gammal1 - ch1 * G * dvl**2 * (1 + ahook_dvl) / (dhook * vl**2)
    dives = gammal < 0
    if dives:
        bend = dvl * (2 / 3 + ahook_dvl) * ch1 * G / (dhook * vl)
        vl += gammal * vl / 3 / (lewd / 3 - bend)
        q7 = ((1 - vl / fact1) ** 2 - alp) / fact2
        gammal = 0.0
    gammal1 += 0.5 * (gammal - gammal1)
    vbars = (vl / VS) ** 2
    cosg = 1 - gammal**2 / 2
    e = math.sqrt(1 + (vbars - 2) * cosg**2 * vbars)
    mile = math.pi / 10800
    ranges = {
        "ballistic": 2 * math.asin(vbars * cosg * gammal / e),
        "final": (-1152 + 500 * lad + 0.07 * vl) * mile,
        "up": -HS / RE * math.log(v1**2 * q7 / (vl**2 * a0)) / gammal1,
        "down": -rate * velocity / (a0 * lad * RE),
        "correction": 0.3 * 23500 * mile * (0.0349 - gammal),
    }
    return {"v1": v1, "a0": a0, "vl": vl, "q7": q7, "gammal": gammal}, ranges, dives


SKIPS = [
    (32_000.0, -400.0, 200.0, 0.15, 0.0),
    (30_000.0, -100.0, 180.0, 0.2, 0.0),
    (29_000.0, 200.0, 120.0, 0.3, 0.0),
    (28_000.0, -200.0, 150.0, 0.15, 1000.0),
    (24_500.0, -250.0, 130.0, 0.15, 0.0),
]


@pytest.mark.parametrize("skip", SKIPS, ids=str)
def test_skip_is_that_of_the_equations(skip):
    velocity, rate, drag, lewd, lower = skip
    numbers, ranges, _ = by_hand(*skip)
    prediction = SkipPrediction()
    seen = velocity * FOOT, rate * FOOT, drag * FOOT
    plan = prediction.plan(*map(jnp.asarray, (*seen, lewd, lower * FOOT)))
    # The program has g = 32.2 ft/s2 also here.
    for ours, name, unit in (
        (plan.pull_out_velocity, "v1", FOOT),
        (plan.pull_out_drag, "a0", FOOT),
        (plan.exit_velocity, "vl", FOOT),
        (plan.exit_drag, "q7", FOOT),
        (plan.exit_angle, "gammal", 1.0),
    ):
        assert float(ours) / unit == pytest.approx(numbers[name], rel=1e-9, abs=1e-12)
    found = prediction.range(plan, *map(jnp.asarray, seen[:2]))
    for name, value in ranges.items():
        assert float(getattr(found, name)) == pytest.approx(value, rel=1e-8, abs=1e-12)
    assert float(found.total) == pytest.approx(sum(ranges.values()), rel=1e-8)


def test_some_of_these_skips_leave_the_air_and_some_do_not():
    assert [by_hand(*skip)[2] for skip in SKIPS] == [False, False, False, True, True]


def seen_at(velocity, rate, drag, miles=0.0):
    """From feet, and a range to go in nautical miles of the program."""
    values = velocity * FOOT, rate * FOOT, drag * FOOT, miles * math.pi / 10800
    return Seen(*map(jnp.asarray, values))


@functools.cache
def search_compiled():
    return eqx.filter_jit(searched)


def search_at(seen, trials=10, lower=0.0):
    control, prediction = ConstantDrag(), SkipPrediction()
    start = Search.start(control, jnp.zeros(()))
    lower = jnp.asarray(lower * FOOT)
    return search_compiled()(control, prediction, seen, start, lower, trials)


def test_search_finds_the_skip_that_has_the_range_to_go():
    state = 31_000.0, -300.0, 200.0
    for ratio in (0.17, 0.2, 0.3):
        _, ranges, _ = by_hand(*state, ratio)
        miles = sum(ranges.values()) * 10800 / math.pi
        found = search_at(seen_at(*state, miles))
        assert float(found.end) == FOUND
        _, there, _ = by_hand(*state, float(found.plan.lift_to_drag))
        off = (sum(there.values()) - sum(ranges.values())) * 10800 / math.pi
        assert abs(off) < 25.0


@pytest.mark.parametrize(
    ("state", "miles", "end"),
    [
        ((31_000.0, -300.0, 200.0), 500.0, LATER),  # the first skip is too long
        ((35_000.0, 100.0, 100.0), 5000.0, LATER),  # faster than circular at its exit
        ((19_000.0, -200.0, 150.0), 400.0, SLOW),
        ((31_000.0, -300.0, 200.0), 1e4, LATER),  # no ratio below one reaches it
    ],
)
def test_search_without_a_skip(state, miles, end):
    assert float(search_at(seen_at(*state, miles)).end) == end


def test_search_goes_on_in_the_next_cycle():
    seen = seen_at(31_000.0, -300.0, 200.0, 2500.0)
    control, prediction = ConstantDrag(), SkipPrediction()
    search = Search.start(control, jnp.zeros(()))
    lower = jnp.zeros(())
    for _ in range(8):
        before = search
        search = search_compiled()(control, prediction, seen, search, lower, 1)
        if float(search.end) == FOUND:
            break
    whole = search_at(seen)
    assert float(whole.end) == float(search.end) == FOUND
    assert float(before.changed) == 1.0
    np.testing.assert_allclose(
        search.plan.lift_to_drag, whole.plan.lift_to_drag, rtol=1e-12
    )


# Commands of the phases.


def test_constant_drag_is_that_of_the_program():
    velocity, rate, drag, held = 33_000.0, -350.0, 150.0, 110.0
    leq = (velocity / VS) ** 2 - 1
    by_program = -leq * G / held + 0.01 * (drag - held)
    by_program -= 0.001 * (rate + 2 * HS * held / velocity)
    ours = ConstantDrag().holding(
        SkipPrediction(), seen_at(velocity, rate, drag), jnp.asarray(held * FOOT)
    )
    assert float(ours) == pytest.approx(by_program, rel=1e-9)


@pytest.mark.parametrize("offset", [(0, 0, 0), (300, 40, 5), (-2000, 20, -4)], ids=str)
@pytest.mark.parametrize("skip", [SKIPS[0], SKIPS[1]], ids=str)
def test_up_control_is_that_of_the_program(skip, offset):
    velocity, _, drag, lewd, lower = skip
    numbers, *_ = by_hand(*skip)
    seen = [jnp.asarray(x * FOOT) for x in skip[:3]]
    plan = SkipPrediction().plan(*seen, jnp.asarray(lewd), jnp.asarray(lower))
    v1, a0, vl, q7 = (numbers[k] for k in ("v1", "a0", "vl", "q7"))
    alp = 2.5 * HS * a0 / (lewd * v1**2)
    fact1, fact2 = v1 / (1 - alp), alp * (alp - 1) / a0
    here = 0.4 * a0 + offset[2]
    vref = fact1 * (1 - math.sqrt(fact2 * here + alp))
    rdotref = lewd * (v1 - vref)
    vs1 = min(v1, VS)
    dhook = ((1 - vs1 / fact1) ** 2 - alp) / fact2
    if vref < vs1:
        dv = vs1 - vref
        grown = 1 + 0.25 * (dhook / q7 - 1) * dv / (vs1 - vl)
        rdotref -= G * grown * dv**2 / (dhook * vref)
    a1 = a0 if skip[1] < 0 else drag
    factor = (here - q7) / (a1 - q7)
    velocity, rate = vref + offset[0], rdotref + offset[1]
    change = -0.0034 * factor * (3.4 * factor * (rate - rdotref) + velocity - vref)
    if abs(change) > 0.1:
        change = math.copysign(0.1 + 0.1 * (abs(change) - 0.1), change)
    up, now = UpControl(), seen_at(velocity, rate, here)
    gain = up.gain(plan, now.drag, jnp.asarray(7.0))
    assert float(gain) == pytest.approx(factor, rel=1e-9)
    ours = up.climbing(SkipPrediction(), plan, now, gain)
    assert float(ours) == pytest.approx(lewd + change, rel=1e-7, abs=1e-9)
    thin = up.gain(plan, jnp.asarray(39.0 * FOOT), jnp.asarray(7.0))
    assert float(thin) == 7.0
    dense = seen_at(velocity, rate, a0 + 1.0)
    assert float(up.climbing(SkipPrediction(), plan, dense, gain)) == 0.3


def test_descent_to_the_pull_out_is_that_of_the_program():
    velocity, rate, drag, lewd, _ = SKIPS[0]
    numbers, *_ = by_hand(*SKIPS[0])
    seen = seen_at(velocity, rate, drag)
    plan = SkipPrediction().plan(*seen[:3], jnp.asarray(lewd), jnp.zeros(()))
    v1 = numbers["v1"]
    faster = seen_at(v1 + 800.0, rate, drag)
    dref = (v1 + 800.0) ** 2 / v1**2 * numbers["a0"] - 800.0**2 * 0.3 / (2.5 * HS)
    by_program = 0.3 + 0.01 * (drag - dref) - 0.001 * (rate + 0.3 * 800.0)
    ours = ConstantDrag().pulling_out(SkipPrediction(), plan, faster)
    assert float(ours) == pytest.approx(by_program, rel=1e-9)


@pytest.mark.parametrize(
    ("drag", "rate", "lifts"),
    [(3.9, -3500, False), (4.1, -3500, True), (5.0, -700, False), (8.1, 100, True)],
)
def test_deceleration_limit_is_that_of_the_program(drag, rate, lifts):
    velocity, d, gmax = 25_000.0, drag * G, 8 * G
    leq = (velocity / VS) ** 2 - 1
    inside = (
        2 * HS * (gmax - d) * (leq * G / gmax + 0.3) + (2 * HS * gmax / velocity) ** 2
    )
    by_program = d > gmax or (d > gmax / 2 and rate + math.sqrt(max(inside, 0.0)) < 0)
    assert by_program == lifts
    seen = seen_at(velocity, rate, d)
    assert bool(DecelerationLimit().needs_lift(SkipPrediction(), seen)) == lifts


@pytest.mark.parametrize(("degrees", "shallow"), [(-6.5, False), (-4.0, True)])
def test_a_shallow_entry_rolls_over(degrees, shallow):
    """At 36 000 ft/s; the limit is at 4.5 degrees."""
    rate = 36_000.0 * math.sin(math.radians(degrees))
    assert bool(InitialRoll().is_shallow(seen_at(36_000.0, rate, 2.0))) == shallow
