"""Exact derivatives of what a flight gives, with respect to any of its numbers."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._programs import kept
from .._setup import needs_float64
from ..addresses import addresses_of, leaves_by_address, require_address
from ..campaign.campaign import fly_run
from ..flight.miss import misses
from ..flight.scenario import Scenario, checked, require_effect, without_effect
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Outcome, has_end
from ..tuning.batch_gradients import FORWARD_UP_TO, Outputs


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Outputs of one flight, and their Jacobian."""

    values: dict[str, np.ndarray]
    """Outputs of the flight by their names"""
    jacobian: dict[str, dict[str, np.ndarray]]
    """Derivatives by output and address, each of the shape of the output and then that of
    the leaf"""
    ended_by: str
    """Name of the end condition, which the derivatives take to stay the one that ends
    the flight"""


@needs_float64
def sensitivity(
    scenario: Scenario,
    outputs: Outputs = misses,
    wrt: Callable[[Any], Any] | None = None,
    *,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
    mode: str | None = None,
    inputs: Mapping[str, Any] | None = None,
) -> Sensitivity:
    """Jacobian of flight outputs with respect to leaves of the scenario.

    Exact for the flight as it is computed, its end included: commands that are clipped
    stay clipped, decisions that were taken stay taken. So it is the slope between the jumps
    of a law that decides in cycles: where the phase of the last cycle makes a sawtooth of
    an output, as with the altitude and the path angle that `cav-h` arrives with, it is that
    of one tooth, and no guide to a change across several. At a corner, as of two
    end conditions that are met at once, it is that of one side, `ended_by`. How an output
    changes in the mean tells `linear_covariance(..., mode="difference")`. A target
    that is a place stays where it is when the start moves; one that is a range moves along.

    **Arguments:**

    - `outputs`: a function of scenario and flight, such as `misses`; of any structure.
    - `wrt`: lens to the leaves, of any shape; the initial state if not given.
    - `history`: interval (s) of the flight's history, if the outputs look at it.
    - `mode`: "forward" or "reverse"; by the number of leaves if not given.
    - `inputs`: in place of `wrt`, values of leaves by address, such as those of one run of
      a campaign: the derivatives are with respect to these, at these.

    **Raises:** `ValueError` for a lens that reaches no leaf, a leaf without effect, and a
    flight or a derivative that is not finite.

        s = sensitivity(scenario, wrt=lambda s: s.planet.density_scale)
        s.jacobian["downrange"]["planet.density_scale"]
    """
    scenario = checked(scenario)
    if mode not in (None, "forward", "reverse"):
        raise ValueError(f'mode is {mode!r}: it must be "forward" or "reverse"')
    known = leaves_by_address(scenario)
    if inputs is not None:
        if wrt is not None:
            raise ValueError("give wrt or inputs, not both")
        if not inputs:
            raise ValueError("the inputs are empty: give values by address")
        addresses = list(inputs)
        for address in addresses:
            require_address(known, address)
        known = {a: jnp.asarray(x, dtype=known[a].dtype) for a, x in inputs.items()}
    elif wrt is None:
        entry = addresses_of(scenario, lambda s: s.initial_state)
        addresses = [a for a in entry if a not in without_effect(scenario)]
    else:
        addresses = addresses_of(scenario, wrt)
    for address in addresses:
        require_effect(scenario, address)
    count = sum(known[address].size for address in addresses)
    forward = count <= FORWARD_UP_TO if mode is None else mode == "forward"
    leaves = {address: known[address] for address in addresses}
    jacobian, values, outcome, ended_by = _jacobian(
        leaves, scenario, outputs, solver, history, forward
    )
    if not has_end(int(outcome)):
        raise ValueError(
            f"the flight {Outcome(int(outcome)).message}: it has no derivatives; fly it "
            "with a history and see where it fails"
        )
    by_output = leaves_by_address(values)
    names = list(by_output)
    flat = jax.tree.structure(values).flatten_up_to(jacobian)
    for name, by_address in zip(names, flat, strict=True):
        for address, slope in by_address.items():
            if not np.all(np.isfinite(slope)):
                raise ValueError(
                    f"the derivative of {named(name)} to {address} is not finite: the "
                    "output may have none there, as a distance has not at zero"
                )
    return Sensitivity(
        values={named(n): np.asarray(value) for n, value in by_output.items()},
        jacobian={
            named(name): {a: np.asarray(by_address[a]) for a in addresses}
            for name, by_address in zip(names, flat, strict=True)
        },
        ended_by=scenario.termination.names[int(ended_by)],
    )


def named(address: str) -> str:
    """Outputs by name; one number without a name of its own is called "output"."""
    return address or "output"


@kept
def _jacobian(
    leaves: dict[str, Array],
    scenario: Scenario,
    outputs: Outputs,
    solver: AbstractSolver,
    history: float | None,
    forward: bool,
):
    def of_leaves(leaves):
        flight, dispersed = fly_run(scenario, leaves, solver, history)
        values = jax.tree.map(
            lambda x: jnp.asarray(x, float), outputs(dispersed, flight)
        )
        return values, (values, flight.outcome, flight.ended_by)

    derivative = jax.jacfwd if forward else jax.jacrev
    jacobian, (values, outcome, ended_by) = derivative(of_leaves, has_aux=True)(leaves)
    return jacobian, values, outcome, ended_by
