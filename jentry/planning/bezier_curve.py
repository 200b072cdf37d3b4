"""Plans k1 and k2 of a Bézier curve for a desired velocity at the target."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._setup import needs_float64
from ..campaign.campaign import monte_carlo
from ..flight.flight import fly
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Outcome
from ..guidance.bezier.anchoring import Shape
from ..guidance.bezier.curve import BezierParameters
from ..guidance.bezier.law import BezierGuidance
from ..guidance.bezier.prediction import AbstractVelocityPredictor, FlownModel


K1, K2 = "guidance.parameters.k1", "guidance.parameters.k2"


def bezier_law(scenario: Scenario) -> BezierGuidance:
    """The Bézier law of a scenario.

    **Raises:** `ValueError` for another law.
    """
    law = scenario.guidance
    if not isinstance(law, BezierGuidance):
        raise ValueError(
            f"the scenario flies {type(law).__name__}: this needs BezierGuidance"
        )
    return law


@needs_float64
def plan_parameters(
    scenario: Scenario,
    velocity: float,
    *,
    vary_k1: bool = False,
    tolerance: float = 1e-3,
    solver: AbstractSolver = FixedStep(),
) -> BezierParameters:
    """k1 and k2 with which the scenario reaches its target at a velocity (m/s).

    They are found by Newton's method with the derivatives of the flight, in four or five
    flights; the paper uses a search. With `vary_k1` both numbers change, by the step of
    least norm, which leads approximately to the nearest pair. Otherwise k1 is fixed.

    **Raises:** `ValueError` if there is no such flight, with the end of the last one.
    """
    parameters = bezier_law(scenario).parameters
    free = jnp.array([1.0 if vary_k1 else 0.0, 1.0])
    k = jnp.stack([jnp.asarray(parameters.k1), jnp.asarray(parameters.k2)])
    ended_at = np.nan
    for _ in range(20):
        value, slope, outcome = _velocity_and_slopes(scenario, solver, k)
        slope = slope * free
        ended_at = float(value)
        if int(outcome) != Outcome.REACHED:
            break
        if abs(ended_at - velocity) < tolerance:
            return BezierParameters(k[0], k[1])
        step = -(value - velocity) * slope / jnp.sum(slope * slope)
        k = k + jnp.clip(step, -0.1, 0.1)
    raise ValueError(
        f"no curve was found that ends at {velocity:g} m/s: the last one, with k1 = "
        f"{float(k[0]):.4f} and k2 = {float(k[1]):.4f}, ends at {ended_at:.1f} m/s; start "
        "from other parameters"
    )


@eqx.filter_jit
def _velocity_and_slopes(
    scenario: Scenario, solver: AbstractSolver, k: Float[Array, " 2"]
) -> tuple[Array, Array, Array]:
    """Velocity at the target, its derivatives with k1 and k2, and the outcome."""

    def final_velocity(k: Float[Array, " 2"]) -> tuple[Array, Array]:
        given = eqx.tree_at(
            lambda s: s.guidance.parameters, scenario, BezierParameters(k[0], k[1])
        )
        flight = fly(given, solver)
        return jnp.asarray(flight.state.velocity), jnp.asarray(flight.outcome)

    values, slopes, outcomes = jax.vmap(
        lambda t: jax.jvp(final_velocity, (k,), (t,), has_aux=True)
    )(jnp.eye(2))
    return values[0], slopes, outcomes[0]


class VelocityMap(NamedTuple):
    """Velocity at the target over k1 and k2."""

    k1: np.ndarray
    """(n,)"""
    k2: np.ndarray
    """(m,)"""
    velocity: np.ndarray
    """(n, m), m/s; NaN where the flight does not reach the target"""


@needs_float64
def velocity_map(
    scenario: Scenario,
    k1: np.ndarray,
    k2: np.ndarray,
    solver: AbstractSolver = FixedStep(),
) -> VelocityMap:
    """Fly every pair of k1 and k2, as in figure 10 of the paper."""
    bezier_law(scenario)
    first, second = (np.ravel(g) for g in np.meshgrid(k1, k2, indexing="ij"))
    flown = monte_carlo(scenario, inputs={K1: first, K2: second}, solver=solver)
    velocity = np.asarray(flown.flights.state.velocity)
    ended = np.asarray(flown.flights.outcome) == Outcome.REACHED
    velocity = np.where(ended, velocity, np.nan).reshape(len(k1), len(k2))
    return VelocityMap(np.asarray(k1), np.asarray(k2), velocity)


def k2_polynomial(velocity: np.ndarray, k2: np.ndarray) -> np.ndarray:
    """a, b and c of k2 = a v^2 + b v + c by least squares: equation (37), v in m/s.

    k2 is not a quadratic function of the velocity, so that the coefficients depend on the
    range of k2 that is fitted. For the CAV-H mission with k1 = 0.848, in steps of 0.05,
    they are 2.53e-7, -0.00226 and 4.92 for k2 from 0.4 to 1.0, 2.81e-7, -0.00240 and 5.10
    for k2 from 0.55 to 0.9, and 2.09e-7, -0.00204 and 4.63 for k2 from 0.3 to 1.0. The
    paper prints 2.32e-7, -0.0024 and 5.46. It searches between 0.4 and 1, and does not
    state which k2 it fits.

    **Raises:** `ValueError` if fewer than three velocities are finite.
    """
    good = np.isfinite(velocity)
    if good.sum() < 3:
        raise ValueError(
            f"{good.sum()} flights reached the target: a quadratic takes three or more"
        )
    return np.polyfit(velocity[good], np.asarray(k2)[good], 2)


class K2Polynomials(NamedTuple):
    """k2 over the velocity at the target, at places along the nominal flight."""

    to_go: Array
    """(n,) Range to go as an angle, rad, increasing"""
    nominal_velocity: Array
    """(n,) m/s"""
    polynomials: Array
    """(n, 3), k2 = p0 + p1 x + p2 x^2 with x = (v - nominal) / 100 m/s"""


_ROOM = np.linspace(-0.3, 0.3, 9)
"""Deviations from the nominal k2 over which the polynomials are fitted"""


@needs_float64
@eqx.filter_jit
def k2_polynomials(
    scenario: Scenario,
    predictor: AbstractVelocityPredictor,
    interval: float = 20.0,
    until: float = 60.0,
) -> K2Polynomials:
    """Fit the polynomials of `PolynomialAdjustment` to predictions of the onboard model.

    The predictions start at places along the nominal flight.

    **Arguments:**

    - `scenario`: with `StoredParameters` and no velocity control.
    - `predictor`: the predictor that is used in flight. Its predictions in flight are
      compared with its predictions for the nominal flight.
    - `interval`: time between the places, s.
    - `until`: time to go at the last place, s. Closer to the target k2 has no effect.
    """
    law = bezier_law(scenario)
    glide = law.glide(scenario.constraints)
    history = fly(scenario, history=interval).history
    assert history is not None
    # Entries after the end of the flight, or too close to the target, become copies of the
    # last entry that counts.
    situations = jax.vmap(law.situation)(history.states, history.decisions)
    to_go = jnp.asarray(situations.target.along - situations.point.along)
    seconds = to_go * law.model.planet.radius / situations.velocity
    last = jnp.sum(jnp.isfinite(seconds) & (seconds > until)) - 1
    index = jnp.minimum(jnp.arange(to_go.shape[0]), last)
    situations = jax.tree.map(lambda x: x[index], situations)

    def fit(situation):
        shape = situation.shape

        def at(k2):
            moved = eqx.tree_at(lambda s: s.shape, situation, Shape(shape.first, k2))
            return FlownModel().predict(glide, moved)

        k2 = shape.second + _ROOM
        x = 1e-2 * (jax.vmap(at)(k2) - at(shape.second))
        # Through the nominal k2, so that the nominal flight does not change k2.
        rest = jnp.linalg.lstsq(jnp.stack([x, x * x], axis=1), jnp.asarray(_ROOM))[0]
        nominal = predictor.predict(glide, situation)
        return nominal, jnp.concatenate([jnp.reshape(shape.second, 1), rest])

    nominal, polynomials = jax.vmap(fit)(situations)
    # Increasing angles to go. Each copy is slightly closer than the one before.
    places = to_go[index] - 1e-9 * (jnp.arange(to_go.shape[0]) - index)
    turned = (jnp.flip(x, 0) for x in (places, jnp.asarray(nominal), polynomials))
    return K2Polynomials(*turned)
