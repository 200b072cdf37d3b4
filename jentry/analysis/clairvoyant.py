"""Clairvoyant floor: the misses with the optimal bank profile for each known draw."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Key

from .._setup import needs_float64
from ..campaign.batch import over_runs
from ..campaign.campaign import drawn_inputs, fly_run
from ..campaign.dispersions import Dispersion, check_dispersions
from ..flight.miss import misses
from ..flight.scenario import Scenario
from ..flight.scenario_checks import checked
from ..flight.solver import AbstractSolver, FixedStep
from ..guidance.open_loop import BankProfile
from ..onboard.profiles import PolynomialProfile
from ..tuning.batch_gradients import Outputs
from ..tuning.losses import MeanSquare


@needs_float64
def clairvoyant_floor(
    scenario: Scenario,
    loss: MeanSquare,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    runs: int = 256,
    *,
    end_velocity: float,
    coefficients: int = 4,
    outputs: Outputs = misses,
    solver: AbstractSolver = FixedStep(),
    most_steps: int = 60,
) -> tuple[Any, np.ndarray]:
    """Outputs of each draw with the bank profile that is optimal for this draw.

    A polynomial of the velocity for cos(bank) replaces the law of the scenario. Its
    coefficients are fitted to each draw by least squares with simulated flights. The result
    is what a law with perfect foresight and such a profile could reach. The true floor may
    be lower: the profile is limited, and the search may end early for some draws. Flights
    must be in a vertical plane.

    **Arguments:**

    - `loss`: a `MeanSquare`; its residuals are minimised for each draw.
    - `end_velocity`: approximate velocity at the end of the flight, m/s. The polynomial
      covers the velocities from there to the initial velocity.
    - `coefficients`: number of coefficients of the polynomial.
    - `most_steps`: largest number of steps of the Levenberg-Marquardt method.

    **Returns:** the outputs, each of shape (runs, ...), and the coefficients, (runs, n).

    **Raises:** `ValueError` for a scenario with crossrange.
    """
    scenario = checked(scenario)
    if scenario.dynamics.has_crossrange:
        raise ValueError(
            "a bank profile to one side cannot meet a crossrange: take a scenario with "
            "dynamics=EquatorialDynamics()"
        )
    check_dispersions(scenario, dispersions)
    if coefficients < 1:
        raise ValueError(f"coefficients is {coefficients}: it must be at least 1")
    inputs = drawn_inputs(scenario, dispersions, key, np.arange(runs))
    span = scenario.initial_state.velocity - end_velocity
    profile = PolynomialProfile(jnp.zeros(coefficients), end_velocity, span)
    law = BankProfile(profile)
    open_loop = eqx.tree_at(lambda s: s.guidance, scenario, law)
    shared = open_loop, loss, outputs, solver, most_steps, coefficients
    # On one device: the solver cannot be compiled for work that is divided over devices.
    return over_runs(_search, shared, inputs, one_device=True)


def _search(shared, inputs):
    """Outputs of one draw with its optimal profile, and the coefficients of the profile."""
    scenario, loss, outputs, solver, most_steps, coefficients = shared
    method = optimistix.LevenbergMarquardt(rtol=1e-6, atol=1e-6)
    first = jnp.zeros(coefficients).at[0].set(0.5)

    def flown(c):
        given = eqx.tree_at(lambda s: s.guidance.cos_bank.coefficients, scenario, c)
        flight, dispersed = fly_run(given, inputs, solver)
        return outputs(dispersed, flight)

    def residuals(c, _):
        alone = jax.tree.map(lambda x: jnp.asarray(x)[None], flown(c))
        return loss.residuals(alone)

    found = optimistix.least_squares(
        residuals, method, first, max_steps=most_steps, throw=False
    ).value
    return flown(found), found
