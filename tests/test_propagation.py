"""The rest of the flight as it is predicted on board, and a law that steers by it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, with_leaf
from propagating import (
    ENDS,
    MODEL,
    SCENARIO,
    START,
    constant_bank,
    downrange,
    one,
    predicted,
    profile,
)

from jentry.fields import Scalar
from jentry.flight import FixedStep
from jentry.motion import Controls, EntryDynamics, EquatorialDynamics
from jentry.motion.forces import air_data
from jentry.motion.quantities import energy, ground_track
from jentry.onboard import NO_END, Factors, propagate, propagate_over
from jentry.units import degree


def test_a_prediction_ends_where_the_flight_of_the_same_model_does():
    """At the fourth order of the steps."""
    flight = fly_compiled(SCENARIO, FixedStep(0.1))
    errors = []
    for step in (8.0, 4.0, 2.0):
        end = predicted(one(step))
        assert bool(end.has_end) and int(end.ended_by) == 1
        assert abs(float(end.state.altitude) - 10e3) < 1e-9
        errors.append(
            [
                float(downrange(end.state) - downrange(flight.state)),
                float(end.time - flight.time),
            ]
        )
    errors = np.array(errors)
    np.testing.assert_allclose(errors[:-1] / errors[1:], 16.0, rtol=0.06)
    assert abs(errors[-1, 0]) < 0.1 and abs(errors[-1, 1]) < 1e-4


def test_factors_are_those_of_the_forces():
    """On lift and drag alike they are a denser atmosphere."""
    denser = with_leaf(MODEL, lambda m: m.planet.density_scale, 1.17)
    factors, density = (
        predicted(lift=one(1.17), drag=one(1.17)),
        predicted(model=denser),
    )
    np.testing.assert_allclose(
        jax.tree.leaves(factors), jax.tree.leaves(density), rtol=1e-11, atol=1e-11
    )
    # They multiply those that the model has of its own.
    known = with_leaf(MODEL, lambda m: m.vehicle.lift_scale, 1.1)
    np.testing.assert_allclose(
        jax.tree.leaves(predicted(lift=one(1.1), model=known)),
        jax.tree.leaves(predicted(lift=one(1.21))),
        rtol=1e-11,
        atol=1e-11,
    )
    lift, drag = predicted(lift=one(1.1)), predicted(drag=one(1.1))
    nominal = predicted()
    assert downrange(lift.state) > downrange(nominal.state) > downrange(drag.state)


@pytest.mark.slow
def test_derivatives_are_those_of_the_end():
    """First and second, in both modes, against differences; also across steps."""

    def reached(x):
        end = predicted(lift=x[0], cosine=x[1])
        return jnp.stack([downrange(end.state), 1e3 * end.time])

    x = jnp.array([1.03, 0.6])
    forwards = jax.jit(jax.jacfwd(reached))
    slopes = np.asarray(forwards(x))
    np.testing.assert_allclose(jax.jit(jax.jacrev(reached))(x), slopes, rtol=1e-10)
    h = 1e-5
    for k in range(2):
        e = h * jnp.eye(2)[k]
        difference = (reached(x + e) - reached(x - e)) / (2 * h)
        np.testing.assert_allclose(slopes[:, k], difference, rtol=1e-6)
        second = (forwards(x + e) - forwards(x - e)) / (2 * h)
        if k == 1:
            twice = jax.jit(
                lambda x: jax.jvp(
                    lambda x: jax.jvp(reached, (x,), (jnp.eye(2)[1],))[1],
                    (x,),
                    (jnp.eye(2)[1],),
                )
            )(x)[1]
            np.testing.assert_allclose(twice, second[:, 1], rtol=1e-5)


def test_the_end_varies_smoothly_where_the_number_of_steps_changes():
    """A prediction that stopped at its last whole step would jump by 3 s of flight."""
    cosines = jnp.linspace(0.60, 0.64, 81)
    ends = jax.jit(jax.vmap(lambda c: predicted(cosine=c)))(cosines)
    assert len(np.unique(np.floor(np.asarray(ends.time) / 3.0))) > 1
    bends = np.diff(np.asarray(downrange(ends.state)), 3)
    # 2.4 m between cosines in the second difference; a step more is 100 m and more.
    assert np.max(np.abs(bends)) < 1.0


@pytest.mark.parametrize(
    "changes",
    [
        {"steps": 16},
        {"state": with_leaf(START, lambda s: s.altitude, 9e3)},
        {"state": with_leaf(START, lambda s: s.altitude, 137e3)},
        {"lift": one(jnp.nan)},
        {"drag": one(1e12)},
    ],
    ids=[
        "too few steps",
        "beyond an end",
        "beyond it for a step",
        "no number",
        "no longer finite",
    ],
)
def test_what_has_no_end_says_so_and_is_finite(changes):
    end = predicted(**changes)
    assert not bool(end.has_end) and int(end.ended_by) == NO_END
    assert np.all(np.isfinite(jax.tree.leaves(end)))
    if "steps" in changes:
        # The steps that it had, in time.
        assert float(end.time) == pytest.approx(16 * 3.0, rel=1e-14)
    elif "drag" not in changes:
        assert float(end.time) == 0.0


class Banked(eqx.Module):
    """A command that is an object with numbers, of which arrays cannot be hashed."""

    cosine: Scalar

    def __call__(self, time, state):
        return Controls(0.0 * time, self.cosine + 0.0 * time, 0.0 * time)


@pytest.mark.parametrize("as_method", [False, True])
def test_a_command_may_be_an_object(as_method):
    @eqx.filter_jit
    def flown(banked):
        command = banked.__call__ if as_method else banked
        dynamics = EquatorialDynamics()
        return propagate(
            MODEL, START, command, ENDS, step=3.0, steps=128, dynamics=dynamics
        )

    found, known = flown(Banked(one(0.6))), predicted(cosine=0.6)
    assert bool(found.has_end)
    assert float(downrange(found.state)) == pytest.approx(
        float(downrange(known.state)), rel=1e-12
    )


def test_skipping_out_is_an_end():
    shallow = with_leaf(START, lambda s: s.flight_path_angle, -5.0 * degree)
    end = predicted(cosine=one(1.0), state=shallow, steps=256)
    assert int(end.ended_by) == 2
    assert float(end.state.altitude) == pytest.approx(135e3, abs=1e-6)


def test_side_by_side_they_are_what_they_are_alone():
    cosines = jnp.array([0.2, 0.6, 0.9])
    together = eqx.filter_jit(jax.vmap(lambda c: predicted(cosine=c)))(cosines)
    for k, cosine in enumerate(cosines):
        alone = predicted(cosine=cosine)
        np.testing.assert_allclose(
            jax.tree.leaves(jax.tree.map(lambda x, k=k: x[k], together)),
            jax.tree.leaves(alone),
            rtol=1e-12,
            atol=1e-12,
        )


@eqx.filter_jit
def spatial(start, angle, model=MODEL, dynamics=EntryDynamics()):
    command = constant_bank(angle)
    return propagate(
        model, start, command, ENDS, step=3.0, steps=256, dynamics=dynamics
    )


def test_a_mirrored_bank_flies_a_mirrored_crossrange():
    ends = [spatial(START, one(angle)) for angle in (0.9, -0.9)]
    right, left = (
        np.array(ground_track(MODEL.planet, START, end.state)) for end in ends
    )
    np.testing.assert_allclose(right[0], left[0], rtol=1e-12)
    np.testing.assert_allclose(right[1], -left[1], rtol=1e-9)
    assert right[1] < -1e4


def test_over_a_pole_it_is_given_up():
    """Longitude and heading turn by 180 degrees there, in a step that says nothing."""
    north = with_leaf(
        with_leaf(START, lambda s: s.heading, 0.0), lambda s: s.latitude, 0.0
    )
    beside = with_leaf(north, lambda s: s.longitude, 0.1)
    assert bool(spatial(beside, one(0.9)).has_end)
    before = with_leaf(north, lambda s: s.latitude, 89.0 * degree)
    end = spatial(before, one(0.0))
    assert not bool(end.has_end)
    # The last good state is on this side of the pole.
    assert 89.0 * degree < float(end.state.latitude) < 90.0 * degree
    assert abs(float(end.state.longitude - before.longitude)) < 1e-6


@pytest.mark.slow
def test_eastward_over_the_equator_space_is_the_plane():
    """Also over a rotating planet, lift up."""
    turning = with_leaf(MODEL, lambda m: m.planet.rotation_rate, 7e-5)
    space, plane = (
        spatial(START, one(0.0), turning, dynamics)
        for dynamics in (EntryDynamics(), EquatorialDynamics())
    )
    assert bool(space.has_end)
    np.testing.assert_allclose(
        jax.tree.leaves(space), jax.tree.leaves(plane), rtol=1e-11, atol=1e-11
    )
    still = spatial(START, one(0.0))
    assert abs(float(still.time - space.time)) > 1.0


def specific_energy(state):
    return energy(MODEL.planet, state)


@eqx.filter_jit
def over_energy(start, end, steps, lift=one(1.0)):
    return propagate_over(
        specific_energy,
        end,
        MODEL,
        start,
        profile,
        steps=steps,
        factors=Factors(lift, 1.0),
        dynamics=EquatorialDynamics(),
        integrand=lambda time, state, controls: {
            "way": air_data(
                MODEL.planet, MODEL.vehicle, state, controls.angle_of_attack
            ).drag
            * state.velocity,
            "time": jnp.ones_like(time),
        },
    )


def in_the_air():
    """After 60 s, where the drag makes the energy fall."""
    history = fly_compiled(SCENARIO, FixedStep(0.1), 1.0).history
    return jax.tree.map(lambda x: x[70], history.states)


@pytest.mark.slow
def test_over_an_index_it_ends_where_it_does_over_time():
    """At the fourth order of the steps; what the drag has taken is the energy."""
    start, flight = in_the_air(), fly_compiled(SCENARIO, FixedStep(0.1))
    first, last = specific_energy(start), specific_energy(flight.state)
    errors = []
    for steps in (100, 200, 400):
        end = over_energy(start, last, steps)
        assert bool(end.has_end)
        errors.append(float(downrange(end.state) - downrange(flight.state)))
        taken = float(first - last)
        assert float(end.integrals["way"]) == pytest.approx(taken, rel=1e-12)
        assert float(end.integrals["time"]) == pytest.approx(float(end.time), rel=1e-12)
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    assert np.all(np.abs(np.log2(ratios) - 4.0) < 0.5), ratios
    assert abs(errors[-1]) < 1.0


def test_over_an_index_derivatives_are_those_of_differences():
    start = in_the_air()
    last = specific_energy(fly_compiled(SCENARIO, FixedStep(0.1)).state)

    def reached(lift):
        return downrange(over_energy(start, last, 100, lift).state)

    lift, h = one(1.02), 1e-5
    difference = (reached(lift + h) - reached(lift - h)) / (2 * h)
    assert float(difference) > 1e3  # m: it flies, and further with more lift
    for derivative in (jax.jacfwd, jax.grad):
        found = float(jax.jit(derivative(reached))(lift))
        assert found == pytest.approx(float(difference), rel=1e-6)


def test_an_index_that_turns_back_has_no_end():
    """Up there the velocity first rises, and energy that has gone does not come back."""
    start = in_the_air()
    now = specific_energy(start)
    back = over_energy(start, now + 1e5, 100)
    assert not bool(back.has_end) and float(back.time) == 0.0

    @eqx.filter_jit
    def over_velocity(end):
        return propagate_over(
            lambda state: state.velocity,
            end,
            MODEL,
            START,
            profile,
            steps=200,
            dynamics=EquatorialDynamics(),
        )

    assert not bool(over_velocity(one(600.0)).has_end)
    assert bool(over_velocity(START.velocity + 1.0).has_end)
    there = over_velocity(START.velocity)
    assert bool(there.has_end) and float(there.time) == 0.0


def test_what_is_carried_along_over_time():
    """The integral of one is the time, of the rate of the longitude the longitude."""

    @eqx.filter_jit
    def flown(step):
        return propagate(
            MODEL,
            START,
            profile,
            ENDS,
            step=step,
            steps=128,
            dynamics=EquatorialDynamics(),
            integrand=lambda time, state, controls: (
                2.0 * time,
                state.velocity
                * jnp.cos(state.flight_path_angle)
                / (MODEL.planet.radius + state.altitude),
            ),
        )

    end = flown(one(3.0))
    assert float(end.integrals[0]) == pytest.approx(float(end.time) ** 2, rel=1e-13)
    expected = float(end.state.longitude)
    assert float(end.integrals[1]) == pytest.approx(expected, rel=1e-12)


def test_bad_input_is_refused():
    for ends, step, steps, said in (
        ((), 3.0, 8, "ends is empty"),
        (ENDS, 0.0, 8, "step is 0.0 s"),
        (ENDS, 3.0, 0, "steps is 0"),
    ):
        with pytest.raises(ValueError, match=said):
            propagate(MODEL, START, profile, ends, step=step, steps=steps)
    with pytest.raises(ValueError, match="steps is -1"):
        propagate_over(specific_energy, 1.0, MODEL, START, profile, steps=-1)
