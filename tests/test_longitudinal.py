"""The motion in the vertical plane: rates, linear model and reference of the X-33 case.

Expected: equations (1) to (5) and (10) of the paper with r_E / r, in a few lines of numpy.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drag_profiles import RADIUS, coefficients, drag_of
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from jentry.missions.x_33 import scenario as x_33
from jentry.onboard import (
    LongitudinalReference,
    LongitudinalState,
    PolynomialProfile,
)
from jentry.onboard.longitudinal import Units, linearized
from jentry.onboard.profiles import JoinedProfile
from jentry.planning import fly_longitudinal, plan_bank_over_velocity
from jentry.units import degree


MU = 9.81 * RADIUS**2


def rates(y, u):
    """r, v, gamma and s over the ground; u is the lift upwards over the drag."""
    r, v, path, _ = y
    drag, gravity = drag_of(r, v), MU / r**2
    return np.array(
        [
            v * np.sin(path),
            -drag - gravity * np.sin(path),
            drag / v * u + (v**2 - MU / r) * np.cos(path) / (r * v),
            v * np.cos(path) * RADIUS / r,
        ]
    )


SOMEWHERE = (60e3, 5000.0, -1.3 * degree, 7e5), (30e3, 1500.0, -4.0 * degree, 2e6)


@pytest.mark.parametrize("at", SOMEWHERE)
def test_rates(at):
    found = x_33.model().rates(LongitudinalState(*at), jnp.asarray(0.4))
    y = np.array([RADIUS + at[0], *at[1:]])
    np.testing.assert_allclose(jax.tree.leaves(found), rates(y, 0.4), rtol=1e-12)


@pytest.mark.parametrize("at", SOMEWHERE)
def test_linear_model(at):
    """Central differences of the equations above, without dimensions."""
    state, u = LongitudinalState(*at), 0.4
    a, b = jax.jit(linearized)(x_33.model(), state, jnp.asarray(u))
    time = np.sqrt(RADIUS / 9.81)
    sizes = np.array([RADIUS, RADIUS / time, 1.0, RADIUS])
    y = np.array([RADIUS + at[0], *at[1:]])
    for column in range(4):
        # 6 m, 0.8 m/s, 1e-4 rad.
        step = np.eye(4)[column] * 1e-6 * sizes * (100.0 if column in (1, 2) else 1.0)
        slope = (rates(y + step, u) - rates(y - step, u)) / (2.0 * step[column])
        expected = time * slope / sizes * sizes[column]
        np.testing.assert_allclose(a[:, column], expected, rtol=2e-5, atol=1e-6)
    slope = (rates(y, u + 0.1) - rates(y, u - 0.1)) / 0.2
    np.testing.assert_allclose(b[:, 0], time * slope / sizes, rtol=1e-9, atol=1e-12)
    again = Units.of(x_33.earth()).state(Units.of(x_33.earth()).vector(state))
    np.testing.assert_allclose(jax.tree.leaves(again), at, rtol=1e-14)


@pytest.fixture(scope="module")
def flown():
    """The reference of the mission, and the same flight by scipy under the same bank."""
    reference = x_33.reference()
    cosine = jax.jit(jax.vmap(x_33.cos_bank()))
    grid = [np.linspace(760.0, 4570.0, 20001), np.linspace(4570.0, 7450.0, 20001)]
    inside = np.where(grid[0] == 4570.0, np.nextafter(4570.0, 0.0), grid[0]), grid[1]
    # Smooth between its points, so that the integration has the accuracy asked for.
    read = [
        CubicSpline(v, np.asarray(cosine(jnp.asarray(at))))
        for v, at in zip(grid, inside, strict=True)
    ]
    y = np.array([RADIUS + float(reference.altitude[0, 0]), 7450.0, 0.0, 0.0])
    y[2] = float(reference.flight_path_angle[0, 0])
    start, solutions = 0.0, []
    for part, last in ((1, 4570.0), (0, 760.0)):

        def slope(_, y, part=part):
            lift, drag = coefficients(y[1])
            return rates(y, read[part](y[1]) * lift / drag)

        def at_end(_, y, last=last):
            return y[1] - last

        at_end.terminal = True
        solved = solve_ivp(
            slope,
            (start, 2000.0),
            y,
            "DOP853",
            rtol=1e-11,
            atol=1e-9,
            events=at_end,
            dense_output=True,
            max_step=2.0,
        )
        solutions.append(solved)
        start, y = solved.t[-1], solved.y[:, -1]
    return reference, solutions


def test_reference_is_the_flight(flown):
    """Between the nodes too; the bars are a hundredth of what the laws leave."""
    reference, solutions = flown
    read = jax.jit(jax.vmap(lambda time: reference.at(time)))
    for solved in solutions:
        times = np.linspace(solved.t[0] + 1e-6, solved.t[-1] - 1e-6, 301)
        point = read(jnp.asarray(times))
        r, v, path, s = solved.sol(times)
        np.testing.assert_allclose(point.state.altitude, r - RADIUS, rtol=0, atol=0.05)
        np.testing.assert_allclose(point.state.velocity, v, rtol=0, atol=0.005)
        np.testing.assert_allclose(
            np.degrees(point.state.flight_path_angle),
            np.degrees(path),
            rtol=0,
            atol=5e-5,
        )
        np.testing.assert_allclose(point.state.downrange, s, rtol=0, atol=0.5)
    # At the nodes there is no interpolation.
    last = solutions[-1].y[:, -1]
    end = jax.tree.leaves(reference.end)
    np.testing.assert_allclose(end[0], last[0] - RADIUS, rtol=0, atol=1e-3)
    np.testing.assert_allclose(end[1:], last[1:], rtol=1e-9)
    joint = reference.ends[reference.altitude.shape[0] // 2]
    assert float(joint) == pytest.approx(solutions[0].t[-1], abs=1e-7)


def test_reference_ends_as_the_paper_says(flown):
    """22.165 km and -6.899 degrees, of which the notes have -6.92; 757 s."""
    reference, _ = flown
    end = reference.end
    assert float(end.altitude) == pytest.approx(22_165.0, abs=1.0)
    assert float(end.flight_path_angle) / degree == pytest.approx(-6.92, abs=0.005)
    assert float(end.velocity) == pytest.approx(760.0, abs=1e-6)
    assert float(reference.ends[-1]) == pytest.approx(757.0, abs=0.5)


def test_control_jumps_where_the_coefficient_bends(flown):
    """By 3.5 % at 4570 m/s."""
    reference, _ = flown
    half = reference.altitude.shape[0] // 2
    before = float(reference.lift_to_drag_up[half - 1, -1])
    after = float(reference.lift_to_drag_up[half, 0])
    assert after / before == pytest.approx(1.0 - 0.035, abs=0.001)
    joint = reference.ends[half]
    read = eqx.filter_jit(reference.in_part)
    assert float(read(jnp.asarray(half - 1), joint).lift_to_drag_up) == before
    assert float(read(jnp.asarray(half), joint).lift_to_drag_up) == after
    assert float(reference.at(joint).lift_to_drag_up) == after
    # It stays beyond its ends.
    for time, column in ((-5.0, 0), (800.0, -1)):
        point = reference.at(jnp.asarray(time))
        assert float(point.state.altitude) == float(reference.altitude[column, column])


def test_joined_profiles():
    low, high = PolynomialProfile([1.0, 2.0]), PolynomialProfile([0.0, 0.0, 3.0])
    joined = JoinedProfile((low, high), jnp.array([1.0, 2.0, 4.0]))
    for index, expected in (
        (0.5, (3.0, 0.0, 0.0)),
        (1.0, (3.0, 2.0, 0.0)),
        (1.5, (4.0, 2.0, 0.0)),
        (2.0, (12.0, 12.0, 6.0)),
        (4.0, (48.0, 24.0, 6.0)),
        (4.5, (48.0, 0.0, 0.0)),
    ):
        found = joined.with_derivatives(jnp.asarray(index))
        np.testing.assert_allclose(found, expected, atol=1e-14)
        slope = jax.grad(joined)(jnp.asarray(index))
        assert float(slope) == pytest.approx(expected[1], abs=1e-14)
    assert [int(joined.part(jnp.asarray(x))) for x in (0.0, 1.9, 2.0, 9.0)] == [
        0,
        0,
        1,
        1,
    ]
    with pytest.raises(ValueError, match="2 parts have one end more"):
        JoinedProfile((low, high), jnp.array([1.0, 2.0]))


@pytest.mark.slow
def test_flights_that_there_are_not():
    """More lift than there is, a drag that no altitude has, and a velocity that rises."""
    inverse = x_33.inverse(exact=True)
    ends = jnp.array([760.0, 4570.0, 7450.0])
    planned = x_33.plan(1.0).drag
    none = dataclasses.replace(planned, values=-planned.values)
    for drag, words in ((planned, ""), (none, "nan: there is no such flight")):
        wish = dataclasses.replace(inverse, drag=drag)
        with pytest.raises(
            ValueError, match=f"requires a cosine of the bank of {words}"
        ):
            plan_bank_over_velocity(wish, ends)
    # It falls faster and faster, or climbs until the velocity no longer falls.
    for angle in (-60.0, 30.0):
        start = LongitudinalState(60e3, 4600.0, angle * degree)
        with pytest.raises(ValueError, match="its velocity must fall all the time"):
            fly_longitudinal(x_33.model(), x_33.cos_bank(), start, 760.0)
    with pytest.raises(ValueError, match=r"downrange has shape \(2, 3\)"):
        LongitudinalReference(
            jnp.arange(3.0), *3 * [jnp.ones((2, 4))], jnp.ones((2, 3)), jnp.ones((2, 4))
        )
