"""The X-33 mission: gains, the four cases of Tables 1 and 2, and dispersed flights.

Bars: the notes to the paper, and what the mission is for. The tables of `cases.py` are
compared with the print first.
"""

import functools
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_batch
from pages import assert_same, published

from jentry import monte_carlo
from jentry.flight import FixedStep, Outcome, misses
from jentry.guidance import (
    DeviationWeights,
    FixedCycle,
    PseudospectralTracking,
    Regulator,
    StoredGainTracking,
    compose,
    plan_gains,
)
from jentry.missions import find_mission
from jentry.missions.x_33 import scenario as x_33
from jentry.missions.x_33.cases import CASES, TABLE_1, TABLE_2, case, off_by
from jentry.onboard.linear_quadratic import riccati_cost_to_go
from jentry.planning import plan_drag_profile
from jentry.planning.flight_problem import AtEnd, best_flight
from jentry.units import degree, km


MISSION = find_mission("x-33")
COUNT = len(CASES)


@functools.cache
def flown(variant):
    """The nominal flight and those of the cases: misses (SI), largest cosine, outcomes."""
    nominal = MISSION.scenario_of(variant)
    return flown_from(nominal, [case(nominal, n + 1) for n in range(COUNT)])


def flown_from(nominal, started):
    scenarios = jax.tree.map(lambda *x: jnp.stack(x), nominal, *started)
    flights = fly_batch(scenarios, FixedStep(), 1.0)
    missed = eqx.filter_jit(jax.vmap(misses))(scenarios, flights)
    cosines = np.nanmax(np.abs(flights.history.controls.cos_bank), axis=1)
    return jax.tree.map(np.asarray, (missed, cosines, flights.outcome))


@pytest.mark.slow
def test_cases_are_those_of_the_paper():
    """Table 2, by hand from the print, in its units; -0.986 and 0.994 km lost e-3."""
    printed = """
        0.5 80 0.9 -1.394e-3 0.468 0.002 100.83
        -0.5 -80 -0.9 1.7488e-3 -0.894 -0.004 -83.92
        1.7 50 0.3 -0.986e-3 0.313 0.001 59.44
        -1.7 -50 -0.3 0.994e-3 -0.527 -0.002 -56.74
    """
    rows = [list(map(float, row.split())) for row in printed.strip().splitlines()]
    units = np.array([km, 1.0, degree])
    np.testing.assert_allclose([c[:3] for c in CASES], np.array(rows)[:, :3] * units)
    units = np.array([km, 1.0, degree, km])
    np.testing.assert_allclose(TABLE_2, np.array(rows)[:, 3:] * units)
    assert [round(row.downrange / km, 2) for row in TABLE_1] == [
        379.59,
        -296.86,
        115.21,
        -106.2,
    ]
    start = MISSION.scenario_of("tracking case 3").initial_state
    nominal = MISSION.scenario("tracking").initial_state
    assert float(start.altitude - nominal.altitude) == pytest.approx(1700.0)
    assert float(start.velocity - nominal.velocity) == pytest.approx(50.0)
    moved = float(start.flight_path_angle - nominal.flight_path_angle)
    assert moved == pytest.approx(0.3 * degree)


@pytest.mark.slow
@pytest.mark.parametrize("states", [3, 4])
def test_gains_are_those_of_riccati(states):
    """1e-6, also across the jump of the control, and up to the end."""
    regulator = x_33.regulator(x_33.reference(), with_range=states == 4)
    gains = jax.jit(plan_gains)(regulator)
    joint = float(regulator.reference.ends[5])

    @jax.jit
    def expected(time):
        ends = regulator.ends(time)
        s = riccati_cost_to_go(regulator.system, regulator.weights, ends)
        part = regulator.reference.part(time)
        _, b = regulator.system(part, ends[part])
        return regulator.weights.gain(s, b)[0]

    read = eqx.filter_jit(gains.at)
    early = (0.0, 137.0, joint - 1.0, joint, joint + 40.0, 600.0)
    for time in (*early, 661.0, 700.0, 707.0, 724.0, 735.2, 738.2, 750.0, 755.0):
        k = np.asarray(expected(jnp.asarray(time)))
        found = np.asarray(read(jnp.asarray(time)))
        np.testing.assert_allclose(found, k, rtol=0, atol=1e-6 * np.max(np.abs(k)))
    # At the end they are R^-1 B' P_f.
    _, b = regulator.system(jnp.asarray(9), regulator.ends()[-1])
    np.testing.assert_allclose(
        read(gains.ends[-1]), b[:, 0] * regulator.at_end.diagonal, rtol=1e-6, atol=1e-4
    )


def test_plan_in_flight_is_the_gain_at_once():
    """Halfway, from any deviation: what is planned begins with -K x, and for a part that
    has passed nothing is left to pay."""
    regulator = x_33.regulator(x_33.reference(), with_range=True)
    time, deviation = jnp.asarray(400.0), jnp.array([1e-4, -3e-3, 2e-3, 5e-3])
    part = int(regulator.reference.part(time))
    plans = eqx.filter_jit(regulator.plans)(time)
    gain = plan_gains(regulator).at(time)
    change = plans.controls[part, 0, 0] @ deviation
    assert float(change) == pytest.approx(float(-gain @ deviation), rel=1e-7)
    assert part > 0
    for before in range(part):
        np.testing.assert_allclose(
            plans.states[before], np.broadcast_to(np.eye(4), (11, 4, 4)), atol=1e-12
        )


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["tracking", "receding"])
def test_table_2(variant):
    missed, cosines, outcome = flown(variant)
    assert np.all(outcome == Outcome.REACHED)
    assert np.max(np.abs(missed.altitude)) < 10.0
    assert np.max(np.abs(missed.velocity)) < 1.0
    assert np.max(np.abs(missed.flight_path_angle)) < 0.005 * degree
    printed = np.array([row.downrange for row in TABLE_2])
    np.testing.assert_allclose(missed.downrange[1:], printed, rtol=0.35)
    open_loop, _, _ = flown("open-loop")
    assert np.all(np.abs(open_loop.downrange[1:]) > 5.0 * np.abs(missed.downrange[1:]))
    assert np.max(cosines) < 1.0
    # From the start of the reference all of them stay on it.
    assert abs(missed.downrange[0]) < 1.0 and abs(missed.altitude[0]) < 0.01


@pytest.mark.slow
def test_the_published_table():
    """As it is saved, to the last digit that is printed; the paper's beside it."""
    closed, _, _ = flown("tracking")
    ranged, _, _ = flown("with-range")
    free, _, _ = flown("open-loop")
    saved = published("x-33 cases")
    for n, name in enumerate(MISSION.cases):
        printed, first = TABLE_2[n], TABLE_1[n].downrange
        for column, value, paper in (
            ("altitude, m", closed.altitude, printed.altitude),
            ("velocity, m/s", closed.velocity, printed.velocity),
            (
                "path angle, deg",
                closed.flight_path_angle / degree,
                printed.flight_path_angle / degree,
            ),
            ("range, km", closed.downrange / km, printed.downrange / km),
            ("range without feedback, km", free.downrange / km, first / km),
            ("range as a fourth state, km", ranged.downrange / km, None),
        ):
            cell = saved[name, column]
            assert_same(cell, value[n + 1])
            assert cell.published == (paper and pytest.approx(paper))


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["with-range", "receding-with-range"])
def test_with_the_range_as_a_state(variant):
    missed, cosines, outcome = flown(variant)
    assert np.all(outcome == Outcome.REACHED)
    assert np.max(np.abs(missed.downrange)) < 500.0
    assert np.max(np.abs(missed.altitude)) < 20.0
    assert np.max(cosines) < 1.0


def test_table_1():
    """With the printed signs 1.4 to 2.8 times too far off, as the notes have it. With the
    sign of the velocity turned round 15 % by the notes; here 4, 9, 15 and 21 %."""
    printed = np.array([row.downrange for row in TABLE_1])
    missed, _, _ = flown("open-loop")
    ratio = missed.downrange[1:] / printed
    assert np.all((ratio > 1.4) & (ratio < 2.8))
    nominal = MISSION.scenario("open-loop")
    turned = [
        eqx.tree_at(
            lambda s: s.initial_state,
            nominal,
            off_by(nominal.initial_state, errors._replace(velocity=-errors.velocity)),
        )
        for errors in CASES
    ]
    missed, _, _ = flown_from(nominal, turned)
    np.testing.assert_allclose(missed.downrange[1:], printed, rtol=0.22)


@pytest.mark.slow
def test_exact_inverse_ends_where_its_profile_does():
    """Within 1 m of the altitude that has the drag at 760 m/s."""
    end = x_33.reference(exact=True).end
    wanted = x_33.inverse(exact=True).at(end.velocity)
    assert float(end.altitude) == pytest.approx(float(wanted.altitude), abs=1.0)
    paper = x_33.reference().end
    low = float(wanted.altitude - paper.altitude)
    assert low == pytest.approx(236.0, abs=1.0)
    missed, _, _ = flown("exact-inverse")
    assert np.max(np.abs(missed.altitude)) < 15.0


@pytest.mark.slow
def test_shorter_cycles_tend_to_stored_gains():
    """The plan that is flown for 1 s instead of 10 ends nearer to continuous feedback."""
    stored, _, _ = flown("tracking")
    ten, _, _ = flown("receding")
    nominal = MISSION.scenario("receding")
    law = nominal.guidance
    shorter = compose(
        law.angle_of_attack,
        PseudospectralTracking(regulator=law.bank.regulator, cycle=FixedCycle(1.0)),
    )
    nominal = eqx.tree_at(lambda s: s.guidance, nominal, shorter)
    one, _, _ = flown_from(nominal, [case(nominal, n + 1) for n in range(COUNT)])
    away = [np.abs(each.downrange - stored.downrange)[1:] for each in (one, ten)]
    assert np.all(away[0] < 0.2 * away[1])


@pytest.mark.slow
def test_dispersed_flights():
    """What the regulator is for: with the range as a state it is met 20 times better."""
    far = {}
    for variant in ("tracking", "with-range"):
        scenario = MISSION.scenario_of(variant)
        table = MISSION.dispersion_table("everything")
        campaign = monte_carlo(scenario, table, jax.random.key(3), 64)
        assert np.all(np.asarray(campaign.flights.outcome) == Outcome.REACHED)
        far[variant] = np.std(np.asarray(campaign.misses.downrange))
    assert far["with-range"] < 0.05 * far["tracking"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"underway": DeviationWeights(downrange=1.0)},
            "downrange has a weight in one",
        ),
        (
            {
                "underway": DeviationWeights(downrange=1.0),
                "at_end": DeviationWeights(downrange=1.0),
            },
            "aim=TargetOfScenario",
        ),
        ({"degree": 0}, "degree is 0"),
    ],
)
def test_regulators_that_are_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        Regulator(x_33.model(), x_33.reference(), **changes)


def test_gains_of_another_regulator_are_refused():
    three, four = (x_33.regulator(x_33.reference(), way) for way in (False, True))
    with pytest.raises(ValueError, match="gains has 4 for each time"):
        StoredGainTracking(three, plan_gains(four))


def _square(misses):
    """Of the range in km and of the altitude in 100 m: its mean over the flights."""
    return jnp.mean((misses.downrange / km) ** 2 + (misses.altitude / 100.0) ** 2)


@functools.cache
def farthest(name):
    return best_flight(MISSION.scenario("glide"), MISSION.problem(name))


@pytest.mark.slow
@pytest.mark.optimized
def test_longest_and_shortest_range_in_the_corridor():
    """Within the limits all along, and between the ranges that the planner of the drag
    finds for its edges, at which one of them binds everywhere."""
    edges = []
    for distance in (100 * km, 20_000 * km):
        with pytest.raises(ValueError, match="is not in the corridor") as refused:
            plan_drag_profile(
                x_33.earth(),
                x_33.vehicle(),
                x_33.ScheduledAngleOfAttack(),
                x_33.corridor(),
                (x_33.FIRST_VELOCITY, x_33.FIRST_DRAG),
                (x_33.LAST_VELOCITY, x_33.LAST_DRAG),
                distance,
            )
        edges.append(
            float(re.search(r"at (?:least|most) ([\d.]+) km", str(refused.value))[1])
        )
    ranges = []
    for name in ("shortest", "longest"):
        best = farthest(name)
        ranges.append(float(AtEnd("downrange")(best.scenario, best.flight)) / km)
        end, wanted = best.flight.state, x_33.reference().end
        assert float(end.altitude) == pytest.approx(float(wanted.altitude), abs=1e-3)
        path = float(wanted.flight_path_angle)
        assert float(end.flight_path_angle) == pytest.approx(path, abs=1e-9)
        for limit, constraint in x_33.corridor().items():
            most = float(constraint.limit)
            # Kept at the entries, every 2.5 s.
            assert np.nanmax(best.constraints[limit]) <= most + 1e-8 * (
                abs(most) or 1.0
            )
            assert float(best.flight.peaks[limit]) <= most + 1e-3 * (abs(most) or 1.0)
        assert best.slope_left < 1e-4
    assert edges[0] < ranges[0] < 3000.0 < ranges[1] < edges[1]
    assert {"heat_rate", "normal_load_factor"} <= set(farthest("shortest").active)
    assert "equilibrium_glide" in farthest("longest").active
    # Of this start; begun at other banks, with nodes elsewhere, 2555 to 2558 and 6814 to
    # 6831 km.
    assert ranges == pytest.approx([2556.5, 6814.2], abs=0.1)
