"""Path constraints that are kept in flight by the bank."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, with_leaf

from jentry.fields import Scalar, scalar
from jentry.flight import Outcome
from jentry.guidance import (
    AbstractSampledLaw,
    ConstantBankShape,
    FixedCycle,
    FixedSide,
    GuidedEnd,
    PredictorCorrector,
)
from jentry.guidance.open_loop import vertical_lift_command
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
    ground_track,
    usual_constraints,
)
from jentry.motion.forces import air_data
from jentry.onboard import Factors, OnboardModel, measure
from jentry.units import degree, km


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


class Wishing(AbstractSampledLaw[tuple[()], BankBounds]):
    """A constant bank, within bounds by what is sensed: with `trust` 0 by the model."""

    model: OnboardModel
    limits: PathLimits = PathLimits(0.05)
    cos_bank: Scalar = scalar(float(np.cos(80.0 * degree)))
    trust: Scalar = scalar(1.0)
    cycle: FixedCycle = FixedCycle(1.0)

    def init(self, measurement):
        nothing = 0.0 * measurement.drag
        return (), BankBounds(nothing - 1.0, nothing + 1.0)

    def update(self, time, measurement, memory, held):
        angle = measurement.trim_angle_of_attack
        believed = air_data(
            self.model.planet, self.model.vehicle, measurement.state, angle
        )
        factors = Factors(
            1.0 + self.trust * (measurement.lift / believed.lift - 1.0),
            1.0 + self.trust * (measurement.drag / believed.drag - 1.0),
        )

        def wanted(state):
            return vertical_lift_command(self.cos_bank, angle)

        return (), self.limits.bounds(self.model, measurement, factors, wanted)

    def __call__(self, time, measurement, memory, held):
        cosine = held.kept(self.cos_bank)
        return vertical_lift_command(cosine, measurement.trim_angle_of_attack), ()


NONE = {"heat_rate": 1e12, "dynamic_pressure": 1e12, "normal_load_factor": 1e6}
"""Limits that nothing comes near"""


def steep_entry(limits, density=1.0, **changes):
    """Of SX-2 with a bank of 80 degrees as a wish."""
    nominal = sx_2.entry()
    law = Wishing(OnboardModel(nominal.planet, nominal.vehicle), **changes)
    kinds = HeatRate, DynamicPressure, NormalLoadFactor
    limits = (NONE | limits).items()
    constraints = {
        name: kind(limit) for kind, (name, limit) in zip(kinds, limits, strict=True)
    }
    scenario = dataclasses.replace(nominal, guidance=law, constraints=constraints)
    steep = with_leaf(scenario, lambda s: s.initial_state.flight_path_angle, -0.0175)
    return with_leaf(steep, lambda s: s.planet.density_scale, density)


def peaks(limits, density=1.0, **changes):
    flight = fly_compiled(steep_entry(limits, density, **changes))
    assert int(flight.outcome) == Outcome.REACHED
    return {name: float(peak) for name, peak in flight.peaks.items()}


ALLOWED = {
    "heat_rate": 500e3,
    "dynamic_pressure": 8e3,
    "normal_load_factor": 2.5,
}
OVERSHOOT = 2.5e-3
"""Of a limit, at most: the square of the cycle, 1 s, times the frequency, 0.05/s"""


@pytest.mark.parametrize("name", ALLOWED)
def test_a_limit_is_kept_in_flight(name):
    """And come near to: what is wished for is far beyond it."""
    limit = ALLOWED[name]
    assert peaks({})[name] > 1.4 * limit
    found = peaks({name: limit})[name]
    assert 0.99 * limit < found < (1.0 + OVERSHOOT) * limit


def test_all_limits_are_kept_in_flight():
    found = peaks(ALLOWED)
    for name, limit in ALLOWED.items():
        assert found[name] < (1.0 + OVERSHOOT) * limit


def test_limits_are_kept_in_denser_air_by_what_is_sensed():
    """By the model alone, which believes less pressure and less of a rise, it is not."""
    limit = ALLOWED["dynamic_pressure"]
    given = {"dynamic_pressure": limit}, 1.25
    assert peaks(*given)["dynamic_pressure"] < (1.0 + OVERSHOOT) * limit
    assert peaks(*given, trust=0.0)["dynamic_pressure"] > 1.05 * limit


@pytest.fixture(scope="module")
def within():
    """A law whose prediction flies within limits that pull it up, and two functions: the
    end of that, with its derivative by the number of the bank and the density, and the end
    of the flight; both as downrange and crossrange."""
    scenario = steep_entry(ALLOWED)
    wish = scenario.guidance
    planet, vehicle = wish.model.planet, wish.model.vehicle
    law = PredictorCorrector(
        model=wish.model,
        shape=ConstantBankShape(lowest=float(wish.cos_bank)),
        end=GuidedEnd(energy=sx_2.energies()[1]),
        lateral=FixedSide(),
        limits=wish.limits,
        foresees_limits=True,
        cycle=wish.cycle,
        step=wish.cycle.period,
        steps=1600,
    )
    seen = measure(
        planet,
        vehicle,
        scenario.initial_state,
        vehicle.trim_angle_of_attack,
        constraints=scenario.constraints,
    )

    def track(state):
        return jnp.stack(ground_track(planet, scenario.initial_state, state))

    @eqx.filter_jit
    def foreseen(law, given, direction):
        def place(given):
            numbers, factors = given[:1], Factors(given[1], given[1])
            zero = 0.0 * seen.drag
            end = law.predicted(zero, seen, factors, numbers, 1.0, True)
            return track(end.state), end.has_end

        end, slope, has_end = jax.jvp(place, (given,), (direction,), has_aux=True)
        return jnp.where(has_end, end, jnp.nan), slope

    return law, foreseen, lambda: track(fly_compiled(scenario).state)


@pytest.mark.slow
def test_what_is_foreseen_within_the_limits_is_flown(within):
    """The rest of the flight at a bank, whose limits pull it up."""
    law, foreseen, flown = within
    blind = dataclasses.replace(law, foresees_limits=False)
    as_it_is = jnp.array([0.0, 1.0]), jnp.zeros(2)
    ends = np.stack([foreseen(each, *as_it_is)[0] for each in (law, blind)])
    off = np.linalg.norm(ends - np.asarray(flown()), axis=1)
    # Both decide at the start of each second, and take a step of the same method in it:
    # what remains of 6000 km is rounding. The limits move the end by 1000 km.
    assert off[0] < 1e-5 and off[1] > 900 * km


@pytest.mark.slow
@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, 1.0)], ids=["bank", "density"])
def test_what_is_foreseen_within_the_limits_has_its_derivative(within, direction):
    law, foreseen, _ = within
    given, direction, h = jnp.array([0.05, 1.03]), jnp.array(direction), 1e-5
    _, slope = foreseen(law, given, direction)
    above, below = (foreseen(law, given + d * direction, direction)[0] for d in (h, -h))
    # To a rounding of some 1e-8 m at 6000 km.
    differences = (above - below) / (2.0 * h)
    np.testing.assert_allclose(slope, differences, rtol=1e-6, atol=2e-3)
    assert np.max(np.abs(slope)) > 1 * km
