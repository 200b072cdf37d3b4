"""Plans a ground track: flies reference controls over the energy, tabulates the outputs."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._integrate import runge_kutta, runge_kutta_step
from .._setup import needs_float64
from ..fields import Scalar
from ..flight.scenario import Scenario
from ..guidance.feedback_linearization import (
    AbstractLinearization,
    FullLinearization,
    GroundTrackModel,
    along_reference,
)
from ..motion.dynamics import with_respect_to
from ..motion.quantities import energy
from ..motion.state import Controls, EntryState
from ..onboard.profiles import QuinticTable, grid, quintic_table
from ._differences import with_differences


_STEPS_BACK = 100


class GroundTrackPlan(eqx.Module):
    """A reference for `GroundTrackTracking`, and its final state."""

    table: QuinticTable
    """Values of `along_reference` over the energy (J/kg)"""
    end: EntryState


@needs_float64
def plan_ground_track(
    scenario: Scenario,
    model: GroundTrackModel,
    end_energy: Scalar | float,
    first_energy: Scalar | float | None = None,
    linearization: AbstractLinearization = FullLinearization(),
    intervals: int = 4000,
) -> GroundTrackPlan:
    """Fly the reference controls of a model open loop, and tabulate the outputs.

    The motion is integrated over the energy, equations (10) to (15), with one step for each
    interval of the table. The outputs and their derivatives are computed with the
    expressions of the law that tracks the reference. Guidance and end conditions of the
    scenario are not used.

    **Arguments:**

    - `scenario`: planet, vehicle and initial state of the flight.
    - `end_energy`: energy at the end of the table, J/kg.
    - `first_energy`: energy at the start of the table (J/kg), for a reference that starts
      before the initial state: the motion is integrated backwards to it. None for the
      initial state.
    - `intervals`: number of intervals of the table; even, and four or more.
    """
    planet = scenario.planet

    def flow(state: EntryState) -> EntryState:
        here = energy(planet, state)
        flown = Controls.from_bank(model.bank(here), model.angle_of_attack(here))
        return scenario.dynamics.rates(planet, scenario.vehicle, state, flown)

    over_energy = with_respect_to(flow, lambda state: energy(planet, state))

    def slope(_: Scalar, state: EntryState) -> EntryState:
        return over_energy(state)

    start = scenario.initial_state
    here = energy(planet, start)
    if first_energy is not None:
        start = runge_kutta(slope, here, first_energy, start, _STEPS_BACK)
        here = jnp.asarray(first_energy, float)
    nodes = grid(here, jnp.asarray(end_energy, float), intervals)
    spacing = nodes[1] - nodes[0]

    def onwards(state: EntryState, _: None) -> tuple[EntryState, EntryState]:
        after = runge_kutta_step(slope, here, state, spacing)
        return after, after

    end, passed = lax.scan(onwards, start, length=intervals)
    states = jax.tree.map(lambda x, y: jnp.append(x, y), start, passed)
    seen = lambda state: along_reference(linearization, model, state)
    values = jax.vmap(seen)(states)
    with_slopes = {
        name: with_differences(jnp.asarray(column), spacing)
        for name, column in values.items()
    }
    return GroundTrackPlan(quintic_table(nodes, with_slopes), end)
