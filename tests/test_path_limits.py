"""Bounds on the bank from path constraints."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import with_leaf

from jentry.guidance.path_limits import BankBounds, PathLimits
from jentry.missions.sx_2 import scenario as sx_2
from jentry.motion import (
    Controls,
    Drag,
    DynamicPressure,
    EntryState,
    EquilibriumGlide,
    HeatLoad,
    HeatRate,
    LoadFactor,
    NormalLoadFactor,
    PathPoint,
    entry_dynamics,
    usual_constraints,
)
from jentry.onboard import Factors, OnboardModel, measure
from jentry.units import km


PLANET = with_leaf(sx_2.earth(), lambda p: p.rotation_rate, 7.292e-5)
MODEL = OnboardModel(PLANET, sx_2.vehicle())
DOWN = EntryState(48 * km, 0.3, 0.2, 4500.0, -0.03, 1.1)
UP = EntryState(37 * km, 0.3, -0.4, 3000.0, 0.02, 0.4)
FREQUENCY = 0.04
LIMITED = {
    "heat_rate": HeatRate(500e3),
    "dynamic_pressure": DynamicPressure(12e3),
    "normal_load_factor": NormalLoadFactor(2.0),
    "load_factor": LoadFactor(1.5),
}
ANGLE, SLOPE = 0.35, 2e-5
"""Of attack at 4 km/s, rad; and over the velocity"""


def one(x):
    return jnp.asarray(x, dtype=float)


def flown(state, cosine):
    """A law's angle of attack over the state, at some bank that is not looked at."""
    angle = ANGLE + SLOPE * (state.velocity - 4000.0)
    return Controls(angle, cosine, one(0.6))


@eqx.filter_jit
def _bounds(model, state, constraints, factors, cosine):
    angle = flown(state, cosine).angle_of_attack
    measurement = measure(
        model.planet, model.vehicle, state, angle, constraints=constraints
    )
    limits = PathLimits(FREQUENCY)
    return limits.bounds(model, measurement, factors, lambda s: flown(s, cosine))


def bounds(constraints, state=DOWN, factors=Factors(), cosine=0.8, model=MODEL):
    found = _bounds(model, state, constraints, factors, one(cosine))
    return float(found.lower), float(found.upper)


# An independent computation: the motion in small steps, and differences along it.

SPACING, SUBSTEPS = 0.1, 2


@eqx.filter_jit
def along(model, constraints, state, cosine):
    """Values at five times about now, `SPACING` apart, at one cosine of the bank."""

    def rates(state):
        return entry_dynamics(model.planet, model.vehicle, state, flown(state, cosine))

    def moved(state, rate, step):
        return jax.tree.map(lambda x, r: x + step * r, state, rate)

    def values(state):
        point = PathPoint.of(model.planet, model.vehicle, state, flown(state, cosine))
        return {name: c.value(point) for name, c in constraints.items()}

    def advance(step):
        def substep(state, _):
            first = rates(state)
            second = rates(moved(state, first, 0.5 * step))
            third = rates(moved(state, second, 0.5 * step))
            fourth = rates(moved(state, third, step))
            mean = jax.tree.map(
                lambda a, b, c, d: (a + 2.0 * b + 2.0 * c + d) / 6.0,
                *(first, second, third, fourth),
            )
            return moved(state, mean, step), None

        def interval(state, _):
            state, _ = jax.lax.scan(substep, state, length=SUBSTEPS)
            return state, values(state)

        return jax.lax.scan(interval, state, length=2)[1]

    both_ways = jnp.array([1.0, -1.0]) * (SPACING / SUBSTEPS)
    return values(state), jax.vmap(advance)(both_ways)


def barriers(constraints, state, cosine, model=MODEL):
    """q'' + 2 w q' + w^2 (q - limit) of each constraint."""
    now, beside = along(model, constraints, state, one(cosine))
    found = {}
    for name, constraint in constraints.items():
        q, ((a, b), (c, d)) = float(now[name]), np.asarray(beside[name])
        first = (8.0 * (a - c) - (b - d)) / (12.0 * SPACING)
        second = (16.0 * (a + c) - (b + d) - 30.0 * q) / (12.0 * SPACING**2)
        w, limit = FREQUENCY, float(constraint.limit)
        found[name] = second + 2.0 * w * first + w * w * (q - limit)
    return found


def least_cosines(constraints, state, model=MODEL):
    """At which each of them is zero: it is affine, from its values at 0 and 1."""
    none, full = (barriers(constraints, state, c, model) for c in (0.0, 1.0))
    return {name: none[name] / (none[name] - full[name]) for name in constraints}


@pytest.mark.slow
@pytest.mark.parametrize("state", [DOWN, UP], ids=["down", "up"])
def test_the_least_cosine_is_that_of_the_barrier(state):
    """Of each constraint alone, and the largest of them together."""
    expected = least_cosines(LIMITED, state)
    assert all(abs(cosine) < 1.0 for cosine in expected.values())
    for name, constraint in LIMITED.items():
        lower, upper = bounds({name: constraint}, state)
        # The values, to 1e-15, over the square of 0.1 s and a gain of 2e-3/s2.
        assert lower == pytest.approx(expected[name], abs=2e-9)
        assert upper == 1.0
    together = bounds(LIMITED, state)
    assert together == pytest.approx((max(expected.values()), 1.0), abs=2e-9)


def test_the_bank_that_is_flown_does_not_matter():
    """The quantity is affine in the cosine, and so is its barrier."""
    found = [bounds(LIMITED, cosine=cosine) for cosine in (0.8, -0.3)]
    assert found[0] == pytest.approx(found[1], rel=1e-12)
    # In the middle the barrier is the mean of those at the ends.
    ends = [barriers(LIMITED, DOWN, cosine) for cosine in (-1.0, 0.0, 1.0)]
    for name in LIMITED:
        low, middle, high = (end[name] for end in ends)
        assert middle == pytest.approx(0.5 * (low + high), abs=1e-9 * abs(high - low))


def test_factors_are_of_the_density_and_of_lift_over_drag():
    """The whole factor of the drag is one of the density, also in the heat rate."""
    factors = Factors(lift=1.08, drag=1.2)
    actual = eqx.tree_at(
        lambda m: (m.planet.density_scale, m.vehicle.lift_scale),
        MODEL,
        (one(1.2), one(0.9)),
    )
    expected = least_cosines(LIMITED, DOWN, actual)
    for name, constraint in LIMITED.items():
        found = bounds({name: constraint}, factors=factors)[0]
        assert found == pytest.approx(expected[name], abs=2e-9)
        assert abs(found - bounds({name: constraint})[0]) > 0.02
    # They multiply what the model has of its own.
    own = bounds(LIMITED, model=actual)
    assert bounds(LIMITED, factors=factors) == pytest.approx(own, rel=1e-12)
    more = bounds(LIMITED, factors=factors, model=actual)
    both = Factors(lift=1.08**2, drag=1.2**2)
    assert more == pytest.approx(bounds(LIMITED, factors=both), rel=1e-12)


def test_what_has_no_limit_and_integrals_are_not_looked_at():
    without = {"heat_load": HeatLoad(1.0), "drag": Drag()}
    with_more = bounds({**without, **LIMITED})
    assert with_more == pytest.approx(bounds(LIMITED), rel=1e-12)


@pytest.mark.parametrize(
    ("constraints", "said"),
    [
        ({}, "there are none"),
        (usual_constraints(), "drag, dynamic_pressure, heat_rate, load_factor"),
        ({"heat_load": HeatLoad(1.0)}, "heat_load"),
    ],
    ids=["none", "no limit", "an integral"],
)
def test_nothing_to_keep_is_refused(constraints, said):
    with pytest.raises(ValueError, match=rf"none of them has one \({said}\)"):
        bounds(constraints)


def test_a_limit_far_away_bounds_nothing():
    assert bounds({"load_factor": LoadFactor(1e3)}) == (-1.0, 1.0)


def test_a_quantity_that_the_bank_does_not_move_bounds_nothing():
    """Without lift, however far the limit is exceeded."""
    blunt = with_leaf(MODEL, lambda m: m.vehicle.lift_scale, 0.0)
    assert bounds(LIMITED, model=blunt) == (-1.0, 1.0)
    assert bounds(LIMITED, factors=Factors(lift=0.0)) == (-1.0, 1.0)


def test_the_equilibrium_glide_bounds_from_above():
    """Its rate goes with the bank as well, so that the bound is that of the barrier where
    it is flown itself."""
    constraints = {"glide": EquilibriumGlide(0.3, limit=-1.32)}
    cosine = 0.5
    for _ in range(4):
        lower, cosine = bounds(constraints, cosine=cosine)
    assert lower == -1.0 and 0.1 < cosine < 0.9
    low, zero, high = (
        barriers(constraints, DOWN, c)["glide"] for c in (0.0, cosine, 1.0)
    )
    assert low < 0.0 < high
    assert abs(zero) < 1e-8 * (high - low)


# What becomes of a wish.


def test_a_wish_is_kept_between_the_bounds():
    for lower, upper, wish, kept in (
        (-0.2, 0.7, 0.3, 0.3),
        (-0.2, 0.7, -0.2, -0.2),
        (-0.2, 0.7, -0.9, -0.2),
        (-0.2, 0.7, 0.9, 0.7),
        # Where they exclude each other it is the lower one.
        (0.6, 0.1, -0.5, 0.6),
        (0.6, 0.1, 0.3, 0.6),
        (0.6, 0.1, 0.9, 0.6),
        # No cosine beyond one keeps any of them.
        (1.8, 1.0, 0.0, 1.0),
        (-1.0, -1.5, 0.0, -1.0),
        (-7.0, -1.5, 0.0, -1.0),
        (1.8, -3.0, 0.0, 1.0),
        (-9.0, 9.0, 1.5, 1.0),
    ):
        found = BankBounds(one(lower), one(upper)).kept(one(wish))
        assert float(found) == kept, (lower, upper, wish)
