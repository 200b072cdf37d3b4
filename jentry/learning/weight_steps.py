"""Methods that train the weights of a neural law: Adam, and Gauss and Newton.

Adam finds a law from random weights. Gauss and Newton's method then makes it exact: near a
flight that hits, residuals are almost linear in the weights, and a step solves for all of
them at once. Both take fresh flights in each step.
"""

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
import optax
import scipy.linalg

from .flight_residuals import LARGE, Curved, Statistic, Weights


State = dict[str, np.ndarray]
"""State of a method by name, as arrays that a file can hold"""

Tried = Callable[[Weights], tuple[int, float]]
"""Number of flights without an end, and loss of the others, of weights on other fresh
flights of the step. Fewer without an end are better, and then a smaller loss"""


class Stepped(NamedTuple):
    """Weights and state after a step."""

    weights: Weights
    state: State


@dataclasses.dataclass(frozen=True)
class AbstractMethod:
    """A part of a training: its number of steps, of flights in each, and its loss."""

    statistic: Statistic
    """Loss: a statistic of the distances of the flights"""
    steps: int
    flights: int
    """Number of fresh flights in a step"""
    large: float = dataclasses.field(default=LARGE, kw_only=True)
    """Factor by which the derivatives of a flight exceed the median if it has half of its
    weight. Early in a training flights with large derivatives say little; later they may be
    those that are to be mended"""

    def __post_init__(self):
        for name in ("steps", "flights", "large"):
            value = getattr(self, name)
            if not value >= 1:
                raise ValueError(f"{name} is {value}: it must be at least 1")
        for name, largest in self.limits().items():
            value = getattr(self, name)
            if not 0.0 <= value <= largest:
                raise ValueError(f"{name} is {value}: it must be from 0 to {largest:g}")

    @abstractmethod
    def limits(self) -> dict[str, float]:
        """Largest values of the fields that must not be negative, by name."""

    @property
    @abstractmethod
    def needs_matrix(self) -> bool:
        """Whether a step needs the matrix of Gauss and Newton."""

    @abstractmethod
    def start(self, weights: Weights) -> State:
        """State before the first step."""

    @abstractmethod
    def step(
        self, number: int, weights: Weights, state: State, found: Curved, tried: Tried
    ) -> Stepped:
        """Weights and state after the step with a number, from 0 on."""

    def falling(self, number: int) -> float:
        """Half a wave of a cosine: 1 at the first step, 0 after the last one."""
        return 0.5 * (1.0 + math.cos(math.pi * number / self.steps))


@dataclasses.dataclass(frozen=True)
class AdamSteps(AbstractMethod):
    """Adam, with a gradient of bounded norm and a rate that falls to zero.

    Reference: D. P. Kingma, J. Ba, "Adam: A Method for Stochastic Optimization", 2015.
    """

    rate: float = 1e-2
    largest_norm: float = 1.0
    """Norm to which a longer gradient is scaled"""

    def limits(self) -> dict[str, float]:
        return {"rate": math.inf, "largest_norm": math.inf}

    @property
    def needs_matrix(self) -> bool:
        return False

    def start(self, weights: Weights) -> State:
        return _as_arrays(self._optimizer().init(weights))

    def step(
        self, number: int, weights: Weights, state: State, found: Curved, tried: Tried
    ) -> Stepped:
        optimizer = self._optimizer()
        like = optimizer.init(weights)
        leaves = [state[name] for name in sorted(state)]
        now = jax.tree.unflatten(jax.tree.structure(like), leaves)
        update, now = optimizer.update(found.gradient, now, weights)
        moved = weights + self.rate * self.falling(number) * np.asarray(update)
        return Stepped(moved, _as_arrays(now))

    def _optimizer(self) -> optax.GradientTransformation:
        clip = optax.clip_by_global_norm(self.largest_norm)
        return optax.chain(clip, optax.scale_by_adam(), optax.scale(-1.0))


def _as_arrays(state: Any) -> State:
    leaves = jax.tree.leaves(state)
    return {f"adam{i:02}": np.asarray(leaf) for i, leaf in enumerate(leaves)}


@dataclasses.dataclass(frozen=True)
class GaussNewtonSteps(AbstractMethod):
    """Damped steps of Gauss and Newton, with an average of the matrix over the steps.

    A step is a share of the solution d of (A + damping (mean A_jj + A_jj)) d = -g. A is the
    average matrix, and g the gradient of this step: it is noisy, since a step has few
    flights for so many weights, and so only a share of the solution is taken, which falls.
    Three dampings are tried on other flights, and the best is taken. If none lowers the
    loss, the weights stay, and the damping grows.

    References: N. N. Schraudolph, "Fast Curvature Matrix-Vector Products for Second-Order
    Gradient Descent", Neural Computation 14(7), 2002, for the matrix. J. Martens, R.
    Grosse, "Optimizing Neural Networks with Kronecker-factored Approximate Curvature",
    2015, for averages of it and a damping that adapts.
    """

    share: float = 0.3
    """Share of the solution in the first step"""
    least_share: float = 0.015
    """Share in the last step"""
    memory: float = 0.9
    """Factor on the weight of a matrix in the average with each further step"""

    def limits(self) -> dict[str, float]:
        return {"share": 1.0, "least_share": 1.0, "memory": _LONGEST_MEMORY}

    @property
    def needs_matrix(self) -> bool:
        return True

    def start(self, weights: Weights) -> State:
        count = len(weights)
        return {
            "matrix": np.zeros((count, count)),
            "weight": np.zeros(()),
            "damping": np.array(_FIRST_DAMPING),
        }

    def step(
        self, number: int, weights: Weights, state: State, found: Curved, tried: Tried
    ) -> Stepped:
        assert found.matrix is not None
        fresh = 1.0 - self.memory
        matrix = self.memory * state["matrix"] + fresh * found.matrix
        weight = self.memory * state["weight"] + fresh
        average = matrix / weight
        diagonal = np.diag(average)
        damped = float(np.mean(diagonal)) + diagonal
        share = self.least_share
        share += (self.share - self.least_share) * self.falling(number)
        damping, before = float(state["damping"]), tried(weights)
        best, moved, factor = before, weights, _WORSE
        for by in _DAMPINGS:
            system = average.copy()
            system[np.diag_indices_from(system)] += by * damping * damped
            step = scipy.linalg.solve(
                system, found.gradient, assume_a="pos", overwrite_a=True
            )
            there = weights - share * step
            loss = tried(there)
            if loss < best:
                best, moved, factor = loss, there, by
        damping = min(max(damping * factor, _LEAST_DAMPING), _LARGEST_DAMPING)
        return Stepped(
            moved,
            {
                "matrix": matrix,
                "weight": np.array(weight),
                "damping": np.array(damping),
            },
        )


_LONGEST_MEMORY = 0.9999

_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-2, 1e-7, 10.0

_DAMPINGS = 1.0 / 3.0, 1.0, 3.0
"""Factors on the damping that are tried"""

_WORSE = 2.0
"""Factor on the damping if none of them lowers the loss"""
