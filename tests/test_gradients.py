"""Derivatives of a flight: forward, reverse and differences agree, alone and in batches.

One table of cases: a law, the leaves that are varied, and how far for the differences.
What is looked at is one vector of numbers of the flight; its Jacobian is compiled once in
forward and once in reverse mode for each kind of law.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import bank_profile, mars_scenario
from laws import all_laws

from jentry.flight import FixedStep, fly
from jentry.guidance import Sampled
from jentry.motion import EntryState


STEP = FixedStep(0.05)
"""The last, shorter steps to the end move with it, and with them their truncation error:
differences see that, derivatives do not. For the observer it is 5e-6 with 0.1 s, and a
thousand times less with this."""

SCALE = jnp.array([1e2, 1e4, 0.1, 1e3, 0.1])
"""Of time (s), altitude (m), longitude, velocity and flight-path angle"""

PHYSICS = {
    "density_scale": (lambda s: s.planet.density_scale, 1e-4),
    "mass": (lambda s: s.vehicle.mass, 0.1),
    "path": (lambda s: s.initial_state.flight_path_angle, 1e-5),
}
"""Leaf, and half the width of a central difference"""

BANK = {"bank coefficients": (lambda s: s.guidance.cos_bank.coefficients, 1e-3)}
TRACKING = {
    "epsilon0": (lambda s: s.guidance.gains.epsilon0, 3e-2),
    "epsilon": (lambda s: s.guidance.observer.epsilon, 1e-2),
}
SAMPLED = {
    "epsilon0": (lambda s: s.guidance.law.gains.epsilon0, 3e-2),
    "epsilon": (lambda s: s.guidance.law.observer.epsilon, 1e-2),
}

CASES = {
    "bank profile": PHYSICS | BANK,
    "observer": PHYSICS | TRACKING,
    "sampled observer": PHYSICS | SAMPLED,
}


def scenario_of(law, planned):
    """From 60 s of the planned flight on, a little off it, to the final velocity.

    Off by so little that the command is not clipped: there the law has no derivative.
    """
    _, flight, references = planned
    scenario = mars_scenario(all_laws[law](references["energy"]))
    state = jax.tree.map(lambda x: x[600], flight.states)
    return eqx.tree_at(
        lambda s: (
            s.initial_state,
            s.planet.density_scale,
            s.termination.conditions["altitude"].altitude,
        ),
        scenario,
        (state, jnp.asarray(1.0002), jnp.asarray(5e3)),
    )


def leaves_of(scenario, table):
    """As arrays of one type, whatever they come from: with others a program is another."""
    return {
        name: jnp.asarray(where(scenario), float) for name, (where, _) in table.items()
    }


def put(scenario, table, leaves):
    wheres = [where for where, _ in table.values()]
    return eqx.tree_at(
        lambda s: [where(s) for where in wheres],
        scenario,
        [leaves[name] for name in table],
    )


def end_of(leaves, scenario, law):
    """The end of a flight as one vector of numbers of order one."""
    flight = fly(put(scenario, CASES[law], leaves), STEP)
    state = flight.state
    end = [
        flight.time,
        state.altitude,
        state.longitude,
        state.velocity,
        state.flight_path_angle,
    ]
    return jnp.stack(end) / SCALE


value = eqx.filter_jit(end_of)
forward = eqx.filter_jit(jax.jacfwd(end_of))
reverse = eqx.filter_jit(jax.jacrev(end_of))


def differences(f, leaves, table):
    """Jacobian by Richardson's extrapolation of central differences."""

    def along(name, tangent, step):
        def central(h):
            up, down = (
                f({**leaves, name: leaves[name] + sign * h * tangent})
                for sign in (1.0, -1.0)
            )
            return (np.asarray(up) - np.asarray(down)) / (2.0 * h)

        wide, narrow = central(step), central(0.5 * step)
        return narrow + (narrow - wide) / 3.0

    found = {}
    for name, (_, step) in table.items():
        basis = np.eye(leaves[name].size).reshape(-1, *leaves[name].shape)
        columns = [along(name, jnp.asarray(tangent), step) for tangent in basis]
        found[name] = np.stack(columns, axis=-1).reshape(-1, *leaves[name].shape)
    return found


def assert_close(found, expected, rtol, rounding=None):
    """Relative to the largest derivative with respect to the same leaf.

    `rounding` is what differences err by besides, by leaf.
    """
    for name in found:
        close = rtol * np.max(np.abs(expected[name]))
        close += 0.0 if rounding is None else rounding[name]
        np.testing.assert_allclose(
            found[name], expected[name], rtol=0, atol=close, err_msg=name
        )


def rounding_of_differences(table):
    """The end, of order one, is good to 1e-12 after some thousand steps."""
    return {name: 1e-12 / step for name, (_, step) in table.items()}


@pytest.fixture(scope="module")
def given(planned):
    return lambda law: scenario_of(law, planned)


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [
        "bank profile",
        pytest.param("sampled observer", marks=pytest.mark.slow),
        pytest.param("observer", marks=pytest.mark.slow),
    ],
)
def test_derivatives_of_the_end(law, given):
    scenario = given(law)
    leaves = leaves_of(scenario, CASES[law])
    pushed = forward(leaves, scenario, law)
    pulled = reverse(leaves, scenario, law)
    # Both are the exact derivative of one program, up to rounding. The derivative in the
    # observer's epsilon goes with its innovation, some 1e-6 of the drag: of the 1e-13 that
    # some thousand steps lose, in either mode others, it loses a million times as much.
    assert_close(pulled, pushed, rtol=1e-10 if law == "bank profile" else 1e-7)
    numbers = differences(lambda x: value(x, scenario, law), leaves, CASES[law])
    # Richardson leaves the fourth power of the step.
    rounding = rounding_of_differences(CASES[law])
    assert_close(numbers, pushed, rtol=1e-6, rounding=rounding)


@pytest.mark.slow
def test_the_velocity_that_ends_the_flight_does_not_move(given):
    scenario = given("bank profile")
    leaves = leaves_of(scenario, CASES["bank profile"])
    pushed = forward(leaves, scenario, "bank profile")
    time, velocity = 0, 3
    for name, derivative in pushed.items():
        # Rounding: the correction of the end cancels a rate of the same size.
        assert np.all(np.abs(derivative[velocity]) < 1e-12 * np.abs(derivative).max())
        assert np.all(derivative[time] != 0.0), name


# Batches.


def batch_of(scenario, law):
    """Three lanes, of different length, by the density."""
    leaves = leaves_of(scenario, CASES[law])
    factors = jnp.array([0.98, 1.0, 1.03])
    lanes = jax.tree.map(lambda x: jnp.stack([x] * 3), leaves)
    scale = factors * leaves["density_scale"]
    return lanes | {"density_scale": scale}, leaves


@pytest.mark.slow
def test_gradient_of_a_batch_and_batch_of_gradients(given):
    law = "bank profile"
    scenario = given(law)
    lanes, _ = batch_of(scenario, law)

    def altitude(leaves, scenario):
        return end_of(leaves, scenario, law)[1]

    def mean(lanes, scenario):
        return jnp.mean(jax.vmap(altitude, in_axes=(0, None))(lanes, scenario))

    each = eqx.filter_jit(jax.vmap(jax.grad(altitude), in_axes=(0, None)))
    together = eqx.filter_jit(jax.grad(mean))(lanes, scenario)
    apart = each(lanes, scenario)
    for lane in range(3):
        leaves = jax.tree.map(lambda x, lane=lane: x[lane], lanes)
        alone = jax.tree.map(lambda x: x[1], reverse(leaves, scenario, law))
        # Three programs for the same sums: rounding, summed along 2000 steps.
        for name, expected in alone.items():
            np.testing.assert_allclose(apart[name][lane], expected, rtol=1e-9)
            np.testing.assert_allclose(together[name][lane] * 3.0, expected, rtol=1e-9)


# Of the history.


def short():
    """40 s from 45 km on, at a bank that follows a profile: ten cycles of four seconds."""
    scenario = mars_scenario(Sampled(bank_profile(), 4.0), time_limit=40.0)
    start = EntryState(45e3, 0.0, 0.0, 6300.0, -0.17, 0.5 * np.pi)
    return eqx.tree_at(lambda s: s.initial_state, scenario, start)


SHORT = PHYSICS | {
    "bank coefficients": (lambda s: s.guidance.law.cos_bank.coefficients, 1e-3)
}


def seen_on_the_way(leaves, scenario):
    """All that a history shows of the motion, each in a unit that makes it of order one.

    An entry every eight seconds, which is every second guidance cycle.
    """
    history = fly(put(scenario, SHORT, leaves), FixedStep(1.0), 8.0).history
    states, controls, constraints = (
        jnp.stack(jax.tree.leaves(part))
        for part in (history.states, history.controls, history.constraints)
    )
    size = jnp.array([1e4, 0.1, 1.0, 1e3, 0.1, 1.0])[:, None]
    peak = jnp.array([1e2, 1e4, 1e6, 10.0])[:, None]
    return jnp.concatenate([states / size, controls, constraints / peak])


@pytest.mark.slow
def test_derivatives_of_all_that_a_history_shows():
    """Entry by entry; the first one is the start, which moves with the path angle only."""
    scenario = short()
    leaves = leaves_of(scenario, SHORT)
    value = eqx.filter_jit(seen_on_the_way)
    assert value(leaves, scenario).shape == (13, 5)
    pushed = eqx.filter_jit(jax.jacfwd(seen_on_the_way))(leaves, scenario)
    pulled = eqx.filter_jit(jax.jacrev(seen_on_the_way))(leaves, scenario)
    assert_close(pulled, pushed, rtol=1e-11)
    for name, (_, step) in SHORT.items():
        basis = jnp.eye(leaves[name].size).reshape(-1, *leaves[name].shape)
        for place, tangent in enumerate(basis):

            def at(h, name=name, tangent=tangent):
                return value({**leaves, name: leaves[name] + h * tangent}, scenario)

            wide, narrow = (
                (at(h) - at(-h)) / (2.0 * h) for h in (float(step), 0.5 * float(step))
            )
            expected = narrow + (narrow - wide) / 3.0
            found = pushed[name].reshape(13, 5, -1)[..., place]
            # Richardson's fourth order, and rounding of numbers of order one.
            close = 1e-7 * np.max(np.abs(expected)) + 1e-13 / step
            np.testing.assert_allclose(found, expected, rtol=0, atol=close)
            assert np.max(np.abs(expected[:, 1:])) > 0.0
    states = slice(0, 6)
    for name in ("density_scale", "mass", "bank coefficients"):
        assert np.all(pushed[name][states, 0] == 0.0)
    assert pushed["path"][4, 0] == pytest.approx(10.0)  # over its unit of 0.1


@pytest.mark.slow
def test_derivatives_of_the_history(given):
    """A cotangent on every entry, and on the end: entries after the end have none."""
    law = "bank profile"
    scenario = given(law)
    leaves = leaves_of(scenario, CASES[law])

    def weighted(leaves, scenario):
        flight = fly(put(scenario, CASES[law], leaves), STEP, 4.0)
        history = flight.history
        flying = jnp.isfinite(history.time)
        seen = [
            jnp.where(flying, x, 0.0) / scale
            for x, scale in (
                (history.states.altitude, 1e5),
                (history.states.velocity, 1e3),
                (history.constraints.drag, 1e2),
                (history.controls.cos_bank, 1.0),
            )
        ]
        weights = jnp.cos(jnp.arange(history.time.size, dtype=float))
        end = flight.state.altitude / 1e4 + flight.time / 1e2
        return jnp.sum(weights * sum(seen))[None] + end

    pushed = eqx.filter_jit(jax.jacfwd(weighted))(leaves, scenario)
    pulled = eqx.filter_jit(jax.jacrev(weighted))(leaves, scenario)
    # As for the end of the flight.
    assert_close(pulled, pushed, rtol=1e-10)
    function = eqx.filter_jit(weighted)
    numbers = differences(lambda x: function(x, scenario), leaves, CASES[law])
    # As there; entries that appear or vanish at the end are none within these steps.
    assert_close(numbers, pushed, rtol=1e-6)
