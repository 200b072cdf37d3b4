"""Exact derivatives of the outputs of a flight with respect to numbers of its scenario."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._programs import cached
from .._setup import needs_float64
from ..addresses import addresses_of, leaves_by_address, require_address
from ..campaign.campaign import fly_run
from ..flight.miss import misses
from ..flight.scenario import Scenario
from ..flight.scenario_checks import checked, require_effect, without_effect
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Outcome, has_end
from ..tuning.batch_gradients import FORWARD_UP_TO, Outputs


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Outputs of one flight, and their Jacobian."""

    values: dict[str, np.ndarray]
    """Outputs of the flight by name"""
    jacobian: dict[str, dict[str, np.ndarray]]
    """Derivatives by output and address. Their shape is that of the output followed by that
    of the leaf"""
    ended_by: str
    """Name of the end condition. The derivatives assume that the same condition ends the
    flight"""


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

    The Jacobian is exact for the computed flight, including its end. Clipped commands stay
    clipped, and decisions do not change. For a law with a guidance cycle it is therefore
    the slope between two jumps. Where the phase of the last cycle makes an output a
    sawtooth function, as for the final altitude and flight-path angle of `cav-h`, it is the
    slope of one tooth, and does not predict changes across several teeth. Where two end
    conditions are met at once, it is the slope on the side of `ended_by`. For the mean
    change of an output use `linear_covariance(..., mode="difference")`. If the initial
    state changes, a target that is a place stays fixed, and a target that is a range moves
    with it.

    **Arguments:**

    - `outputs`: function of scenario and flight, such as `misses`, that returns numbers in
      any structure.
    - `wrt`: lens to the leaves, of any shape; None for the initial state.
    - `history`: interval (s) of the history of the flight, if the outputs use it.
    - `mode`: "forward" or "reverse"; None chooses by the number of leaves.
    - `inputs`: instead of `wrt`, values of leaves by address, such as those of one run of a
      campaign. The derivatives are with respect to these leaves, at these values.

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
                    "output may have none there, like a distance at zero"
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
    """Name of an output from its address; a single number without a name is "output"."""
    return address or "output"


@cached
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
