"""Records what a neural law reads, also while another law flies."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..campaign.batch import over_runs
from ..campaign.campaign import fly_run
from ..fields import Scalar
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..guidance.cycle import AbstractCycle, FixedCycle
from ..guidance.law import (
    AbstractSampledLaw,
    Command,
    begun,
    commanded,
    decided,
)
from ..guidance.neural_law import NeuralLaw
from ..onboard.measurement import Measurement


class RecordedDecision(eqx.Module):
    """Decision of a recorded law, with the inputs that a neural law has at this cycle."""

    held: Any
    inputs: Float[Array, " inputs"]
    bank: Scalar
    """Commanded bank after the decision, rad"""


class RecordedLaw(AbstractSampledLaw[Any, RecordedDecision]):
    """A law that flies as it is, and holds beside its decision what a neural law reads."""

    law: AbstractSampledLaw
    reader: NeuralLaw
    """The law whose inputs are recorded. A neural law that flies records its own"""
    cycle: AbstractCycle
    """That of the law"""

    def caveats(self, held: RecordedDecision) -> dict[str, Scalar]:
        return self.law.caveats(held.held)

    def init(self, measurement: Measurement) -> tuple[Any, RecordedDecision]:
        memory, held = begun(self.law, measurement)
        zero = 0.0 * measurement.drag
        first = self.reader.first_bank + zero
        read = jnp.zeros(len(self.reader.network.names)) + zero
        return memory, RecordedDecision(held, read, first)

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: Any,
        held: RecordedDecision,
    ) -> tuple[Any, RecordedDecision]:
        if isinstance(self.law, NeuralLaw):
            read = self.law.reads(measurement, held.held.bank)
        else:
            read = self.reader.reads(measurement, held.bank)
        memory, own = decided(self.law, time, measurement, memory, held.held)
        command, _ = commanded(self.law, time, measurement, memory, own)
        return memory, RecordedDecision(own, read, command.bank_angle)

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: Any,
        held: RecordedDecision,
    ) -> tuple[Command, Any]:
        return commanded(self.law, time, measurement, memory, held.held)


class Recording(NamedTuple):
    """What a neural law reads along flights; NaN after their ends."""

    inputs: np.ndarray
    """Shape (flights, cycles, inputs)"""
    banks: np.ndarray
    """Bank that was commanded from each cycle on, rad; shape (flights, cycles)"""


def record_inputs(
    scenario: Scenario,
    reader: NeuralLaw,
    inputs: dict[str, Any],
    solver: AbstractSolver,
) -> Recording:
    """Fly runs with the sampled law of a scenario, and record what a neural law reads.

    `reader` is the neural law. If the scenario has a neural law, that one is recorded.

    **Raises:** `ValueError` for a law without a fixed guidance cycle.
    """
    law = scenario.guidance
    if not isinstance(law, AbstractSampledLaw) or not isinstance(law.cycle, FixedCycle):
        raise ValueError(
            f"the law is {type(law).__name__}: recorded is a sampled law with a FixedCycle"
        )
    cycle = law.cycle
    recorded = eqx.tree_at(
        lambda s: s.guidance, scenario, RecordedLaw(law=law, reader=reader, cycle=cycle)
    )
    inputs = {
        a.replace("guidance.", "guidance.law.", 1)
        if a.startswith("guidance.")
        else a: x
        for a, x in inputs.items()
    }
    held, time = over_runs(
        _recorded, (recorded, solver, cycle.period), inputs, large=True
    )
    flying = np.isfinite(time)
    return Recording(
        np.where(flying[..., None], held.inputs, np.nan),
        np.where(flying, held.bank, np.nan),
    )


def _recorded(shared: tuple[Any, ...], inputs: dict[str, Array]) -> Any:
    scenario, solver, period = shared
    flight, _ = fly_run(scenario, inputs, solver, period)
    assert flight.history is not None
    return flight.history.decisions, flight.history.time
