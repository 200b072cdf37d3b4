"""The cubic Bézier path: ends, tangents, derivatives, and what is left of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.guidance import (
    BezierParameters,
    BezierPath,
    InnerPoints,
    PathPoint,
    bezier_parameters,
    inner_points,
    tangents_meet,
)


def point(along, altitude, cross, altitude_slope, cross_slope):
    numbers = (along, altitude, cross, altitude_slope, cross_slope)
    return PathPoint(*(jnp.asarray(x, dtype=float) for x in numbers))


START = point(0.1, 50e3, 2e-4, -2e3, -1e-3)
TARGET = point(0.98, 25e3, 0.0, -66.98e3, 2e-4)
PARAMETERS = BezierParameters(k1=0.848, k2=0.717)
PATH = BezierPath.between(START, TARGET, inner_points(PARAMETERS, START, TARGET))


def numbers(tree):
    return np.array([float(leaf) for leaf in jax.tree.leaves(tree)])


def test_ends_and_tangents_are_met():
    for tau, end in ((0.0, START), (1.0, TARGET)):
        np.testing.assert_allclose(
            numbers(PATH.point(jnp.asarray(tau))), numbers(end), rtol=1e-13, atol=1e-17
        )


def test_inner_points_lie_on_the_tangents_where_k1_and_k2_say():
    meet = float(tangents_meet(START, TARGET))
    # Both tangents have the same altitude there.
    from_start = 50e3 - 2e3 * meet
    from_target = 25e3 + 66.98e3 * (0.88 - meet)
    assert from_start == pytest.approx(from_target, rel=1e-13)
    assert float(PATH.along[1]) == pytest.approx(0.1 + 0.848 * meet, rel=1e-14)
    assert float(PATH.along[2]) == pytest.approx(
        0.1 + meet + 0.717 * (0.88 - meet), rel=1e-14
    )
    again = bezier_parameters(PATH.inner, START, TARGET)
    np.testing.assert_allclose(numbers(again), [0.848, 0.717], rtol=1e-13)


def test_slopes_are_the_derivatives_of_the_curve():
    """Over the angle along the track, first and second, by automatic differentiation."""

    def along(t):
        return PATH.point(t).along

    for tau in (0.0, 0.2, 0.65, 1.0):
        tau = jnp.asarray(tau)
        for name, slope, second in (
            ("altitude", "altitude_slope", 0),
            ("cross", "cross_slope", 1),
        ):

            def over_along(t, name=name):
                rise = jax.grad(lambda t: getattr(PATH.point(t), name))(t)
                return rise / jax.grad(along)(t)

            first = getattr(PATH.point(tau), slope)
            assert float(first) == pytest.approx(float(over_along(tau)), rel=1e-12)
            bend = jax.grad(over_along)(tau) / jax.grad(along)(tau)
            ours = PATH.second_slopes(tau)[second]
            assert float(ours) == pytest.approx(float(bend), rel=1e-10)


def test_second_slope_at_the_start_has_a_closed_form():
    """What the notes to the paper derive for a curve that begins at the vehicle."""
    inner = PATH.inner
    x1, x2 = float(inner.first), 0.88 - float(inner.last)
    bend = (2 / 3) * (25e3 - (0.88 - x2) * -66.98e3 - 50e3 - -2e3 * x2) / x1**2
    assert float(PATH.second_slopes(jnp.asarray(0.0))[0]) == pytest.approx(bend)


def test_what_is_left_is_the_same_curve():
    rest = PATH.after(jnp.asarray(0.37))
    for tau in (0.0, 0.4, 1.0):
        on_whole = PATH.point(jnp.asarray(0.37 + 0.63 * tau))
        np.testing.assert_allclose(
            numbers(rest.point(jnp.asarray(tau))), numbers(on_whole), rtol=1e-11
        )
    # And it is the curve between its ends with its own inner points.
    again = BezierPath.between(PATH.point(jnp.asarray(0.37)), TARGET, rest.inner)
    np.testing.assert_allclose(numbers(again), numbers(rest), rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("step", [1e-6, 1e-3, 0.05])
def test_parameter_of_a_place_ahead(step):
    """A guidance cycle moves the vehicle by 1e-3 of the globe's radius."""
    along = START.along + step
    tau = PATH.parameter_at(along)
    assert float(PATH.point(tau).along) == pytest.approx(float(along), rel=1e-14)


def test_parallel_tangents_have_inner_points_but_no_parameters():
    parallel = point(0.1, 50e3, 0.0, -66.98e3, 0.0)
    path = BezierPath.between(
        parallel, TARGET, InnerPoints(jnp.asarray(0.2), jnp.asarray(0.2))
    )
    assert np.all(np.isfinite(numbers(path.second_slopes(jnp.asarray(0.3)))))
    assert not np.isfinite(float(tangents_meet(parallel, TARGET)))
