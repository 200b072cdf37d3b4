"""Drag profiles of the X-33 case: the plan, and the two flights that have its drag.

Expected: the notes to the paper, and an independent solution of the continuous problem and
of the equations of motion by scipy, in a few lines of numpy.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drag_profiles import (
    D0,
    DF,
    DISTANCE,
    FIRST,
    GRAVITY,
    LAST,
    RADIUS,
    alpha,
    coefficients,
    drag_of,
    limits,
    planet,
    planned,
)
from scipy.integrate import solve_bvp, solve_ivp

from jentry.missions.x_33.airframe import ScheduledAngleOfAttack, vehicle
from jentry.motion.constraints import EquilibriumGlide, NormalLoadFactor
from jentry.planning.drag_profile import LEAST_DRAG, CollocatedProfile
from jentry.planning.inverse_dynamics import ExactInverse, SmallAngleInverse
from jentry.units import km, standard_gravity


@pytest.fixture(scope="module")
def plan():
    return planned()


@pytest.fixture(scope="module")
def limited():
    return planned(first=(FIRST, 1.0))


def test_vehicle_and_schedule():
    """Equations (61) and (62), and the corners of the schedule."""
    v = np.array([8000.0, 7450.0, 4571.0, 4569.0, 3000.0, 1000.0, 760.0, 700.0])
    angle = jax.vmap(ScheduledAngleOfAttack())(jnp.asarray(v))
    np.testing.assert_allclose(np.degrees(angle), alpha(v), rtol=1e-14)
    assert np.degrees(ScheduledAngleOfAttack()(jnp.asarray(760.0))) == pytest.approx(14)
    made = vehicle().aerodynamics.coefficients
    found = [made(a, jnp.ones(()), jnp.ones(())) for a in angle]
    np.testing.assert_allclose(found, np.transpose(coefficients(v)), rtol=1e-12)


def test_against_the_continuous_problem(plan):
    """D'' = -price V / (2 D^2) between the ends, with the range, by scipy."""

    def slopes(v, y, price):
        return np.vstack([y[1], -price[0] * 1e-6 * v / (2.0 * y[0] ** 2), v / y[0]])

    def ends(low, high, price):
        return np.array([low[0] - DF, high[0] - D0, low[2], high[2] - DISTANCE])

    v = np.linspace(LAST, FIRST, 400)
    share = (v - LAST) / (FIRST - LAST)
    guess = DF + share * (D0 - DF) + 6.0 * np.sin(np.pi * share)
    guess = np.vstack([guess, 0.0 * v, DISTANCE * share])
    true = solve_bvp(slopes, ends, v, guess, p=[0.1], tol=1e-10, max_nodes=10**5)
    assert true.success
    x, w = np.polynomial.legendre.leggauss(300)
    half = 0.5 * (FIRST - LAST)
    roughness = half * w @ true.sol(LAST + half * (x + 1.0))[1] ** 2
    assert float(plan.roughness) == pytest.approx(roughness, rel=1e-8)
    at_nodes = true.sol(np.asarray(plan.velocity))[0]
    np.testing.assert_allclose(plan.drag.values, at_nodes, rtol=0.0, atol=1e-6)
    # The multiplier is that of the continuous problem too: the price of range.
    assert float(plan.multiplier_of_distance) == pytest.approx(
        -true.p[0] * 1e-6, rel=1e-6
    )


def test_range_and_ends(plan, limited):
    for each, off in ((plan, 1.0), (limited, 1.0 * km)):
        # By a quadrature of its own, through the polynomial: where a limit binds at some
        # nodes there are corners, about which the sum over the nodes is not exact.
        x, w = np.polynomial.legendre.leggauss(200)
        half = 0.5 * (FIRST - LAST)
        v = LAST + half * (x + 1.0)
        drag = jax.vmap(each.drag)(jnp.asarray(v))
        assert half * np.sum(w * v / drag) == pytest.approx(DISTANCE, abs=off)
        assert float(each.distance) == pytest.approx(DISTANCE, abs=1e-6)
        assert float(each.velocity[0]) == FIRST and float(each.velocity[-1]) == LAST
    assert plan.active == {}
    assert float(plan.drag(jnp.asarray(FIRST))) == D0
    assert float(limited.drag(jnp.asarray(FIRST))) == 1.0
    assert float(limited.drag(jnp.asarray(LAST))) == DF


def test_load_limit_is_active(limited):
    """At the nodes of the notes, at the drag of (7), and it pushes down."""
    assert limited.active == {"normal_load_factor": list(range(13, 19))}
    v = np.asarray(limited.velocity)
    lift, drag = coefficients(v)
    a = np.radians(alpha(v))
    limit = 2.0 * GRAVITY / (lift / drag * np.cos(a) + np.sin(a))
    found = np.asarray(limited.drag.values)
    np.testing.assert_allclose(found[13:19], limit[13:19], rtol=1e-12)
    assert np.all(found <= limit * (1.0 + 1e-12))
    multipliers = np.asarray(limited.multipliers["normal_load_factor"])
    assert np.all(multipliers[13:19] < 0.0) and np.all(multipliers[:13] == 0.0)
    np.testing.assert_allclose(limited.limits["normal_load_factor"], limit, rtol=1e-9)


def test_other_limits(plan):
    """(6), (8) and (9); (8) with gravity and radius at the altitude, by iteration."""
    v = np.asarray(plan.velocity)
    lift, drag = coefficients(v)
    heat = drag * 391.22 * 3.305e9**2 / (2.0 * 104305.0 * v**4)
    pressure = 391.22 * drag * 16280.0 / 104305.0
    known = ~np.isnan(np.asarray(plan.limits["heat_rate"]))
    # Where it is met below the ground there is none.
    assert np.all(heat[~known] > drag_of(RADIUS, v)[~known])
    found = plan.limits["heat_rate"]
    np.testing.assert_allclose(np.asarray(found)[known], heat[known], rtol=1e-9)
    np.testing.assert_allclose(plan.limits["dynamic_pressure"], pressure, rtol=1e-9)
    r = np.full_like(v, RADIUS + 60.0 * km)
    for _ in range(200):
        glide = drag / lift * (GRAVITY * RADIUS**2 / r**2 - v**2 / r)
        density = glide * 2.0 * 104305.0 / (391.22 * v**2 * drag)
        r = RADIUS - 6600.0 * np.log(density / 1.225)
    np.testing.assert_allclose(plan.limits["equilibrium_glide"], glide, rtol=1e-9)


def test_prices_are_derivatives(limited):
    """Multipliers against plans beside: of the range, and of a limit for all nodes."""
    ahead, behind = (
        planned(first=(FIRST, 1.0), distance=DISTANCE + d) for d in (100.0, -100.0)
    )
    slope = float(ahead.roughness - behind.roughness) / 200.0
    assert float(limited.multiplier_of_distance) == pytest.approx(slope, rel=1e-5)

    def with_limit(n):
        raised = limits() | {"normal_load_factor": NormalLoadFactor(n)}
        return planned(first=(FIRST, 1.0), of=raised)

    n = 2.0 * GRAVITY / standard_gravity
    slope = (
        float(with_limit(n + 1e-5).roughness - with_limit(n - 1e-5).roughness) / 2e-5
    )
    per_limit = np.asarray(limited.limits["normal_load_factor"]) / n
    told = float(np.asarray(limited.multipliers["normal_load_factor"]) @ per_limit)
    assert told == pytest.approx(slope, rel=1e-4)


def test_lower_limit_binds():
    """A lower limit that the smoothest drag would go below, and which side it is on."""
    first, last = (FIRST, 3.0), (LAST, 7.0)
    plain = planned(first=first, last=last, distance=5200.0 * km, of={})
    assert plain.active == {}
    glide = {"equilibrium_glide": EquilibriumGlide(limit=0.0)}
    held = planned(first=first, last=last, distance=5200.0 * km, of=glide)
    nodes = held.active["equilibrium_glide"]
    limit = np.asarray(held.limits["equilibrium_glide"])
    np.testing.assert_allclose(
        np.asarray(held.drag.values)[nodes], limit[nodes], rtol=1e-12
    )
    assert np.all(np.asarray(held.multipliers["equilibrium_glide"])[nodes] > 0.0)
    assert np.all(np.asarray(held.drag.values) >= limit * (1.0 - 1e-12))
    assert np.any(np.asarray(plain.drag.values) < limit)
    assert float(held.roughness) > float(plain.roughness)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("degree", "bound"), [(16, 3e-4), (20, 5e-5), (24, 8e-6), (40, 3e-7)]
)
def test_degrees_converge(plan, degree, bound):
    """By a factor of six or more for each four degrees."""
    other = planned(degree=degree)
    v = jnp.linspace(LAST, FIRST, 101)
    found, expected = jax.vmap(other.drag)(v), jax.vmap(plan.drag)(v)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=bound)


def test_profile_beyond_its_ends(plan):
    """The values of the ends, flat; at the ends themselves the slopes of the polynomial."""
    for end, beyond in ((FIRST, FIRST + 80.0), (LAST, LAST - 10.0)):
        value, slope, bend = plan.drag.with_derivatives(jnp.asarray(beyond))
        assert float(value) == float(plan.drag(jnp.asarray(end)))
        assert float(slope) == 0.0 and float(bend) == 0.0
    made = CollocatedProfile(jnp.array([1.0, 0.0, 1.0]), 4.0, 2.0)  # (v - 3)^2
    for v in (4.0, 3.5, 3.0, 2.0):
        value, slope, bend = made.with_derivatives(jnp.asarray(v))
        assert float(value) == pytest.approx((v - 3.0) ** 2, abs=1e-15)
        assert float(slope) == pytest.approx(2.0 * (v - 3.0), abs=1e-14)
        assert float(bend) == pytest.approx(2.0, rel=1e-14)


def test_plan_says_what_it_is(limited):
    said = str(limited)
    assert "3000" in said and "roughness" in said


def raised(constraint, name):
    return limits() | {name: constraint}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"distance": 30000.0 * km},
            "a range of 30000 km is not in the corridor, which holds at most",
        ),
        (
            {"distance": 1000.0 * km},
            "a range of 1000 km is not in the corridor, which holds at least",
        ),
        (
            {"of": raised(NormalLoadFactor(0.9), "normal_load_factor")},
            "the corridor is closed at",
        ),
        (
            {"first": (FIRST, 40.0)},
            "first is 40 m/s2 of drag at 7450 m/s: heat_rate allows 0.9",
        ),
        (
            {"last": (LAST, 3.0)},
            "last is 3 m/s2 of drag at 760 m/s: equilibrium_glide allows 4.9",
        ),
        ({"first": (700.0, D0)}, "the velocity must fall"),
        ({"first": (FIRST, -1.0)}, "velocity and drag must be positive and finite"),
        ({"last": (LAST, np.nan)}, "velocity and drag must be positive and finite"),
        ({"distance": 0.0}, "distance is 0.0 m"),
        ({"degree": 2}, "degree is 2"),
        ({"distance": np.inf}, "distance is inf m"),
        (
            {"of": raised(EquilibriumGlide(limit=-500.0), "equilibrium_glide")},
            "equilibrium_glide is beyond its limit at .* m/s, whatever the drag",
        ),
    ],
)
def test_what_cannot_be_planned(change, words):
    with pytest.raises(ValueError, match=words):
        planned(**change)


def test_closed_corridor_names_both_limits():
    tight = raised(NormalLoadFactor(0.9), "normal_load_factor")
    with pytest.raises(
        ValueError, match=r"equilibrium_glide requires.*normal_load_factor"
    ):
        planned(of=tight)


def test_extreme_ranges_name_what_binds():
    with pytest.raises(ValueError, match="at most .*: equilibrium_glide bind"):
        planned(distance=30000.0 * km)
    with pytest.raises(ValueError, match="at least .*heat_rate and normal_load_factor"):
        planned(distance=1000.0 * km)
    with pytest.raises(ValueError, match=f"at most .*: {LEAST_DRAG} bind"):
        planned(distance=1e9, of={})


@eqx.filter_jit
def _over_velocity(made, velocity):
    return jax.vmap(made.at)(velocity)


def over_velocity(made, velocity):
    return _over_velocity(made, jnp.asarray(velocity))


def inverse(kind, plan):
    return kind(planet(), vehicle(), ScheduledAngleOfAttack(), plan.drag)


def flown(kind, plan):
    """Equations (1) to (3) with the inverse's lift, by scipy; and its first point."""
    made = inverse(kind, plan)
    grid = np.linspace(LAST, FIRST, 20001)
    up = over_velocity(made, grid).lift_to_drag_up
    first = made.at(jnp.asarray(FIRST))

    def rates(t, y):
        r, v, path = y
        drag, g = drag_of(r, v), GRAVITY * RADIUS**2 / r**2
        turn = drag / v * np.interp(v, grid, up) + (v**2 / r - g) * np.cos(path) / v
        return [v * np.sin(path), -drag - g * np.sin(path), turn]

    def over(t, y):
        return y[1] - LAST

    over.terminal = True
    start = [RADIUS + float(first.altitude), FIRST, float(first.flight_path_angle)]
    return made, solve_ivp(
        rates,
        (0.0, 2000.0),
        start,
        "DOP853",
        rtol=1e-10,
        atol=1e-8,
        events=over,
        max_step=1.0,
    )


@pytest.mark.slow
def test_exact_inverse_flies_the_profile(plan):
    made, flight = flown(ExactInverse, plan)
    r, v, path = flight.y
    profile = over_velocity(made, np.clip(v, LAST, FIRST))
    # The bound is a metre at the end; what is left is the table of the lift.
    assert abs(r[-1] - RADIUS - float(profile.altitude[-1])) < 0.05
    np.testing.assert_allclose(path, profile.flight_path_angle, rtol=0.0, atol=1e-6)
    wanted = jax.vmap(plan.drag)(jnp.asarray(v))
    np.testing.assert_allclose(drag_of(r, v), wanted, rtol=0.0, atol=1e-3)
    assert np.max(np.abs(profile.lift_to_drag_up / profile.lift_to_drag)) < 0.9


def test_small_angle_inverse_is_the_papers(plan):
    """It starts at -0.5 degrees and ends at 22.165 km and -6.9 degrees, 236 m too low."""
    made, flight = flown(SmallAngleInverse, plan)
    first = made.at(jnp.asarray(FIRST))
    assert float(first.altitude) == pytest.approx(68.10 * km, abs=5.0)
    assert np.degrees(first.flight_path_angle) == pytest.approx(-0.5, abs=1e-4)
    r, v, path = flight.y[:, -1]
    assert r - RADIUS == pytest.approx(22165.0, abs=1.0)
    assert np.degrees(path) == pytest.approx(-6.9, abs=0.03)
    profile = made.at(jnp.asarray(LAST))
    assert float(profile.altitude) - (r - RADIUS) == pytest.approx(236.0, abs=1.0)
    assert flight.t[-1] == pytest.approx(757.0, abs=0.5)


def test_corrected_equations_by_differences(plan):
    """(19) and (23) in numpy, with the derivatives of C_D by differences."""
    made = inverse(SmallAngleInverse, plan)
    v = np.linspace(900.0, 7400.0, 40)
    v = v[np.abs(v - 4570.0) > 5.0]
    found = over_velocity(made, v)
    h = 1.0
    c = coefficients(v)[1]
    c1 = (coefficients(v + h)[1] - coefficients(v - h)[1]) / (2.0 * h * c)
    c2 = (coefficients(v + h)[1] - 2.0 * c + coefficients(v - h)[1]) / (h * h * c)
    d, d1, d2 = (
        np.asarray(x) for x in jax.vmap(plan.drag.with_derivatives)(jnp.asarray(v))
    )
    beta = 1.0 / 6600.0
    path = (d1 - (2.0 / v + c1) * d) / (v * beta)
    np.testing.assert_allclose(found.flight_path_angle, path, rtol=0.0, atol=1e-7)
    r = RADIUS - 6600.0 * np.log(d * 2.0 * 104305.0 / (1.225 * 391.22 * v**2 * c))
    np.testing.assert_allclose(found.altitude, r - RADIUS, rtol=1e-10)
    bracket = 4.0 / v**2 + c1**2 + c1 / v - c2
    u = (-d2 + (3.0 / v + c1) * d1 - bracket * d) / beta
    u = u + (GRAVITY * RADIUS**2 / r**2 - v**2 / r) / d
    np.testing.assert_allclose(found.lift_to_drag_up, u, rtol=0.0, atol=1e-4)


def test_where_no_altitude_has_the_drag(plan):
    huge = dataclasses.replace(plan.drag, values=1e6 * plan.drag.values)
    made = ExactInverse(planet(), vehicle(), ScheduledAngleOfAttack(), huge)
    assert np.isnan(made.at(jnp.asarray(3000.0)).altitude)
