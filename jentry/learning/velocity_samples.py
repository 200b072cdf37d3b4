"""Simulated flights from which a network learns the velocity at the target.

Flights start at the entry. Further flights start at places along these with another curve,
so that the samples include flights that are planned again on the way.
"""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from .._setup import needs_float64
from ..campaign.campaign import Campaign, monte_carlo
from ..campaign.dispersions import Dispersion
from ..fields import Scalar
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Outcome
from ..guidance.bezier.anchoring import Shape, parameters_of
from ..guidance.bezier.law import HeldCurve
from ..guidance.bezier.prediction import FlownModel, Situation
from ..motion.state import EntryState
from ..planning.bezier_curve import K1, K2, bezier_law


INTERVAL = 20.0
"""Time between the samples of a flight, s"""


class Samples(eqx.Module):
    """Situations along flights, and the final velocities of these flights.

    The first axis of every array is over the samples.
    """

    situations: Situation
    final_velocity: Float[np.ndarray, " n"]
    """Velocity at the end of the flight, m/s"""
    flights: np.ndarray
    """Number of the flight of each sample"""
    vehicles: np.ndarray
    """Number of the vehicle of each sample; a second flight of a vehicle has its number"""
    at_entry: np.ndarray
    """Whether each sample is at the entry of its vehicle"""
    left_out: dict[str, int] = eqx.field(static=True)
    """Number of samples that were left out, by reason"""

    def __len__(self) -> int:
        return len(self.flights)

    def of(self, chosen: np.ndarray) -> "Samples":
        """Some of them, by index or by a mask."""
        return jax.tree.map(lambda x: np.asarray(x)[chosen], self)


@needs_float64
def fly_samples(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    flights: int,
    key: Key[Array, ""],
    *,
    again: int = 0,
    between: tuple[float, float] | None = None,
    on_curve: bool = True,
    solver: AbstractSolver = FixedStep(),
) -> Samples:
    """Fly dispersed flights with the law without velocity control, and sample them.

    **Arguments:**

    - `dispersions`: dispersions that the network must cover, wider than in use. Lift and
      drag are dispersed as factors of the vehicle.
    - `flights`: number of flights from the entry.
    - `again`: number of flights from places along these, with a random change of the third
      control point.
    - `between`: range of velocities at the target (m/s) of the flights that count; None for
      all flights.
    - `on_curve`: whether to leave out flights that left the curve at a limit of the angle
      of attack, since their end depends on the start in another way. They are recognised by
      a final velocity far from that of the curve. On the curve the difference, which is due
      to commands held over guidance cycles, is 12 m/s at most.
    - `solver`: as for `fly`.
    """
    first_key, second_key = jax.random.split(key)
    first = monte_carlo(
        scenario, dispersions, first_key, flights, solver=solver, history=INTERVAL
    )
    flown = _flown(scenario, first, on_curve)
    samples = _samples(scenario, first, flown, np.arange(flights), 0)
    left_out = flown.left_out
    if again:
        keys = jax.random.split(second_key)
        chosen = jax.random.choice(keys[0], len(samples), (again,))
        chosen = np.asarray(chosen)
        inputs = _moved_inputs(scenario, first, flown, samples, chosen, keys[1])
        second = monte_carlo(scenario, inputs=inputs, solver=solver, history=INTERVAL)
        flown = _flown(scenario, second, on_curve)
        more = _samples(scenario, second, flown, samples.vehicles[chosen], flights)
        samples = jax.tree.map(lambda *parts: np.concatenate(parts), samples, more)
        left_out = {
            reason: n + flown.left_out[reason] for reason, n in left_out.items()
        }
    if between is not None:
        final = samples.final_velocity
        inside = (final > between[0]) & (final < between[1])
        reason = f"end outside of {between[0]:g} to {between[1]:g} m/s"
        left_out = left_out | {reason: int(np.sum(~inside))}
        samples = samples.of(inside)
    return dataclasses.replace(samples, left_out=left_out)


class _Flown(NamedTuple):
    """Places in the histories of a campaign that become samples."""

    flight: np.ndarray
    place: np.ndarray
    left_out: dict[str, int]


def _flown(scenario: Scenario, campaign: Campaign, on_curve: bool) -> _Flown:
    law = bezier_law(scenario)
    history = campaign.flights.history
    assert history is not None

    def expected(state: EntryState, decision: HeldCurve) -> Scalar:
        glide = law.glide(scenario.constraints)
        return FlownModel().predict(glide, law.situation(state, decision))

    there = np.isfinite(np.asarray(history.time))
    kept = np.asarray(campaign.flights.outcome) == Outcome.REACHED
    left_out = {"do not reach the target": int(there[~kept].sum())}
    if on_curve:
        first = jax.tree.map(
            lambda x: jnp.asarray(x[:, 0]), (history.states, history.decisions)
        )
        predicted = np.asarray(eqx.filter_jit(jax.vmap(expected))(*first))
        final = np.asarray(campaign.flights.state.velocity)
        off = kept & ~(np.abs(predicted - final) < _OFF_CURVE)
        reason = "leave the curve at a limit of the angle of attack"
        left_out[reason] = int(there[off].sum())
        kept = kept & ~off
    flight, place = np.nonzero(there & kept[:, None])
    return _Flown(flight, place, left_out)


def _samples(
    scenario: Scenario,
    campaign: Campaign,
    flown: _Flown,
    vehicles: np.ndarray,
    before: int,
) -> Samples:
    """Samples at all places of `flown`. The flights are numbered from `before` on."""
    law = bezier_law(scenario)
    history = campaign.flights.history
    assert history is not None
    flight, place, _ = flown
    states, decisions = jax.tree.map(
        lambda x: jnp.asarray(x[flight, place]), (history.states, history.decisions)
    )

    def situation(state: EntryState, decision: HeldCurve) -> Situation:
        return law.situation(state, decision)

    situations = eqx.filter_jit(jax.vmap(situation))(states, decisions)
    return Samples(
        situations=jax.tree.map(np.asarray, situations),
        final_velocity=np.asarray(campaign.flights.state.velocity)[flight],
        flights=before + flight,
        vehicles=vehicles[flight],
        at_entry=(place == 0) & (before + flight == vehicles[flight]),
        left_out={},
    )


def _moved_inputs(
    scenario: Scenario,
    campaign: Campaign,
    flown: _Flown,
    samples: Samples,
    chosen: np.ndarray,
    key: Key[Array, ""],
) -> dict[str, np.ndarray]:
    """Inputs by address for flights from samples, with a moved third control point."""
    law = bezier_law(scenario)
    history = campaign.flights.history
    assert history is not None
    situations = jax.tree.map(jnp.asarray, samples.of(chosen).situations)
    share = jax.random.uniform(
        key, (len(chosen),), minval=-1.0, maxval=1.0, dtype=float
    )

    def moved(situation: Situation, share: Array):
        lower, upper = law.anchoring.bounds(situation.point, situation.target)
        second = situation.shape.second + 0.2 * share * (upper - lower)
        shape = Shape(situation.shape.first, jnp.clip(second, lower, upper))
        return parameters_of(law.anchoring, shape, situation.point, situation.target)

    parameters = eqx.filter_jit(jax.vmap(moved))(situations, share)
    flight, place = flown.flight[chosen], flown.place[chosen]
    states = jax.tree.map(lambda x: np.asarray(x)[flight, place], history.states)
    inputs = {a: np.asarray(v)[flight] for a, v in campaign.inputs.items()}
    inputs |= {f"initial_state.{name}": v for name, v in vars(states).items()}
    inputs |= {K1: np.asarray(parameters.k1), K2: np.asarray(parameters.k2)}
    return {address: np.asarray(values) for address, values in inputs.items()}


_OFF_CURVE = 20.0
"""Difference of the final velocity above which a flight has left the curve, m/s"""
