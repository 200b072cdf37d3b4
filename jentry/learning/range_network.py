"""Trains networks that predict where a flight ends, on predictions of the onboard model.

Flights of the predictor-corrector show which states occur. From states close to these the
rest of the flight is predicted, as the law would do, for banks of all sizes: in the
vertical plane, or in three dimensions with the bank to the right.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from .._setup import needs_float64
from ..campaign.batch import over_runs
from ..campaign.campaign import monte_carlo
from ..campaign.dispersions import Dispersion
from ..fields import Flag, Scalar
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver, FixedStep
from ..guidance.bank_shapes import ConstantBankShape
from ..guidance.predictor_corrector import PredictorCorrector
from ..guidance.range_network import (
    ACROSS,
    AHEAD,
    BASIS,
    INPUTS,
    OUTPUT,
    OUTPUT_ACROSS,
    PURPOSE,
    RangeNetwork,
    across_of,
    basis,
    features,
    full_turn,
    range_of,
)
from ..motion.quantities import ground_track
from ..motion.state import EntryState
from ..onboard.estimation import Factors
from ..onboard.measurement import Measurement, measure
from ..onboard.network import Network
from ..world.wind import StillAir
from .descent import descended, robust


INTERVAL = 4.0
"""Time between the places of a flight, s"""

LEAST = 1e3
"""Range to go below which there is nothing left to correct, m"""

_NEAR = 100e3
"""Range to go below which the error is also reported separately, m"""

_RIGHT = 20.0, 0.002
"""Unit of the error in the loss: a constant (m) plus a share of the range. The law corrects
an error far from the end later in the flight"""

_MOVED = {"altitude": 1000.0, "velocity": 50.0, "flight_path_angle": 0.02}
"""Standard deviations by which the states of places are varied: m, m/s, rad"""

_BEYOND = 0.05
"""Extension of the interval from 0 to 1 on both sides from which numbers are drawn. They
are then clipped, so that some lie at the bounds"""

_FACTORS = 0.1
"""Standard deviation by which the logarithms of the factors are varied"""


class RangeSamples(eqx.Module):
    """Predictions of the range. The first axis of every array is over the samples."""

    states: EntryState
    factors: Factors
    numbers: Float[np.ndarray, " n"]
    """Numbers that define the constant bank"""
    ranges: Float[np.ndarray, " n"]
    """Range, m; in three dimensions along the great circle of the initial heading"""
    across: Float[np.ndarray, " n"]
    """Distance of the end from that great circle, m, positive to the side of the bank; 0 in
    the plane"""
    flights: np.ndarray
    """Number of the flight from which the place of each sample is taken"""
    left_out: dict[str, int] = eqx.field(static=True)
    """Number of predictions that were left out, by reason"""

    def __len__(self) -> int:
        return len(self.flights)

    def of(self, chosen: np.ndarray) -> "RangeSamples":
        """Some of them, by index or by a mask."""
        return jax.tree.map(lambda x: np.asarray(x)[chosen], self)


class _Place(NamedTuple):
    """Initial state, factors and number of the bank of a prediction."""

    state: EntryState
    factors: Factors
    number: Any


@needs_float64
def predict_samples(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    flights: int,
    again: int,
    key: Key[Array, ""],
    *,
    solver: AbstractSolver = FixedStep(),
) -> RangeSamples:
    """Fly dispersed flights with the law, and predict from places close to these flights.

    **Arguments:**

    - `scenario`: scenario with a `PredictorCorrector`. Its flights are in the vertical
      plane or in three dimensions, like the predictions of the law.
    - `flights`: number of flights from the entry.
    - `again`: number of predictions. Each starts at a place of one of these flights, with
      varied state and factors, and with any bank.
    """
    law = _law(scenario)
    keys = jax.random.split(key, 5)
    campaign = monte_carlo(
        scenario, dispersions, keys[0], flights, solver=solver, history=INTERVAL
    )
    history = campaign.flights.history
    assert history is not None
    there = np.isfinite(history.time) & (history.decisions.decisions > 0.0)
    flight, place = np.nonzero(there)
    chosen = np.asarray(jax.random.choice(keys[1], len(flight), (again,)))
    flight, place = flight[chosen], place[chosen]
    state = jax.tree.map(lambda x: np.asarray(x)[flight, place], history.states)
    for number, (name, deviation) in enumerate(_MOVED.items()):
        normal = jax.random.normal(jax.random.fold_in(keys[2], number), (again,))
        moved = getattr(state, name) + deviation * np.asarray(normal)
        state = eqx.tree_at(lambda s, name=name: getattr(s, name), state, moved)
    estimate = history.decisions.estimate.factors
    lift, drag = (
        np.asarray(x)[flight, place]
        * np.exp(_FACTORS * np.asarray(jax.random.normal(k, (again,))))
        for x, k in zip(
            (estimate.lift, estimate.drag), jax.random.split(keys[3]), strict=True
        )
    )
    # Some lie at the bounds, since a number of the law can saturate there.
    drawn = jax.random.uniform(keys[4], (again,), float, -_BEYOND, 1.0 + _BEYOND)
    numbers = np.clip(np.asarray(drawn), 0.0, 1.0)
    places = _Place(state, Factors(jnp.asarray(lift), jnp.asarray(drag)), numbers)
    ranges, across, ends = over_runs(_predicted, law, places)
    far = ranges >= LEAST
    samples = RangeSamples(
        jax.tree.map(np.asarray, state),
        jax.tree.map(np.asarray, places.factors),
        numbers,
        ranges,
        across,
        flight,
        {
            "have no end, or skip": int(np.sum(~ends)),
            f"have less than {LEAST / 1e3:g} km to go": int(np.sum(ends & ~far)),
        },
    )
    return samples.of(ends & far)


def _law(scenario: Scenario) -> PredictorCorrector:
    law = scenario.law
    if not isinstance(law, PredictorCorrector):
        raise ValueError(
            f"the law is {type(law).__name__}: expected a PredictorCorrector, whose "
            "predictions are learnt"
        )
    if not isinstance(law.shape, ConstantBankShape) or law.shape.lowest != -1.0:
        raise ValueError(
            f"the shape of the bank is {law.shape}: the range can be learnt for a "
            "ConstantBankShape with lowest=-1.0 only"
        )
    planet = law.model.planet
    if planet.rotation_rate != 0.0 or not isinstance(planet.wind, StillAir):
        raise ValueError(
            "predictions must not depend on the direction, so that the planet must be at "
            f"rest with still air: that of the model turns by {planet.rotation_rate} "
            f"rad/s, and its wind is {type(planet.wind).__name__}"
        )
    return law


def _predicted(law: PredictorCorrector, place: _Place) -> tuple[Scalar, Scalar, Flag]:
    """Range of a prediction, its distance to the side of the bank, and whether it ends."""
    state = place.state
    angle = law.model.vehicle.trim_angle_of_attack
    sensed = measure(law.model.planet, law.model.vehicle, state, angle)
    measurement = Measurement(state, sensed.lift, sensed.drag, angle, angle, {})
    end = law.predicted(
        jnp.zeros_like(state.altitude),
        measurement,
        place.factors,
        jnp.stack([place.number]),
        1.0,
        in_space=law.in_space,
    )
    ends = end.has_end & jnp.logical_not(law.end.is_skip(end.ended_by))
    if not law.in_space:
        ahead = law.model.planet.radius * end.state.longitude
        return ahead, jnp.zeros_like(ahead), ends
    ahead, to_the_left = ground_track(law.model.planet, state, end.state)
    return ahead, -to_the_left, ends


class TrainedRange(eqx.Module):
    """A trained network, with its errors on held-out flights."""

    network: RangeNetwork
    cards: dict[str, dict[str, Any]] = eqx.field(static=True)
    """Descriptions of the networks by name: `range`, or in three dimensions `ahead` and
    `across`"""

    @property
    def networks(self) -> dict[str, Network]:
        """Networks by the names of `cards`."""
        return dict(zip(self.cards, self.network.networks, strict=True))


class _Lesson(NamedTuple):
    """A length that a network learns. The first axis of every array is over the samples."""

    purpose: str
    output: str
    lengths: Array
    """Length of each sample, m"""
    of_output: Callable[[Array, Array], Scalar]
    """Function of outputs of the network and of the indices of their samples: lengths, m"""
    outputs: Array
    """Outputs that give the lengths; not finite where no output gives the length"""


class _Class(NamedTuple):
    """Training data of all networks. The first axis of every array is over the samples."""

    read: Array
    """Inputs of the networks"""
    ranges: Array
    """Range of each sample, m"""
    out: np.ndarray
    """Whether each sample is held out"""


def train_range_network(
    scenario: Scenario,
    samples: RangeSamples,
    key: Key[Array, ""],
    *,
    hidden: tuple[int, ...] = (32, 32),
    warm_up: int = 3000,
    iterations: int = 5000,
    part: int = 40000,
    held_out: float = 0.1,
    report: Callable[[str], None] = lambda line: None,
) -> TrainedRange:
    """Fit networks to predictions with Adam, and then with L-BFGS on a part of them.

    The loss is `robust` of the error, in units that grow with the range. In three
    dimensions one network learns the distance ahead, and another one the distance to the
    side. A share of the flights, with all samples that belong to them, is held out to
    measure the error.

    **Arguments:**

    - `hidden`: number of neurons in each hidden layer.
    - `warm_up`: number of steps of Adam.
    - `iterations`: number of iterations of L-BFGS, with `part` samples.
    - `held_out`: share of the flights that is held out.
    - `report`: function that is called with lines of text on the progress.
    """
    law = _law(scenario)
    end = law.end.first()
    angle = law.model.vehicle.trim_angle_of_attack
    flights = int(np.max(samples.flights)) + 1

    @eqx.filter_jit
    def prepared(state: EntryState, factors: Factors, number: Array):
        def one(state, factors, number):
            return features(law.model, state, angle, factors, number)

        square = jnp.asarray(state.velocity**2 - end[0] ** 2)
        turn = jnp.asarray(jax.vmap(full_turn)(number, state.velocity / end[0]))
        return jax.vmap(one)(state, factors, number), square, turn

    given = samples.states, samples.factors, samples.numbers
    read, square, turn = prepared(*jax.tree.map(jnp.asarray, given))
    ranges, across = jnp.asarray(samples.ranges), jnp.asarray(samples.across)
    along = AHEAD if law.in_space else PURPOSE
    lessons = {
        "ahead" if law.in_space else "range": _Lesson(
            along,
            OUTPUT,
            ranges,
            lambda outputs, chosen: jax.vmap(range_of)(square[chosen], outputs),
            jnp.log(0.5 * square / ranges),
        )
    }
    if law.in_space:
        # Without a bank to the side the distance is zero, and its logarithm not finite.
        lessons["across"] = _Lesson(
            ACROSS,
            OUTPUT_ACROSS,
            across,
            lambda outputs, chosen: jax.vmap(across_of)(
                ranges[chosen], turn[chosen], outputs
            ),
            jnp.log(across / (ranges * turn)),
        )
    keys = {n: jax.random.fold_in(key, i) if i else key for i, n in enumerate(lessons)}
    split = jax.random.split(key, 4)[1]
    out = np.asarray(jax.random.uniform(split, (flights,))) < held_out
    taught = _Class(read, ranges, out[samples.flights])
    of = basis(law.model, scenario.initial_state, angle, end)
    networks, took = [], []
    for name, lesson in lessons.items():

        def told(line: str, name: str = name) -> None:
            report(f"{name}: {line}")

        began = time.perf_counter()
        networks.append(
            _taught(lesson, taught, keys[name], hidden, warm_up, iterations, part, told)
        )
        took.append(round(time.perf_counter() - began, 1))
    first, *more = networks
    network = RangeNetwork(first, of, *more)

    @eqx.filter_jit
    @jax.vmap
    def asked(state: EntryState, factors: Factors, number: Array):
        return network(law.model, state, angle, factors, number, end)

    # As in flight: the distance to the side includes the error of the predicted range.
    answers = jax.tree.map(np.asarray, asked(*jax.tree.map(jnp.asarray, given)))
    held = taught.out & answers.knows
    near = samples.ranges[held] < _NEAR
    cards = {}
    for name, seconds, found in zip(lessons, took, answers, strict=False):
        lesson = lessons[name]
        error = np.abs(found - np.asarray(lesson.lengths))[held]
        cards[name] = {
            "purpose": lesson.purpose,
            "output": lesson.output,
            "of": dict(zip(BASIS, np.asarray(of).tolist(), strict=True)),
            "samples": int(np.sum(~taught.out)),
            "flights": flights,
            "left out": samples.left_out,
            "held out samples": int(taught.out.sum()),
            "held out samples outside of the ranges": int(
                np.sum(taught.out & ~answers.knows)
            ),
            "held out mean error, m": float(error.mean()),
            "held out 95 % error, m": float(np.percentile(error, 95)),
            "held out mean error below 100 km, m": float(error[near].mean()),
            "held out 95 % error below 100 km, m": float(
                np.percentile(error[near], 95)
            ),
            "steps of Adam, iterations of L-BFGS": [warm_up, iterations],
            "training, s": seconds,
        }
    return TrainedRange(network, cards)


def _taught(
    lesson: _Lesson,
    samples: _Class,
    key: Key[Array, ""],
    hidden: tuple[int, ...],
    warm_up: int,
    iterations: int,
    part: int,
    report: Callable[[str], None],
) -> Network:
    """Train a network to predict a length."""
    read, ranges, out = samples
    network_key, _, batch_key, part_key = jax.random.split(key, 4)
    inside = np.flatnonzero(~out)
    outputs = np.asarray(lesson.outputs)[inside]
    untrained = Network.untrained(
        INPUTS,
        np.asarray(read)[inside],
        outputs[np.isfinite(outputs)],
        hidden,
        network_key,
    )
    right = _RIGHT[0] + _RIGHT[1] * ranges

    def loss(network: Network, chosen: Array) -> Array:
        outputs = jnp.asarray(jax.vmap(network)(read[chosen]))
        lengths = jnp.asarray(lesson.of_output(outputs, chosen))
        return robust((lengths - lesson.lengths[chosen]) / right[chosen])

    return descended(
        untrained,
        loss,
        jnp.asarray(inside),
        batch_key,
        part_key,
        warm_up=warm_up,
        iterations=iterations,
        part=part,
        report=report,
    )
