"""Plan a ground track: fly reference controls over the energy, tabulate what they give."""

import equinox as eqx

from .._integrate import runge_kutta
from .._setup import needs_float64
from ..fields import Scalar
from ..flight.scenario import Scenario
from ..flight.termination import EnergyBelow, Termination
from ..guidance.feedback_linearization import (
    AbstractLinearization,
    FullLinearization,
    GroundTrackModel,
    along_reference,
)
from ..guidance.open_loop import ControlProfiles
from ..motion.dynamics import with_respect_to
from ..motion.index import EnergyIndex
from ..motion.quantities import energy
from ..motion.state import Controls, EntryState
from ..onboard.profiles import QuinticTable
from .reference_flight import ReferenceFlight


_BACKWARD_STEPS = 100


@needs_float64
def fly_reference_controls(
    scenario: Scenario,
    model: GroundTrackModel,
    end_energy: Scalar | float,
    first_energy: Scalar | float | None = None,
    interval: float = 0.1,
) -> ReferenceFlight:
    """Fly the reference controls of a model open loop, through an initial state.

    The guidance and the end conditions of the scenario are not used.

    **Arguments:**

    - `scenario`: what flies, from its initial state.
    - `end_energy`: where the flight ends, J/kg.
    - `first_energy`: where it begins (J/kg), for a reference that reaches beyond the
      initial state: the motion is followed back to there. None for the initial state.
    - `interval`: at which the flight is kept, s.
    """
    planet = scenario.planet
    law = ControlProfiles(EnergyIndex(), planet, model.angle_of_attack, model.bank)
    start = scenario.initial_state
    if first_energy is not None:

        def flow(state: EntryState) -> EntryState:
            here = energy(planet, state)
            flown = Controls.from_bank(model.bank(here), model.angle_of_attack(here))
            return scenario.dynamics.rates(planet, scenario.vehicle, state, flown)

        back = with_respect_to(flow, lambda state: energy(planet, state))
        here = energy(planet, start)
        steps = _BACKWARD_STEPS
        start = runge_kutta(
            lambda _, state: back(state), here, first_energy, start, steps
        )
    ends = {
        "energy": EnergyBelow(
            energy=end_energy, radius=planet.radius, gravity=planet.gravity
        )
    }
    flown = eqx.tree_at(
        lambda s: (s.initial_state, s.guidance, s.termination),
        scenario,
        (start, law, Termination(ends, scenario.termination.time_limit)),
    )
    return ReferenceFlight.of(flown, interval)


@needs_float64
def plan_ground_track(
    flight: ReferenceFlight,
    model: GroundTrackModel,
    linearization: AbstractLinearization = FullLinearization(),
    intervals: int = 4000,
) -> QuinticTable:
    """Outputs of a flown reference and their derivatives over the energy, for the law.

    By the expressions of the law that will track it. See `fly_reference_controls`.
    """

    def columns(time: Scalar, state: EntryState) -> dict[str, Scalar]:
        return along_reference(linearization, model, state)

    return flight.sample(columns, EnergyIndex(), intervals)
