"""Second and higher derivatives of whole flights and of their ends."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import free_scenario, mars_scenario
from jax.flatten_util import ravel_pytree
from scipy.integrate import solve_ivp

from jentry.flight import FixedStep, fly
from jentry.flight.closed_loop import start, vector_field
from jentry.flight.end import end_of_flight
from jentry.flight.lane import Moving
from jentry.motion import EquatorialDynamics


SOLVER = FixedStep(0.1)
X = jnp.array([1.0, -0.1, 0.62, 0.05])
"""Density scale, flight-path angle, two coefficients of the bank profile"""
SCALE = jnp.array([1e2, 0.1, 0.1])
"""Of time (s), longitude and flight-path angle at the end"""


def flown(x):
    """From low in the atmosphere to 10 km: an end that moves with everything varied."""
    scenario = eqx.tree_at(
        lambda s: (
            s.initial_state.altitude,
            s.initial_state.velocity,
            s.initial_state.flight_path_angle,
            s.planet.density_scale,
            s.guidance.cos_bank.coefficients,
        ),
        mars_scenario(time_limit=60.0),
        (jnp.asarray(16e3), jnp.asarray(1500.0), x[1] - 0.3, x[0], x[2:4]),
    )
    flight = fly(scenario, SOLVER)
    state = flight.state
    return jnp.stack([flight.time, state.longitude, state.flight_path_angle]) / SCALE


gradient = jax.jit(jax.jacfwd(flown))


def differences(f, x, step):
    """Of fourth order, one column for each number."""
    columns = [
        (8 * (f(x + h) - f(x - h)) - (f(x + 2 * h) - f(x - 2 * h))) / (12 * step)
        for h in step * np.eye(x.size)
    ]
    return np.stack(columns, axis=-1)


WEIGHTS, ALONG = jnp.array([0.8, -1.1, 0.6]), jnp.array([-0.7, 1.2, 0.9, -1.3])
"""Of what is at the end, and of what is varied: of any size near one"""


def forward(f):
    """The derivative of what a flight has, along a direction of what is varied."""
    return lambda x: jax.jvp(f, (x,), (ALONG,))[1]


def reverse(f):
    """The derivative to all that is varied, of a sum of what a flight has."""

    def total(x):
        found = f(x)
        return (WEIGHTS if found.size == 3 else ALONG) @ found

    return jax.grad(total)


ORDERS = {
    "forward over forward": (lambda f: forward(forward(f)), "eij,i,j->e"),
    "forward over reverse": (lambda f: forward(reverse(f)), "eij,e,j->i"),
    "reverse over forward": (lambda f: reverse(forward(f)), "eij,e,j->i"),
    "reverse over reverse": (lambda f: reverse(reverse(f)), "eij,e,j->i"),
}


@functools.cache
def hessian_by_differences():
    return differences(gradient, X, 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_second_derivatives_of_a_flight(order):
    """Of the end, whose time moves, against differences of the first derivatives.

    These are exact to the rounding of the gradient (1e-12) over the step, and to the
    fourth power of the step.
    """
    second, product = ORDERS[order]
    hessian = hessian_by_differences()
    assert np.all(np.abs(hessian).max(axis=(1, 2)) > 1e-2)
    weights = ALONG if order == "forward over forward" else WEIGHTS
    expected = np.einsum(product, hessian, weights, ALONG)
    found = jax.jit(second(flown))(X)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


def with_rate(function, s):
    """What a function gives, and after it the derivative of all of that."""
    value, rate = jax.jvp(function, (s,), (jnp.ones_like(s),))
    return jnp.concatenate([jnp.atleast_2d(value), jnp.atleast_2d(rate)])


@pytest.mark.slow
def test_derivatives_of_the_end_up_to_the_fourth():
    """Of time and altitude where 503 m/s are met, over the velocity shortly before.

    The truth is a polynomial through ends that scipy has found, ahead and behind.
    """
    scenario = dataclasses.replace(free_scenario(), dynamics=EquatorialDynamics())
    lane = eqx.tree_at(
        lambda lane: (lane.flown, lane.state.velocity, lane.state.altitude),
        start(scenario, 0.1),
        (jnp.asarray(100.0), jnp.asarray(503.0 + 1e-6), jnp.asarray(2e4)),
    )

    def moved(s):
        return eqx.tree_at(lambda l: l.state.velocity, lane, replace_fn=lambda v: v + s)

    def end(s):
        ended = end_of_flight(scenario, moved(s)).lane
        return jnp.stack([ended.flown, ended.state.altitude])

    field, unravel = vector_field(scenario, None), ravel_pytree(lane.state)[1]

    @jax.jit
    def rates(y):
        return ravel_pytree(
            field(jnp.asarray(0.0), Moving(unravel(y), None, None)).state
        )[0]

    place = int(np.flatnonzero(ravel_pytree(lane.state)[0] == lane.state.velocity)[0])

    def found(s):
        first = np.asarray(ravel_pytree(moved(s).state)[0])
        met = lambda t, y: y[place] - 503.0
        ahead = 200.0 if first[place] > 503.0 else -200.0
        flown = solve_ivp(
            lambda t, y: np.asarray(rates(y)),
            (0.0, ahead),
            first,
            method="DOP853",
            events=met,
            rtol=1e-13,
            atol=1e-13,
            max_step=0.5,  # between its steps, where the end is found, it is less exact
        )
        return 100.0 + flown.t_events[0][0], float(
            unravel(flown.y_events[0][0]).altitude
        )

    reach = 12.0
    nodes = np.polynomial.chebyshev.chebpts1(16)
    table = np.array([found(reach * node) for node in nodes])
    ours = end
    for _ in range(4):
        ours = functools.partial(with_rate, ours)
    ours = jax.jit(ours)(jnp.asarray(0.0))
    for order in range(1, 5):
        truth = [
            fit.deriv(order)(0.0) / reach**order
            for fit in (
                np.polynomial.Chebyshev.fit(nodes, column, 15, domain=[-1, 1])
                for column in table.T
            )
        ]
        # The last one that has been differentiated so often and no more.
        np.testing.assert_allclose(ours[2**order - 1], truth, rtol=1e-6)
