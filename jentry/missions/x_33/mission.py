"""The mission X-33: its laws, and with each the cases of the paper."""

import dataclasses
import functools
from collections.abc import Callable

from ...flight.scenario import Scenario
from ...planning.flight_constraints import Constraint
from ...planning.flight_problem import AtEnd, FlightProblem, FreeControl
from ...units import degree
from ..mission import Mission
from . import crossings, predictor_corrector
from .cases import CASES, case
from .dispersions import air_and_vehicle, everything, initial_errors
from .scenario import (
    GLIDE_BANK,
    exact_inverse,
    glide,
    glide_in_space,
    open_loop,
    receding,
    receding_with_range,
    reference,
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


def _range(largest: bool) -> FlightProblem:
    """The range within the corridor, with the end of the reference."""
    end = reference().end
    return FlightProblem(
        objective=AtEnd("downrange"),
        largest=largest,
        bank=FreeControl(GLIDE_BANK, 0.0, 120.0 * degree),
        constraints={
            "altitude": Constraint(AtEnd("altitude"), equals=float(end.altitude)),
            "flight_path_angle": Constraint(
                AtEnd("flight_path_angle"), equals=float(end.flight_path_angle)
            ),
        },
        history=2.5,
    )


def longest() -> FlightProblem:
    """The largest range within the corridor, to the altitude and path angle of the end."""
    return _range(largest=True)


def shortest() -> FlightProblem:
    """The smallest range within the corridor, likewise."""
    return _range(largest=False)


def to_both_sides() -> FlightProblem:
    """The same with the bank to either side: what the landing footprint is found with."""
    free = FreeControl(GLIDE_BANK, -120.0 * degree, 120.0 * degree)
    return dataclasses.replace(longest(), bank=free, history=5.0)


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
        "glide": glide,
        "glide-3d": glide_in_space,
        "predictor-corrector": predictor_corrector.in_plane,
        "predictor-corrector-limited": predictor_corrector.limited,
        "predictor-corrector-3d": predictor_corrector.in_space,
        "state-drag-tracking": crossings.state_drag_tracking,
        "observer-drag-tracking": crossings.observer_drag_tracking,
        "modulation": crossings.modulation,
        "shuttle": crossings.shuttle,
        "feedback-linearization": crossings.feedback_linearization,
    },
    problems={"longest": longest, "shortest": shortest, "footprint": to_both_sides},
    dispersions={
        "initial-errors": initial_errors,
        "air-and-vehicle": air_and_vehicle,
        "everything": everything,
    },
    gains=(
        "guidance.bank.regulator.underway",
        "guidance.bank.regulator.at_end",
        "guidance.bank.regulator.control",
        "guidance.bank.gains",
        "guidance.bank.observer",
        "guidance.angle_of_attack.gains",
        "guidance.gains",
    ),
)
