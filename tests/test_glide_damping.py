"""Damping of the phugoid: the altitude rate of the glide, the bank, and what it damps."""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, with_leaf

from jentry._computed_once import computed_once
from jentry.flight import FixedStep
from jentry.guidance import ConstantBankShape, FixedSide, GlideDamping
from jentry.missions.cav_h.predictor_corrector import guided
from jentry.missions.cav_h.scenario import earth, glider
from jentry.missions.mars.predictor_corrector import networked
from jentry.missions.x_33.predictor_corrector import guided as x_33
from jentry.motion import Controls, EntryState
from jentry.motion.dynamics import entry_dynamics
from jentry.onboard import Factors, OnboardModel, measure
from jentry.units import degree, km


ANGLE = 7.0 * degree


def number(x):
    return jnp.asarray(x, float)


def at(altitude=40 * km, velocity=6000.0, path=-0.3 * degree):
    return EntryState(*map(number, (altitude, 0.3, -0.2, velocity, path, 1.0)))


@computed_once
def model():
    return OnboardModel(earth(), glider())


@eqx.filter_jit
def flown(damping, state, cosine, factors=Factors(), of=None):
    of = model() if of is None else of
    return damping.cos_bank(of, factors, state, number(ANGLE), number(cosine))


# One bank


def by_hand(ratio, state, cosine, lift_factor=1.0, drag_factor=1.0):
    """The glider of the mission in its exponential atmosphere, in plain numbers."""
    h, v = float(state.altitude), float(state.velocity)
    r, scale = 6371e3 + h, 7200.0
    g = 9.80665 * (6371e3 / r) ** 2
    tail = 0.2949 * math.exp(-3.3943e-4 * v)
    lift_coefficient = 2.9451 * ANGLE + tail - 0.2355
    # Below 10 degrees the drag is that at 10 degrees.
    drag_coefficient = (
        2.3795 * (10 * degree) ** 2 + 0.3983 * math.exp(-1.0794e-3 * v) + 0.0234
    )
    per_coefficient = 0.5 * 1.225 * math.exp(-h / scale) * v * v * 0.4839 / 907.0
    lift = lift_factor * per_coefficient * lift_coefficient
    drag = drag_factor * per_coefficient * drag_coefficient
    lift_over_v = 2.0 * lift / v - lift_factor * per_coefficient * 3.3943e-4 * tail
    over_h = -lift * cosine / scale + 2.0 * g / r - v * v / r**2
    over_v = lift_over_v * cosine + 2.0 * v / r
    glides = over_v * drag / over_h
    rises = v * math.sin(float(state.flight_path_angle))
    return cosine - 2.0 * ratio * math.sqrt(-over_h) * (rises - glides) / lift


@pytest.mark.parametrize("path", [-0.9, -0.3, 0.1])
@pytest.mark.parametrize(("altitude", "velocity"), [(44, 7000.0), (30, 3300.0)])
def test_bank_is_that_of_a_few_lines_of_numbers(path, altitude, velocity):
    state = at(altitude * km, velocity, path * degree)
    expected = by_hand(0.7, state, 0.4)
    assert -1.0 < expected < 1.0
    assert abs(expected - 0.4) > 0.02
    found = float(flown(GlideDamping(), state, 0.4))
    assert found == pytest.approx(expected, rel=1e-11)


def test_factors_are_those_of_the_sensed_forces():
    expected = by_hand(0.5, at(), 0.4, 1.2, 0.9)
    found = flown(GlideDamping(0.5), at(), 0.4, Factors(1.2, 0.9))
    assert float(found) == pytest.approx(expected, rel=1e-11)


def test_a_vehicle_that_sinks_too_fast_is_held_up_and_one_that_rises_is_pushed_down():
    sinks, rises = (
        float(flown(GlideDamping(), at(path=path), 0.4))
        for path in (-1.0 * degree, 0.5 * degree)
    )
    assert sinks > 0.4 > rises


def test_without_a_ratio_it_is_the_bank_that_is_asked_for():
    for cosine in (-0.3, 0.123456789, 0.9):
        assert float(flown(GlideDamping(0.0), at(), cosine)) == cosine


def test_where_nothing_swings_it_is_as_well():
    # Too thin an air, a lift downwards, and no lift at all.
    assert float(flown(GlideDamping(), at(250 * km), 0.4)) == 0.4
    assert float(flown(GlideDamping(), at(), -0.4)) == -0.4
    free = with_leaf(model(), lambda m: m.vehicle.lift_scale, 0.0)
    assert float(flown(GlideDamping(), at(), 0.4, of=free)) == 0.4


def test_it_is_a_bank_up_to_the_largest():
    damping = GlideDamping(lowest=math.cos(85 * degree))
    assert float(flown(damping, at(path=-10 * degree), 0.4)) == 1.0
    largest = float(flown(damping, at(path=10 * degree), 0.4))
    assert largest == pytest.approx(math.cos(85 * degree), abs=1e-15)
    # A shape that banks more than that is not turned back.
    assert float(flown(damping, at(path=10 * degree), 0.01)) == 0.01


@pytest.mark.parametrize("ratio", [0.0, 0.4, 1.5])
def test_eigenvalues_are_those_of_the_ratio(ratio):
    """Without drag the glide is level; of altitude and path angle, at one velocity."""
    free = with_leaf(model(), lambda m: m.vehicle.drag_scale, 1e-15)
    damping = GlideDamping(ratio)

    @eqx.filter_jit
    def linear(free, damping, numbers):
        angle, cosine = number(ANGLE), number(0.5)

        def rates(numbers):
            state = at(numbers[0], 6000.0, numbers[1])
            cos_bank = damping.cos_bank(free, Factors(), state, angle, cosine)
            controls = Controls(angle, cos_bank, jnp.sqrt(1.0 - cos_bank**2))
            moved = entry_dynamics(free.planet, free.vehicle, state, controls)
            return jnp.stack([moved.altitude, moved.flight_path_angle])

        return rates(numbers), jax.jacfwd(rates)(numbers)

    here = np.array([35 * km, 0.0])
    for _ in range(30):  # to the altitude at which it glides
        value, slope = linear(free, damping, here)
        here = here - np.linalg.solve(slope, value)
    assert 25 * km < here[0] < 55 * km
    found = np.linalg.eigvals(np.asarray(linear(free, damping, here)[1]))
    # w^2 of the notes: v^2 / r holds up what the lift does not.
    radius = 6371e3 + float(here[0])
    gravity = 9.80665 * (6371e3 / radius) ** 2
    lifted = gravity - 6000.0**2 / radius
    frequency = math.sqrt(
        lifted / 7200.0 - 2.0 * gravity / radius + 6000.0**2 / radius**2
    )
    expected = np.roots([1.0, 2.0 * ratio * frequency, frequency**2])
    np.testing.assert_allclose(
        np.sort_complex(found), np.sort_complex(expected), rtol=1e-9
    )


def test_gradient_matches_differences():
    @eqx.filter_jit
    def of(model, x):
        state = at(x[0] * km, 1e3 * x[1], x[2])
        return GlideDamping(x[3]).cos_bank(
            model, Factors(x[4], x[5]), state, x[6], x[7]
        )

    bank = functools.partial(of, model())

    x = jnp.array([40.0, 6.0, -0.005, 0.7, 1.1, 0.9, ANGLE, 0.4])
    direction = jnp.array([0.3, -0.2, 0.001, 0.5, -0.4, 0.6, 0.01, -0.3])
    step = 1e-4
    _, slope = jax.jvp(bank, (x,), (direction,))
    near, far = (
        (bank(x + s * direction) - bank(x - s * direction)) / (2 * s)
        for s in (step, 2 * step)
    )
    # Rounding of 1e-16 over the step.
    assert float(slope) == pytest.approx(float(near + (near - far) / 3.0), rel=1e-9)
    backwards = jnp.vdot(jax.grad(bank)(x), direction)
    assert float(backwards) == pytest.approx(float(slope), rel=1e-12)


# In the law


def start_of(scenario, state=None):
    law = scenario.guidance
    angle = scenario.vehicle.trim_angle_of_attack
    state = scenario.initial_state if state is None else state
    return measure(law.model.planet, law.model.vehicle, state, angle)


@eqx.filter_jit
def predicted(law, seen, factors):
    numbers = law.shape.numbers
    return law.predicted(number(0.0), seen, factors, numbers, 1.0, False)


@pytest.mark.slow
def test_factors_are_those_of_the_prediction():
    scenario = guided()
    law, seen = scenario.law, start_of(scenario)
    by_factor = predicted(law, seen, Factors(1.1, 1.1))
    denser = with_leaf(law, lambda law: law.model.planet.density_scale, 1.1)
    by_density = predicted(denser, seen, Factors())
    for a, b in zip(
        jax.tree.leaves(by_factor.state), jax.tree.leaves(by_density.state), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_what_is_commanded_is_damped_by_the_sensed_factors():
    law = dataclasses.replace(guided().law, lateral=FixedSide(), corrections=1)
    believed = start_of(guided(), at(35 * km, 5000.0))
    seen = dataclasses.replace(
        believed, lift=1.1 * believed.lift, drag=0.9 * believed.drag
    )

    @eqx.filter_jit
    def decide(law, seen):
        _, held = law.init(seen)
        _, held = law.update(number(0.0), seen, (), held)
        return held, law(number(0.0), seen, (), held)[0]

    held, controls = decide(law, seen)
    factors, here = held.estimate.factors, seen.state.velocity
    assert float(factors.lift) == pytest.approx(1.1, rel=1e-9)
    assert float(factors.drag) == pytest.approx(0.9, rel=1e-9)
    cosine = law.shape.cos_bank(held.numbers, here, here)
    angle = law.angle_of_attack(here)
    damped = law.damping.cos_bank(law.model, factors, seen.state, angle, cosine)
    assert abs(float(damped - cosine)) > 0.01
    assert float(controls.cos_bank) == pytest.approx(float(damped), rel=1e-12)
    sine = math.sqrt(1.0 - float(damped) ** 2)
    assert float(controls.sin_bank) == pytest.approx(sine, rel=1e-12)


@pytest.mark.optimized
@pytest.mark.slow
def test_what_is_predicted_with_a_damping_is_flown():
    """A constant bank, which no correction moves, in the steps of the simulation."""
    scenario = x_33()
    law = dataclasses.replace(
        scenario.guidance,
        shape=ConstantBankShape(0.6, lowest=0.0),
        damping=GlideDamping(0.5),
        step=1.0,
        steps=2000,
    )
    law = with_leaf(law, lambda law: law.least_effect, 1e12)
    scenario = dataclasses.replace(scenario, guidance=law)
    flight = fly_compiled(scenario, FixedStep(0.5))
    seen = start_of(scenario)
    end = predicted(law, seen, Factors())
    free = predicted(dataclasses.replace(law, damping=None), seen, Factors())
    # Fourth order of steps of 1 and of 0.5 s; without it the altitude is another one.
    assert float(end.time) == pytest.approx(float(flight.time), abs=0.01)
    difference = float(end.state.altitude - flight.state.altitude)
    assert abs(difference) < 1.0
    assert abs(float(free.state.altitude - flight.state.altitude)) > 100.0


@functools.cache
def effects(damped):
    """How range and altitude at the end, km, go with the numbers, of an angle of 85 deg."""
    scenario = guided()
    law = scenario.law
    if not damped:
        law = dataclasses.replace(law, damping=None)
    seen = start_of(scenario)

    def end(numbers):
        found = law.predicted(number(0.0), seen, Factors(), numbers, 1.0, False)
        state = found.state
        return jnp.stack([law.model.planet.radius * state.longitude, state.altitude])

    slopes = eqx.filter_jit(jax.jacfwd(end))
    banks = [(70.0, 60.0), (60.0, 60.0), (50.0, 50.0), (50.0, 40.0), (70.0, 40.0)]
    return np.array([slopes(1.0 - jnp.array(pair) / 85.0) for pair in banks]) / km


@pytest.mark.slow
def test_one_number_is_for_the_range_and_the_other_for_the_altitude():
    (range_first, range_last), (first, last) = np.moveaxis(effects(True), 0, -1)
    assert np.all(range_first > 0.0) and np.all(range_last > 0.0)
    # A number is 85 degrees. What moves the range 4000 km moves the altitude a tenth as
    # much as the other number does.
    assert np.all(last > 5.0)
    assert np.all(np.abs(first) < 0.2 * last)
    # Without the damping it can be as much, of either sign.
    _, (first, last) = np.moveaxis(effects(False), 0, -1)
    assert np.max(np.abs(first) / np.abs(last)) > 0.5


def test_a_network_is_of_a_bank_without_damping():
    with pytest.raises(ValueError, match="without damping"):
        dataclasses.replace(networked().guidance, damping=GlideDamping())
