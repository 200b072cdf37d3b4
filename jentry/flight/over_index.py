"""The closed loop with another independent variable than time, such as the energy."""

import equinox as eqx

from .._integrate import runge_kutta
from .._setup import needs_float64
from ..fields import Scalar
from ..guidance.law import AbstractContinuousLaw
from ..motion.dynamics import with_respect_to
from ..motion.index import AbstractIndex
from ..motion.state import EntryState
from .closed_loop import Moving, start, vector_field
from .scenario import Scenario, checked


class IndexedEnd(eqx.Module):
    """Where a flight over an index has come to."""

    time: Scalar
    """s since the start"""
    state: EntryState
    memory: object
    """Of the law"""


@needs_float64
def fly_over(
    scenario: Scenario, index: AbstractIndex, end: Scalar | float, steps: int
) -> IndexedEnd:
    """Fly a scenario with a continuous law until an index has a value.

    The index takes the place of the time as the independent variable, in equal steps of
    the classical Runge-Kutta method: equations (10) to (15) of Bharadwaj, Rao and Mease
    for the energy. The end conditions of the scenario are not used. For comparison with
    `fly`, and for indices that rise or fall throughout: where the index stands still the
    numbers are not finite, and where it turns they are wrong.

    **Raises:** `ValueError` for a law that decides at guidance cycles.
    """
    scenario = checked(scenario)
    law = scenario.guidance
    if not isinstance(law, AbstractContinuousLaw):
        raise ValueError(
            f"{type(law).__name__} decides at guidance cycles, which are times: "
            "fly_over takes a continuous law"
        )
    lane = start(scenario, 1.0)
    field = vector_field(scenario, None)

    def flow(point: tuple[Scalar, Moving]) -> tuple[Scalar, Moving]:
        time, moving = point
        return 1.0 + 0.0 * time, field(time, moving)

    def value(point: tuple[Scalar, Moving]) -> Scalar:
        return index.value(scenario.planet, point[0], point[1].state)

    over = with_respect_to(flow, value)
    first = lane.flown, lane.moving
    time, moving = runge_kutta(lambda _, y: over(y), value(first), end, first, steps)
    return IndexedEnd(time, moving.state, moving.memory)
