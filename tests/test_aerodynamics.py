"""Aerodynamic coefficients: polynomials, tables, and what tables refuse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import over
from worlds import (
    ANGLES,
    MACHS,
    all_aerodynamics,
    drag_of_table,
    lift_of_table,
    on_grid,
    tabulated_aerodynamics,
)

from jentry.world import PolynomialAerodynamics, TabulatedAerodynamics


AIRSPEED = jnp.asarray(2e3)
"""m/s; where it has no effect"""


@pytest.fixture(params=all_aerodynamics)
def aerodynamics(request):
    return all_aerodynamics[request.param]()


def _points(count):
    """Inside of the table and up to a fifth of its size outside."""
    key_angle, key_mach = jax.random.split(jax.random.key(0))
    angles = jax.random.uniform(key_angle, (count,), minval=-0.15, maxval=0.95)
    machs = jax.random.uniform(key_mach, (count,), minval=0.01, maxval=30.0)
    return angles, machs


# --- every kind --------------------------------------------------------------------


def test_gradient_matches_finite_differences(aerodynamics):
    def coefficients(point):
        return jnp.stack(aerodynamics.coefficients(*point, 300.0 * point[1]))

    value_at = jax.jit(coefficients)
    slope_at = jax.jit(jax.jacfwd(coefficients))
    step = 1e-6
    for angle, mach in zip(*_points(40), strict=True):
        point = jnp.stack([angle, mach])
        slopes = slope_at(point)
        for axis in range(2):
            move = step * jnp.eye(2)[axis]
            numeric = (value_at(point + move) - value_at(point - move)) / (2.0 * step)
            # Rounding of values near one over the step, 1e-10, and curvature.
            np.testing.assert_allclose(slopes[:, axis], numeric, rtol=1e-6, atol=1e-9)


def test_gradients_are_finite_everywhere(aerodynamics):
    angles, machs = _points(200)
    angles = jnp.concatenate([angles, ANGLES, ANGLES])
    machs = jnp.concatenate([machs, MACHS[:6], MACHS[1:]])
    slopes = over(jax.jacrev(aerodynamics.coefficients, argnums=(0, 1)))(
        angles, machs, machs
    )
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slopes))


def test_vmap_equals_loop(aerodynamics):
    angles, machs = _points(20)
    f = jax.jit(lambda a, m: jnp.stack(aerodynamics.coefficients(a, m, 300.0 * m)))
    loop = [[float(c) for c in f(a, m)] for a, m in zip(angles, machs, strict=True)]
    batch = over(f)(angles, machs)
    # The same operations in another order of fusion: rounding.
    np.testing.assert_allclose(batch, loop, rtol=1e-13, atol=1e-14)


# --- polynomials -------------------------------------------------------------------


def test_polynomials_start_with_the_constant_term():
    aerodynamics = PolynomialAerodynamics([-0.04, 0.8], [0.05, -0.1, 0.9])
    lift, drag = aerodynamics.coefficients(*map(jnp.asarray, (0.5, 7.0, 2e3)))
    assert float(lift) == pytest.approx(-0.04 + 0.8 * 0.5, rel=1e-15)  # rounding
    assert float(drag) == pytest.approx(0.05 - 0.1 * 0.5 + 0.9 * 0.25, rel=1e-15)


def test_polynomial_of_one_term_is_a_constant():
    aerodynamics = PolynomialAerodynamics([0.3], [1.1])
    lift, drag = aerodynamics.coefficients(*map(jnp.asarray, (0.5, 7.0, 2e3)))
    assert (float(lift), float(drag)) == (0.3, 1.1)


def test_polynomial_is_differentiable_in_its_coefficients():
    angle, mach = jnp.asarray(0.4), jnp.asarray(6.0)

    def drag(coefficients):
        return PolynomialAerodynamics([0.0], coefficients).coefficients(
            angle, mach, AIRSPEED
        )[1]

    slopes = jax.grad(drag)(jnp.asarray([0.05, -0.1, 0.9]))
    np.testing.assert_allclose(slopes, [1.0, 0.4, 0.16], rtol=1e-15)  # rounding


@pytest.mark.parametrize(
    ("lift", "drag", "message"),
    [
        ([], [1.0], r"lift_polynomial has shape \(0,\)"),
        ([1.0], [[1.0, 2.0]], r"drag_polynomial has shape \(1, 2\)"),
    ],
)
def test_polynomial_refuses(lift, drag, message):
    with pytest.raises(ValueError, match=message):
        PolynomialAerodynamics(lift, drag)


# --- tables ------------------------------------------------------------------------


def test_table_passes_through_its_values():
    table = tabulated_aerodynamics()
    lift, drag = over(
        lambda a: over(lambda m: table.coefficients(a, m, AIRSPEED))(MACHS)
    )(ANGLES)
    # Rounding.
    np.testing.assert_allclose(lift, table.lift_coefficients, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(drag, table.drag_coefficients, rtol=1e-14)


def test_table_of_a_product_of_straight_lines_is_exact():
    surface = on_grid(lambda a, m: (1.0 + 2.0 * a) * (3.0 - 0.1 * m))
    table = TabulatedAerodynamics(ANGLES, MACHS, surface, surface)
    angles, machs = _points(50)
    angles = jnp.clip(angles, ANGLES[0], ANGLES[-1])
    machs = jnp.clip(machs, MACHS[0], MACHS[-1])
    lift, _ = over(table.coefficients)(angles, machs, machs)
    expected = (1.0 + 2.0 * angles) * (3.0 - 0.1 * machs)
    np.testing.assert_allclose(lift, expected, rtol=1e-13)  # rounding


def test_table_comes_near_a_smooth_function():
    angles, machs = _points(300)
    angles = jnp.clip(angles, ANGLES[0], ANGLES[-1])
    machs = jnp.clip(machs, MACHS[0], MACHS[-1])
    lift, drag = over(tabulated_aerodynamics().coefficients)(angles, machs, machs)
    # Six angles up to 15 deg apart: second order next to the flat top of the lift.
    np.testing.assert_allclose(lift, over(lift_of_table)(angles, machs), atol=1.5e-2)
    np.testing.assert_allclose(drag, over(drag_of_table)(angles, machs), atol=1.5e-2)


def test_table_has_no_kinks_across_its_lines():
    table = tabulated_aerodynamics()
    read = lambda p: jnp.stack(table.coefficients(p[0], p[1], AIRSPEED))
    slope = jax.jit(jax.jacfwd(read))
    inner = [(ANGLES[2], jnp.asarray(3.3)), (jnp.asarray(0.3), MACHS[3])]
    for axis, (angle, mach) in enumerate(inner):
        move = 1e-9 * jnp.eye(2)[axis]
        point = jnp.stack([angle, mach])
        # The slope turns by its curvature times 2e-9.
        np.testing.assert_allclose(slope(point - move), slope(point + move), atol=1e-7)


def test_table_does_not_overshoot_a_step():
    step = jnp.broadcast_to(jnp.where(MACHS > 1.0, 1.0, 0.3), (6, 7))
    table = TabulatedAerodynamics(ANGLES, MACHS, step, step)
    machs = jnp.linspace(0.4, 25.0, 801)
    _, drag = over(lambda m: table.coefficients(jnp.asarray(0.2), m, AIRSPEED))(machs)
    assert np.all(np.diff(drag) >= -1e-15)  # rounding
    assert float(jnp.min(drag)) >= 0.3 - 1e-15
    assert float(jnp.max(drag)) <= 1.0 + 1e-15


@pytest.mark.parametrize(
    ("outside", "edge"),
    [
        ((-0.2, 3.0), (0.0, 3.0)),
        ((0.3, 90.0), (0.3, 25.0)),
        ((2.0, 0.0), (ANGLES[-1], 0.4)),
    ],
)
def test_table_is_held_at_its_edges(outside, edge):
    table = tabulated_aerodynamics()
    read = jax.jit(lambda angle, mach: table.coefficients(angle, mach, AIRSPEED))
    assert read(*map(jnp.asarray, outside)) == read(*map(jnp.asarray, edge))


def test_table_is_differentiable_in_its_values():
    table = tabulated_aerodynamics()
    angle, mach = jnp.asarray(0.31), jnp.asarray(3.7)

    @jax.jit
    def lift(values):
        return TabulatedAerodynamics(
            ANGLES, MACHS, values, table.drag_coefficients
        ).coefficients(angle, mach, AIRSPEED)[0]

    direction = jnp.cos(jnp.arange(42.0)).reshape(6, 7) * table.lift_coefficients
    _, slope = jax.jvp(lift, (table.lift_coefficients,), (direction,))
    ahead, behind = (
        lift(table.lift_coefficients + s * 1e-6 * direction) for s in (1.0, -1.0)
    )
    # Central differences of values near one with a step of 1e-6: nine digits.
    assert float(slope) == pytest.approx(float(ahead - behind) / 2e-6, abs=1e-8)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ([0.0, 0.1], [1.0, 2.0, 3.0], np.zeros((3, 2)), np.zeros((2, 3))),
            r"lift_coefficients has shape \(3, 2\): expected \(2, 3\), a row for each",
        ),
        (
            ([0.0, 0.1], [1.0, 2.0, 3.0], np.zeros((2, 3)), np.zeros(3)),
            r"drag_coefficients has shape \(3,\): expected \(2, 3\)",
        ),
        (
            ([0.1, 0.1], [1.0, 2.0], np.zeros((2, 2)), np.zeros((2, 2))),
            "angles_of_attack must increase: value 1 is 0.1 and the next one 0.1",
        ),
        (
            ([0.0, 0.1], [1.0], np.zeros((2, 1)), np.zeros((2, 1))),
            r"mach_numbers has shape \(1,\): expected one axis with two or more values",
        ),
    ],
)
def test_table_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        TabulatedAerodynamics(*arguments)


HEADER = "angle_of_attack_deg,mach,lift_coefficient,drag_coefficient\n"


def test_csv_is_read_in_any_order(tmp_path):
    path = tmp_path / "capsule.csv"
    path.write_text(HEADER + "10,5,.3,1.2\n0,5,0,1.1\n0,2,.1,1.0\n10,2,.4,1.3\n")
    table = TabulatedAerodynamics.from_csv(path)
    # Degrees to radians: rounding.
    np.testing.assert_allclose(table.angles_of_attack, [0.0, np.pi / 18.0], rtol=1e-15)
    np.testing.assert_array_equal(table.mach_numbers, [2.0, 5.0])
    np.testing.assert_array_equal(table.lift_coefficients, [[0.1, 0.0], [0.4, 0.3]])
    np.testing.assert_array_equal(table.drag_coefficients, [[1.0, 1.1], [1.3, 1.2]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mach\n1\n2\n", "capsule.csv, line 1: no column 'angle_of_attack_deg'"),
        (
            HEADER + "0,2,0,1\n0,3,0,1\n5,2,0,1\n",
            "capsule.csv: no row for 5 deg at Mach 3",
        ),
        (
            HEADER + "0,2,0,1\n0,3,0,1\n0,2,0,1\n",
            "capsule.csv, line 4: 0 deg at Mach 2 stands on line 2 already",
        ),
        (HEADER + "0,2,0,inf\n0,3,0,1\n", "line 2: drag_coefficient is 'inf'"),
    ],
)
def test_csv_errors_name_file_line_and_expectation(tmp_path, text, message):
    path = tmp_path / "capsule.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        TabulatedAerodynamics.from_csv(path)


# --- the fit over airspeed ----------------------------------------------------------


def test_lift_of_the_glider_tells_its_angle_of_attack():
    from jentry.missions.cav_h.scenario import glider

    aerodynamics = glider().aerodynamics
    for angle, speed in ((0.05, 2600.0), (0.2, 7500.0)):
        angle, mach, speed = (jnp.asarray(x) for x in (angle, 10.0, speed))
        lift, drag = aerodynamics.coefficients(angle, mach, speed)
        again = aerodynamics.angle_of_attack(lift, mach, speed)
        assert float(again) == pytest.approx(float(angle), rel=1e-14)
        # The printed fit, with the drag held below 10 degrees.
        decay = np.exp(-3.3943e-4 * float(speed))
        expected = 2.9451 * float(angle) + 0.2949 * decay - 0.2355
        assert float(lift) == pytest.approx(expected, rel=1e-13)
        held = max(float(angle), np.radians(10.0))
        expected = (
            2.3795 * held**2 + 0.3983 * np.exp(-1.0794e-3 * float(speed)) + 0.0234
        )
        assert float(drag) == pytest.approx(expected, rel=1e-13)
