"""Range tracking: the scale of the reference drag, and single decisions of the law."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import with_leaf
from range_trackings import in_plane, nominal, scenario, sensed, state_at

from jentry.flight import Outcome
from jentry.guidance import FixedCycle, ObserverDragTracking, RangeTracking
from jentry.guidance.lateral import predicted_crossrange
from jentry.guidance.range_tracking import scale_to_reach
from jentry.motion import energy, ground_track
from jentry.motion.index import TimeIndex
from jentry.units import km


# The scale.


@eqx.filter_jit
def scale_of(law, now, range_to_go, drag_factor):
    return scale_to_reach(
        law.aim,
        law.reference,
        law.range_flown,
        law.model,
        now,
        range_to_go,
        drag_factor,
        jnp.zeros_like(now),
    )


def scale_by_search(law, now, range_to_go, drag_factor):
    """The same by bisection: each profile is followed down to where its flight ends."""
    planet, aim = law.model.planet, law.aim
    E = np.linspace(-11.3e6, -12.6e6, 100_001)  # in it every flight here ends
    D, S = (np.asarray(jax.vmap(p)(E)) for p in (law.reference.drag, law.range_flown))
    potential = jax.jit(jax.vmap(planet.gravity.potential))
    ground_drag = drag_factor * planet.density(jnp.asarray(0.0))
    ground_drag = float(ground_drag / 115.0)

    def too_far(scale):
        altitude = np.full_like(E, 15 * km)
        for _ in range(20):  # kinetic energy hardly depends on the altitude
            kinetic = E - np.asarray(potential(planet.radius + altitude))
            kinetic = np.maximum(kinetic, 1e4)
            ratio = ground_drag * kinetic / (scale * D)
            altitude = 9354.5 * np.log(ratio)
        over = (kinetic <= 0.5 * aim.velocity**2) | (altitude <= aim.altitude)
        end = np.argmax(over)
        assert 0 < end
        return (S[end] - law.range_flown(now)) / scale - range_to_go

    lower, upper = 0.6, 1.6
    for _ in range(22):
        middle = 0.5 * (lower + upper)
        lower, upper = (middle, upper) if too_far(middle) > 0.0 else (lower, middle)
    return 0.5 * (lower + upper)


@pytest.mark.slow
@pytest.mark.parametrize("drag_factor", [0.6, 0.9, 1.1, 1.7])
@pytest.mark.parametrize(("second", "range_share"), [(70, 0.9), (70, 1.1), (150, 1.0)])
def test_scale_is_that_of_the_profile_that_ends_at_the_target(
    drag_factor, second, range_share
):
    law = in_plane().law
    state = state_at(nominal(), second)
    downrange, _ = ground_track(law.model.planet, law.aim.origin, state)
    range_to_go = range_share * (law.aim.downrange - downrange)
    now = energy(law.model.planet, state)
    scale = scale_of(law, now, range_to_go, jnp.asarray(drag_factor))
    searched = scale_by_search(law, now, range_to_go, drag_factor)
    # Four Newton steps leave 1e-3 where the density is 0.6 of that of the reference and
    # most of the range is behind; the grid of the search is good to 3e-5.
    np.testing.assert_allclose(
        scale, searched, rtol=2e-3 if drag_factor < 0.8 else 5e-5
    )


@pytest.mark.slow
@pytest.mark.parametrize("second", [45, 60, 100, 150, 190])
def test_nominal_flight_keeps_the_reference_as_it_is(second):
    law = in_plane().law
    measurement = sensed(in_plane(), state_at(nominal(), second))
    memory, held = law.init(measurement)
    _, decided = law.update(jnp.asarray(0.0), measurement, memory, held)
    # The interpolated range, and what the tracked flight is off its reference.
    np.testing.assert_allclose(decided.scale, 1.0, atol=3e-6)
    np.testing.assert_allclose(decided.lift_factor, 1.0, atol=1e-12)


def test_nominal_flight_ends_at_the_target():
    flight = nominal()
    assert flight.outcome == Outcome.REACHED
    target = in_plane().target
    assert abs(flight.state.longitude * 3397 * km - target.downrange) < 5.0
    assert abs(flight.state.altitude - target.altitude) < 5.0
    assert abs(flight.state.velocity - target.velocity) < 0.1


# The law.


def test_observer_sees_no_step_when_the_scale_jumps():
    law = scenario().law
    thick = with_leaf(scenario(), lambda s: s.planet.density_scale, 1.2)
    measurement = sensed(thick, state_at(nominal(), 80))
    memory, held = law.init(measurement)
    time = jnp.asarray(80.0)
    after, decided = law.update(time, measurement, memory, held)
    assert abs(decided.scale - held.scale) > 1e-3

    def innovation(memory, held):
        return law._track(time, measurement, memory, held).x1 - memory.drag_error

    # Rounding of a drag of 100 m/s2.
    np.testing.assert_allclose(
        innovation(after, decided), innovation(memory, held), atol=1e-10
    )
    # Over the energy the reference drag K D* has K times the rate.
    energy_rate = -measurement.drag * measurement.state.velocity
    _, slope, _ = law.reference.drag.with_derivatives(
        energy(law.model.planet, measurement.state)
    )
    np.testing.assert_allclose(
        after.drag_error_rate - memory.drag_error_rate,
        -(decided.scale - 1.0) * slope * energy_rate,
        rtol=1e-10,
    )


@pytest.mark.parametrize(
    ("second", "held_on"), [(10, True), (60, False), (200, False), (222, True)]
)
def test_scale_is_held_before_the_gate_and_close_to_the_end(second, held_on):
    law = scenario().law
    measurement = sensed(scenario(), state_at(nominal(), second))
    memory, held = law.init(measurement)
    held = with_leaf(held, lambda h: h.scale, 1.3)
    _, decided = law.update(jnp.asarray(0.0), measurement, memory, held)
    assert (decided.scale == held.scale) == held_on


@pytest.mark.parametrize(
    ("share", "limit"), [(4.0, "lower"), (0.6, "upper")], ids=["far", "near"]
)
def test_scale_stays_within_its_limits(share, limit):
    law = scenario().law
    state = state_at(nominal(), 100)
    downrange, _ = ground_track(law.model.planet, law.aim.origin, state)
    aim = downrange + share * (law.aim.downrange - downrange)
    law = eqx.tree_at(
        lambda law: (law.aim.downrange, law.limits.upper), law, (aim, jnp.asarray(1.2))
    )
    measurement = sensed(scenario(), state)
    memory, held = law.init(measurement)
    _, decided = law.update(jnp.asarray(0.0), measurement, memory, held)
    assert decided.scale == getattr(law.limits, limit)


def test_lift_to_drag_ratio_is_sensed():
    law = scenario().law
    weak = with_leaf(scenario(), lambda s: s.vehicle.lift_scale, 0.8)
    measurement = sensed(weak, state_at(nominal(), 70))
    memory, held = law.init(measurement)
    _, decided = law.update(jnp.asarray(0.0), measurement, memory, held)
    np.testing.assert_allclose(decided.lift_factor, 0.8, rtol=1e-12)


def decided_from(law, second, lift=1.0, drag=1.0, held=None):
    """Measurement with so many times the forces of the model, before and after it."""
    truth = sensed(scenario(), state_at(nominal(), second))
    measurement = dataclasses.replace(
        truth, lift=lift * truth.lift, drag=drag * truth.drag
    )
    memory, before = law.init(measurement)
    before = before if held is None else held(before)
    return measurement, law.update(jnp.asarray(0.0), measurement, memory, before)


def test_ratio_and_density_are_those_that_are_sensed():
    """Whatever makes them so: the law has its own model, and its sensors."""
    law = scenario().law
    measurement, (_, decided) = decided_from(law, 70, lift=0.7, drag=1.2)
    np.testing.assert_allclose(decided.lift_factor, 0.7 / 1.2, rtol=1e-12)
    downrange, _ = ground_track(law.model.planet, law.aim.origin, measurement.state)
    now = energy(law.model.planet, measurement.state)
    expected = scale_of(law, now, law.aim.downrange - downrange, jnp.asarray(1.2))
    # Compiled apart: rounding of the ranges, of which the scale is a ratio.
    np.testing.assert_allclose(decided.scale, expected, rtol=1e-9)
    assert abs(decided.scale - 1.0) > 1e-3


@pytest.mark.parametrize(("second", "held_on"), [(10, True), (60, False), (222, False)])
def test_ratio_is_held_before_the_gate_only(second, held_on):
    law = scenario().law
    held = lambda h: with_leaf(h, lambda h: h.lift_factor, 1.3)
    _, (_, decided) = decided_from(law, second, lift=0.9, held=held)
    np.testing.assert_allclose(decided.lift_factor, 1.3 if held_on else 0.9, rtol=1e-12)


def test_bank_is_computed_with_the_sensed_ratio():
    """As by the law in the plane whose model has that ratio, which knows no factor."""
    law = scenario().law
    measurement, _ = decided_from(law, 70)
    time = jnp.asarray(70.0)
    memory, held = law.init(measurement)
    held = with_leaf(held, lambda h: h.lift_factor, 0.8)
    model = with_leaf(law.model, lambda m: m.vehicle.lift_scale, 0.8)
    plain = ObserverDragTracking(law.gains, law.observer, law.reference, model)
    memory = eqx.tree_at(
        lambda m: (m.drag_error, m.drag_error_rate),
        memory,
        (memory.drag_error + 0.05, jnp.asarray(0.02)),
    )
    ours, our_rate = law(time, measurement, memory, held)
    theirs, their_rate = plain(time, measurement, memory)
    assert abs(theirs.cos_bank) < 1.0
    np.testing.assert_allclose(ours.cos_bank, theirs.cos_bank, rtol=1e-12)
    np.testing.assert_allclose(ours.sin_bank, theirs.sin_bank, rtol=1e-12)
    for one, other in zip(*map(jax.tree.leaves, (our_rate, their_rate)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    # With less lift the cosine that gives as much of it upwards is a larger one.
    unknowing, _ = law(time, measurement, memory, law.init(measurement)[1])
    assert abs(unknowing.cos_bank) < abs(ours.cos_bank)


@pytest.mark.parametrize(
    ("beyond", "before", "after"),
    [(1.0, -1.0, 1.0), (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0), (-1.0, 1.0, 1.0)],
)
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
def test_bank_is_reversed_where_the_flight_would_pass_the_aim(
    beyond, before, after, side
):
    """A metre beyond the corridor about the aim, and a metre within it; to the left of
    the aim it turns to the right, which is positive."""
    law = scenario().law
    state = state_at(nominal(), 100)
    velocity = float(state.velocity)
    downrange, _ = ground_track(law.model.planet, law.aim.origin, state)
    turned = with_leaf(state, lambda s: s.heading, 0.5 * jnp.pi - 0.04)
    passing = predicted_crossrange(
        law.model.planet, law.aim.origin, turned, law.aim.downrange - downrange
    )
    assert passing > 3 * km
    off = side * (300.0 + 4e-4 * velocity**2 + beyond)
    law = with_leaf(law, lambda law: law.aim.crossrange, passing - off)
    measurement = sensed(scenario(), turned)
    memory, held = law.init(measurement)
    held = with_leaf(held, lambda h: h.side, side * before)
    _, decided = law.update(jnp.asarray(0.0), measurement, memory, held)
    assert decided.side == side * after


def test_the_first_bank_is_to_the_chosen_side():
    law = scenario().law
    for side in (1.0, -1.0):
        chosen = with_leaf(law, lambda law: law.lateral.first_sign, side)
        measurement = sensed(scenario(), state_at(nominal(), 60))
        memory, held = chosen.init(measurement)
        assert held.side == side
        assert held.scale == held.lift_factor == 1.0
        controls, _ = chosen(jnp.asarray(60.0), measurement, memory, held)
        assert np.sign(controls.sin_bank) == side


def test_range_flown_is_that_of_the_reference_from_its_gate_on():
    law = scenario().law
    start = law.reference.drag.start
    # The first of samples 0.1 s apart, between which the drag grows by a few per cent.
    assert 1.0 < law.reference.drag(start) < 1.05
    assert law.range_flown.start == start
    for second in (60, 100, 150, 200):
        state = state_at(nominal(), second)
        downrange, _ = ground_track(law.model.planet, law.aim.origin, state)
        now = energy(law.model.planet, state)
        # The tracked flight is metres off its reference.
        np.testing.assert_allclose(law.range_flown(now), downrange, atol=10.0)


@pytest.mark.slow
def test_scale_has_the_derivatives_of_differences():
    law = scenario().law
    state = state_at(nominal(), 100)
    downrange, _ = ground_track(law.model.planet, law.aim.origin, state)
    to_go = law.aim.downrange - downrange
    now, factor = energy(law.model.planet, state), jnp.asarray(1.05)

    @eqx.filter_jit
    def slopes(law, *at):
        def scale(now, to_go, factor):
            return scale_of(law, now, to_go, factor)

        return jax.grad(scale, argnums=(0, 1, 2))(*at)

    at = [now, to_go, factor]
    for place, (slope, step) in enumerate(
        zip(slopes(law, *at), (100.0, 10.0, 1e-4), strict=True)
    ):
        up, down = (
            scale_of(law, *(x + s * step * (i == place) for i, x in enumerate(at)))
            for s in (1.0, -1.0)
        )
        # The table's cubic pieces, and rounding of 1 over the steps.
        np.testing.assert_allclose(slope, (up - down) / (2.0 * step), rtol=1e-5)
    # More way to go takes less drag, and in thicker air it ends higher.
    assert slopes(law, *at)[1] < 0.0


def test_a_scale_that_is_not_finite_leaves_the_one_before():
    law = scenario().law
    state = state_at(nominal(), 100)
    measurement = sensed(scenario(), state)
    memory, held = law.init(measurement)
    held = eqx.tree_at(lambda d: d.scale, held, jnp.asarray(1.1))
    broken = eqx.tree_at(
        lambda law: law.range_flown,
        law,
        jax.tree.map(lambda x: jnp.nan * x, law.range_flown),
    )
    time = jnp.asarray(100.0)
    update = eqx.filter_jit(lambda law: law.update(time, measurement, memory, held)[1])
    assert float(update(broken).scale) == 1.1
    assert float(update(law).scale) != 1.1


def test_period_and_index_are_checked():
    law = scenario().law
    fields = {field.name: getattr(law, field.name) for field in dataclasses.fields(law)}
    with pytest.raises(ValueError, match="period is 0.0 s"):
        RangeTracking(**{**fields, "cycle": FixedCycle(0.0)})
    over_time = eqx.tree_at(lambda r: r.index, law.reference, TimeIndex())
    with pytest.raises(ValueError, match="TimeIndex"):
        RangeTracking(**{**fields, "reference": over_time})
