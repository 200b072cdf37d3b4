"""Residuals of many flights under a neural law, and their derivatives by its weights.

A loss is a statistic of the distances of the flights, each the root of its summed squared
residuals. Its gradient, and the matrix of Gauss and Newton, follow from the derivatives of
each flight: numbers times weights, for which the batch runner flies each flight once
forwards and once backwards for each residual.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..campaign.batch import over_runs
from ..flight.flight import Flight
from ..flight.miss import misses
from ..flight.scenario import Scenario
from ..guidance.neural_law import NeuralLaw
from ..tuning.batch_gradients import Simulation
from ..units import km


Residuals = Callable[[Scenario, Flight], Any]
"""Function of a scenario and its flight: numbers of order one that shall become zero"""

Statistic = Callable[[Float[Array, " flights"]], Any]
"""Function of the distances of all flights: the loss, such as those of `tuning.losses`"""

Weights = np.ndarray
"""All weights and biases of a network in one vector, shape (weights,)"""


def ground_miss(scenario: Scenario, flight: Flight) -> tuple[Any, Any]:
    """Residuals: downrange and crossrange error, km."""
    missed = misses(scenario, flight)
    return missed.downrange / km, missed.crossrange / km


def neural_law_of(scenario: Scenario) -> NeuralLaw:
    """The neural law of a scenario.

    **Raises:** `ValueError` if it has another law.
    """
    if not isinstance(scenario.guidance, NeuralLaw):
        raise ValueError(
            f"the law is {type(scenario.guidance).__name__}: a NeuralLaw is trained"
        )
    return scenario.guidance


def weights_of(scenario: Scenario) -> Weights:
    """The weights of the neural law of a scenario."""
    return np.asarray(ravel_pytree(neural_law_of(scenario).network.trained)[0])


def with_weights(scenario: Scenario, weights: Any) -> Scenario:
    """The scenario with other weights of its neural law."""
    network = neural_law_of(scenario).network
    _, put_back = ravel_pytree(network.trained)
    return eqx.tree_at(
        lambda s: s.guidance.network,
        scenario,
        eqx.tree_at(
            lambda n: n.trained,
            network,
            put_back(jnp.asarray(weights)),
            is_leaf=lambda x: x is None,
        ),
    )


class Flown(NamedTuple):
    """Residuals of flights, and their derivatives."""

    residuals: np.ndarray
    """Shape (flights, residuals)"""
    derivatives: np.ndarray
    """By the weights, shape (flights, residuals, weights)"""
    finite: np.ndarray
    """Whether a flight has an end and all numbers are finite, shape (flights,)"""

    @property
    def sizes(self) -> np.ndarray:
        """Norm of the derivatives of each flight, shape (flights,)."""
        return np.sqrt(np.sum(self.derivatives**2, axis=(1, 2)))


def flown(
    scenario: Scenario, simulation: Simulation, inputs: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of each flight, (flights, residuals), and whether a flight is finite."""
    return over_runs(_residuals, (scenario, simulation), inputs)


def flown_with_derivatives(
    scenario: Scenario, simulation: Simulation, inputs: dict[str, Any]
) -> Flown:
    """Residuals of each flight, and their derivatives by the weights of the law."""
    return Flown(*over_runs(_with_derivatives, (scenario, simulation), inputs))


def _residuals(
    shared: tuple[Scenario, Simulation], inputs: dict[str, Array]
) -> tuple[Array, Array]:
    scenario, simulation = shared
    residuals, finite = simulation(scenario, inputs)
    numbers = [jnp.asarray(x, float) for x in jax.tree.leaves(residuals)]
    return jnp.stack(numbers), finite


def _with_derivatives(
    shared: tuple[Scenario, Simulation], inputs: dict[str, Array]
) -> tuple[Array, Array, Array]:
    scenario, simulation = shared
    network = neural_law_of(scenario).network
    vector, _ = ravel_pytree(network.trained)

    def of(vector: Array) -> tuple[Array, Array]:
        return _residuals((with_weights(scenario, vector), simulation), inputs)

    residuals, backwards, finite = jax.vjp(of, vector, has_aux=True)
    (derivatives,) = jax.vmap(backwards)(jnp.eye(len(residuals)))
    known = finite & jnp.all(jnp.isfinite(derivatives))
    return residuals, derivatives, known


def distances(residuals: np.ndarray) -> np.ndarray:
    """Root of the summed squares of the residuals of each flight, shape (flights,)."""
    return np.sqrt(np.sum(residuals**2, axis=1))


class Curved(NamedTuple):
    """Gradient of a loss, and the matrix of Gauss and Newton."""

    loss: float
    gradient: np.ndarray
    """Shape (weights,)"""
    matrix: np.ndarray | None
    """Shape (weights, weights); None if it was not asked for"""
    clipped: int
    """Number of flights that count less than half, since their derivatives are large"""


LARGE = 4.0
"""Usual factor by which the derivatives of a flight exceed the median if it has half of its
weight"""

_LEAST_WEIGHT = 0.1
"""Weight of a flight in the matrix, as a share of the mean, if the loss hardly depends on
it: a step must not spoil it"""


def curved(
    flights: Flown,
    statistic: Statistic,
    with_matrix: bool = True,
    large: float = LARGE,
) -> Curved:
    """Gradient and matrix of a statistic of the distances of finite flights.

    With w_i = (dL / dd_i) / d_i for the distance d_i, its residuals r_i and derivatives J_i
    the gradient is the sum of w_i J_i^T r_i, and the matrix that of w_i J_i^T J_i. It is
    the Hessian for a mean square if the derivatives were constant. Both weigh flights down
    whose derivatives exceed the median by the factor `large` or more: these have half of
    their weight or less.
    """
    residuals, derivatives, _ = (x[flights.finite] for x in flights)
    sizes = flights.sizes[flights.finite]
    if not len(residuals):
        raise ValueError(
            "no flight has an end and finite derivatives: start with other weights, or "
            "with smaller dispersions"
        )
    distance = distances(residuals)
    # A flight without a miss has no direction of the miss, and no gradient.
    floor = 1e-12 * max(float(distance.max()), 1e-300)
    loss, slopes = jax.value_and_grad(lambda d: jnp.asarray(statistic(d)))(
        jnp.asarray(distance)
    )
    weights = np.asarray(slopes) / np.maximum(distance, floor)
    if not (np.isfinite(loss) and np.all(np.isfinite(slopes)) and np.any(sizes > 0.0)):
        raise ValueError(
            f"the loss of {len(distance)} flights is {float(loss):g}, its derivatives are "
            f"{'' if np.all(np.isfinite(slopes)) else 'not '}finite, and "
            f"{np.sum(sizes > 0.0)} flights depend on the weights: check the residuals "
            "and the statistic on the flights of the start"
        )
    if np.any(np.asarray(slopes) < 0.0):
        raise ValueError(
            "the statistic falls where a distance grows: it must grow with each, as those "
            "of jentry.tuning.losses"
        )
    ratio = sizes / float(np.median(sizes[sizes > 0.0]))
    kept = 1.0 / (1.0 + (ratio / large) ** 2)
    gradient = np.einsum("i,ij,ijk->k", weights * kept, residuals, derivatives)
    matrix = None
    if with_matrix:
        weights = np.maximum(weights, _LEAST_WEIGHT * float(np.mean(weights)))
        rows = derivatives * np.sqrt(weights * kept)[:, None, None]
        rows = rows.reshape(-1, rows.shape[-1])
        matrix = rows.T @ rows
    return Curved(float(loss), gradient, matrix, int(np.sum(ratio > large)))
