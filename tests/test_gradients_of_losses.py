"""The gradient of every named loss is that of its differences, tails and all.

A loss with a tail gives most flights no weight to speak of. What a flight adds to the
gradient may not be judged by that weight.
"""

import functools
from dataclasses import fields

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jentry.campaign.batch import LANES, sum_over_runs
from jentry.campaign.campaign import drawn_inputs
from jentry.flight import misses
from jentry.parameters.parameters import Parameters
from jentry.tuning.batch_gradients import (
    Problem,
    Simulation,
    _gradient_of,
    batch_gradient,
    loss_and_weights,
    where_finite,
)
from jentry.tuning.differences import gradient_by_differences
from jentry.tuning.gradients import fly_at
from jentry.tuning.losses import BY_NAME, ScaledMisses


FLIGHTS = 2 * LANES

DIVERGES = "vehicle.nose_radius"
"""A leaf of which nothing depends here but, above 5 m, the derivatives of `outputs`"""

SCALED = ScaledMisses((("downrange", 3e3), ("altitude", 300.0)))
"""So small that a tail, a tenth wide, holds few of the flights"""


def outputs(scenario, flight):
    """Misses, with derivatives a thousand million times as large where it diverges."""
    found = misses(scenario, flight)
    steep = jnp.where(scenario.vehicle.nose_radius > 5.0, 1e9, 1.0)
    return jax.tree.map(
        lambda x: lax.stop_gradient(x) + steep * (x - lax.stop_gradient(x)), found
    )


@functools.cache
def problem():
    where = lambda s: (s.guidance.bank_angle, s.initial_state.velocity)
    parameters = Parameters.of(cheap.scenario(), where)
    return Problem(parameters, Simulation(outputs, cheap.SOLVER))


@functools.cache
def drawn():
    given = cheap.scenario(), cheap.dispersions(), jax.random.key(1), np.arange(FLIGHTS)
    return drawn_inputs(*given) | {DIVERGES: jnp.ones(FLIGHTS)}


def flown(free):
    return fly_at(problem(), free, drawn())


def gradient(loss, forward, inputs=None):
    free = problem().parameters.zeros()
    _, weights = loss_and_weights(loss, flown(free)[0])
    inputs = drawn() if inputs is None else inputs
    return batch_gradient(problem(), free, inputs, weights, forward), weights


def differences(loss, step=2e-6):
    """Of the loss itself, by address."""
    free = problem().parameters.zeros()
    found = {}
    for address, here in free.items():
        up, down = (
            float(loss(flown(free | {address: here + s})[0])) for s in (step, -step)
        )
        found[address] = (up - down) / (2.0 * step)
    return found


MODES = [True, False]
"""Forward, and reverse; `test_tuning` has a gradient every day"""


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_NAME)
@pytest.mark.parametrize("forward", MODES)
def test_gradient_of_a_named_loss_is_its_difference(name, forward):
    loss = BY_NAME[name](SCALED)
    found, weights = gradient(loss, forward)
    assert int(found.failed) == 0
    sizes = np.max([np.abs(w) for w in jax.tree.leaves(weights)], axis=0)
    if name in ("worst-case", "outside"):
        # What a loss with a tail is: flights a million times as heavy as the usual one.
        assert sizes.max() > 1e6 * np.median(sizes[sizes > 0.0])
    for address, expected in differences(loss).items():
        # The third derivative of a tail, and rounding over the step.
        assert float(found.total[address]) == pytest.approx(expected, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("forward", MODES)
def test_a_flight_that_diverges_is_left_out_and_counted(forward):
    """Whatever its weight: also where that makes its gradient as small as the others'."""
    loss = BY_NAME["mean-square"](SCALED)
    whole, weights = gradient(loss, forward)
    diverges = np.zeros(FLIGHTS, bool)
    diverges[[3, 70]] = True
    inputs = drawn() | {DIVERGES: jnp.asarray(np.where(diverges, 10.0, 1.0))}
    found, _ = gradient(loss, forward, inputs)
    assert int(found.failed) == 2 and int(found.counted) == FLIGHTS
    alone = jax.tree.map(lambda w: jnp.where(diverges, w, 0.0), weights)
    free = problem().parameters.zeros()
    theirs = batch_gradient(problem(), free, drawn(), alone, forward)
    for address, total in found.total.items():
        expected = float(whole.total[address] - theirs.total[address])
        assert float(total) == pytest.approx(expected, rel=1e-10)  # sums of 128
    light = jax.tree.map(lambda w: jnp.where(diverges, 1e-9 * w, w), weights)
    found = batch_gradient(problem(), free, inputs, light, forward)
    assert int(found.failed) == 2


@pytest.mark.parametrize("flights", [20, 65])
def test_a_flight_is_measured_by_others_wherever_it_stands(flights):
    """Also where it is the last one, or alone in its batch but for what fills that up."""

    class Linear(Problem):
        def __call__(self, free, inputs):
            return {"miss": inputs["slope"] * free["gain"]}, jnp.ones((), bool)

    linear = Linear(*(getattr(problem(), field.name) for field in fields(Problem)))

    def summed(slopes):
        runs = {"slope": slopes}, {"miss": np.full(flights, 1.0 / flights)}
        given = linear, {"gain": jnp.asarray(1.0)}, True
        found = sum_over_runs(_gradient_of, given, runs)
        return float(found.total["gain"]), int(found.failed)

    for place in (3, flights - 1):
        slopes = np.ones(flights)
        slopes[place] = 1e12
        assert summed(slopes) == (pytest.approx(1.0 - 1.0 / flights, rel=1e-12), 1)
    slopes = np.full(flights, 1e9)
    slopes[-1] = 1.0
    assert summed(slopes)[1] == 0


# By differences.


def fly(free):
    return flown(free)


@pytest.mark.slow
def test_gradient_by_differences_is_that_of_the_loss():
    loss = BY_NAME["cvar"](SCALED)
    free = problem().parameters.zeros()
    found = gradient_by_differences(fly, FLIGHTS, loss, free, 2e-6)
    for address, expected in differences(loss).items():
        # Rounding of sums of 128 over the step.
        assert float(found.gradient[address]) == pytest.approx(expected, rel=1e-9)
    # Of the seven flights that the worst twentieth of 128 are.
    assert found.failed == 0 and set(found.shares.values()) == {7 / FLIGHTS}


def test_standard_error_of_differences_is_that_of_a_mean():
    """For a mean square: of the squares before and behind, flight by flight."""
    loss = BY_NAME["mean-square"](SCALED)
    free = problem().parameters.zeros()
    step, squares = 0.01, 0.0
    for address, here in free.items():
        up, down = (
            np.sum(np.square(SCALED(flown(free | {address: here + s})[0])), axis=0)
            for s in (step, -step)
        )
        slopes = (up - down) / (2.0 * step)
        squares += np.var(slopes, ddof=1) / FLIGHTS
    found = gradient_by_differences(fly, FLIGHTS, loss, free, step)
    # The trapezoidal rule is exact for squares.
    assert found.error == pytest.approx(np.sqrt(squares), rel=1e-9)


def test_flights_that_fail_on_one_side_are_left_out_of_both():
    """Else a difference would be that of their whole loss over the step."""
    loss = BY_NAME["mean-square"](SCALED)
    free = problem().parameters.zeros()
    count = 0

    def fragile(free):
        nonlocal count
        count += 1
        found, finite = flown(free)
        finite = finite.copy()
        finite[5 if count % 2 else 9] = False
        return found, finite

    found = gradient_by_differences(fragile, FLIGHTS, loss, free, 1e-5)
    assert found.failed == 2
    others = np.ones(FLIGHTS, bool)
    others[[5, 9]] = False
    for address, here in free.items():
        up, down = (
            float(loss(where_finite(flown(free | {address: here + s})[0], others)))
            for s in (1e-5, -1e-5)
        )
        expected = (up - down) / 2e-5
        assert float(found.gradient[address]) == pytest.approx(expected, rel=1e-9)
