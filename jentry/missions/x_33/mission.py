"""The mission X-33: its laws, and with each the cases of the paper."""

import functools
from collections.abc import Callable

from ...flight.scenario import Scenario
from ..mission import Mission
from .cases import CASES, case
from .dispersions import air_and_vehicle, everything, initial_errors
from .scenario import (
    exact_inverse,
    open_loop,
    receding,
    receding_with_range,
    tracking,
    with_range,
)


_LAWS = {
    "tracking": tracking,
    "with-range": with_range,
    "receding": receding,
    "receding-with-range": receding_with_range,
    "exact-inverse": exact_inverse,
    "open-loop": open_loop,
}


def _started(build: Callable[[], Scenario], number: int) -> Scenario:
    return case(build(), number)


MISSION = Mission(
    name="x-33",
    title="X-33, drag planned in the corridor, tracked by Legendre pseudospectral "
    "regulation",
    source='Lee, Cho and Yan, "Re-Entry Trajectory Tracking Via an Inverse Dynamics '
    'Method"',
    variants={
        **_LAWS,
        **{
            f"{name}-case-{number}": functools.partial(_started, _LAWS[name], number)
            for name in ("open-loop", "tracking", "with-range")
            for number in range(1, len(CASES) + 1)
        },
    },
    dispersions={
        "initial-errors": initial_errors,
        "air-and-vehicle": air_and_vehicle,
        "everything": everything,
    },
    gains=(
        "guidance.bank.regulator.underway",
        "guidance.bank.regulator.at_end",
        "guidance.bank.regulator.control",
    ),
)
