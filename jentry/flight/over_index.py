"""The closed loop with an independent variable other than time, such as the energy."""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._integrate import runge_kutta
from .._setup import needs_float64
from ..fields import Scalar
from ..guidance.law import AbstractContinuousLaw
from ..motion.dynamics import with_respect_to
from ..motion.index import AbstractIndex
from ..motion.state import EntryState
from .closed_loop import start, vector_field
from .lane import Moving
from .scenario import Scenario
from .scenario_checks import checked


class IndexedEnd(eqx.Module):
    """End of a flight over an index."""

    time: Scalar
    """Time since the start, s"""
    state: EntryState
    memory: object
    """Memory of the law"""


@needs_float64
def fly_over(
    scenario: Scenario, index: AbstractIndex, end: Scalar | float, steps: int
) -> IndexedEnd:
    """Fly a scenario with a continuous law until an index has a value.

    The index replaces time as the independent variable, in equal steps of the classical
    Runge-Kutta method. For the energy these are equations (10) to (15) of Bharadwaj, Rao
    and Mease. The end conditions of the scenario are not used. The function serves
    comparison with `fly`. The index must rise or fall throughout: if at a stage of any step
    it is stationary or moves away from its end value, the numbers are NaN.

    **Raises:** `ValueError` for a law that decides at guidance cycles, for a navigation
    that is updated in cycles, and for a number of steps that is not positive.
    """
    if steps < 1:
        raise ValueError(f"steps is {steps}: it must be 1 or more")
    scenario = checked(scenario)
    law = scenario.law
    if not isinstance(law, AbstractContinuousLaw):
        raise ValueError(
            f"{type(law).__name__} decides at guidance cycles, which are times: "
            "fly_over takes a continuous law"
        )
    if scenario.navigation.cycle is not None:
        raise ValueError(
            f"the navigation is updated every {scenario.navigation.cycle} s, by its noise "
            "or its filter: fly_over takes one without both"
        )
    lane = start(scenario, 1.0)
    field = vector_field(scenario, None)

    def flow(point: tuple[Scalar, Moving]) -> tuple[Scalar, Moving]:
        time, moving = point
        return 1.0 + 0.0 * time, field(time, moving)

    def value(point: tuple[Scalar, Moving]) -> Scalar:
        return index.value(scenario.planet, point[0], point[1].state)

    over = with_respect_to(flow, value)
    begin = lane.flown, lane.moving
    first = value(begin)

    def slope(_: Scalar, point: tuple[Scalar, Moving]) -> tuple[Scalar, Moving]:
        rates = over(point)
        forwards = rates[0] * (end - first) > 0.0
        return jax.tree.map(lambda x: jnp.where(forwards, x, jnp.nan), rates)

    def renewed(point: tuple[Scalar, Moving]) -> tuple[Scalar, Moving]:
        return point[0], point[1].renewed()

    time, moving = runge_kutta(slope, first, end, begin, steps, renewed)
    return IndexedEnd(time, moving.state, moving.memory)
