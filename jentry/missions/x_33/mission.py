"""The mission X-33: its laws, and the cases of the paper."""

import dataclasses

from ...flight.scenario import Scenario
from ...guidance.predictor_corrector import PredictorCorrector
from ...motion.dynamics import EntryDynamics
from ...planning.flight_constraints import Constraint
from ...planning.flight_problem import AtEnd, FlightProblem, FreeControl
from ...units import degree
from ..mission import Change, Mission
from . import crossings, predictor_corrector
from .cases import CASES, case
from .dispersions import air_and_vehicle, everything, initial_errors
from .scenario import (
    GLIDE_BANK,
    exact_inverse,
    glide,
    open_loop,
    receding,
    receding_with_range,
    reference,
    tracking,
    with_range,
)


def _range(largest: bool) -> FlightProblem:
    """Problem of the largest or smallest range within the corridor, with a fixed end."""
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
    """The largest range within the corridor, to a fixed altitude and flight-path angle."""
    return _range(largest=True)


def shortest() -> FlightProblem:
    """The smallest range within the corridor, to a fixed altitude and flight-path angle."""
    return _range(largest=False)


def to_both_sides() -> FlightProblem:
    """The problem `longest` with a bank to either side, for landing footprints."""
    free = FreeControl(GLIDE_BANK, -120.0 * degree, 120.0 * degree)
    return dataclasses.replace(longest(), bank=free, history=5.0)


def _case(number: int) -> Change:
    def change(scenario: Scenario) -> Scenario:
        return case(scenario, number)

    errors = CASES[number - 1]
    change.__doc__ = (
        f"Starts {errors.altitude:+g} m, {errors.velocity:+g} m/s and "
        f"{errors.flight_path_angle / degree:+.1f} deg of flight-path angle off the "
        "reference."
    )
    return change


def three_dimensional(scenario: Scenario) -> Scenario:
    """Motion in three dimensions, in which a bank turns the heading."""
    free = dataclasses.replace(scenario, dynamics=EntryDynamics())
    if not isinstance(free.guidance, PredictorCorrector):
        return free
    return predictor_corrector.in_space(free)


MISSION = Mission(
    name="x-33",
    title="X-33, drag planned in the corridor, tracked by Legendre pseudospectral "
    "regulation",
    source='Lee, Cho and Yan, "Re-Entry Trajectory Tracking Via an Inverse Dynamics '
    'Method"',
    laws={
        "tracking": tracking,
        "with-range": with_range,
        "receding": receding,
        "receding-with-range": receding_with_range,
        "exact-inverse": exact_inverse,
        "open-loop": open_loop,
        "glide": glide,
        "predictor-corrector": predictor_corrector.guided,
        "predictor-corrector-limited": predictor_corrector.limited,
        "state-drag-tracking": crossings.state_drag_tracking,
        "observer-drag-tracking": crossings.observer_drag_tracking,
        "modulation": crossings.modulation,
        "shuttle": crossings.shuttle,
        "feedback-linearization": crossings.feedback_linearization,
    },
    cases={f"{number}": _case(number) for number in range(1, len(CASES) + 1)},
    worlds={"three-dimensional": three_dimensional},
    former_variants={
        **{
            f"{law}-case-{number}": f"{law} case {number}"
            for law in ("open-loop", "tracking", "with-range")
            for number in range(1, len(CASES) + 1)
        },
        "glide-3d": "glide world three-dimensional",
        "predictor-corrector-3d": "predictor-corrector world three-dimensional",
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
