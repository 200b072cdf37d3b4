"""The mission Space Shuttle, with and without a heating limit, and its problems."""

import dataclasses

from ...planning.flight_constraints import Constraint
from ...planning.flight_problem import AtEnd, FlightProblem, FreeControl
from ...units import degree
from ..mission import Mission
from .scenario import (
    END_ALTITUDE,
    END_PATH_ANGLE,
    START_ANGLE_OF_ATTACK,
    START_BANK,
    glide,
    limited_heating,
)


def cross_range() -> FlightProblem:
    """The largest latitude at the end, for a start eastwards along the equator."""
    return FlightProblem(
        objective=AtEnd("latitude"),
        bank=FreeControl(START_BANK, -89.0 * degree, 1.0 * degree),
        angle_of_attack=FreeControl(
            START_ANGLE_OF_ATTACK, -90.0 * degree, 90.0 * degree
        ),
        constraints={
            "altitude": Constraint(AtEnd("altitude"), equals=END_ALTITUDE),
            "flight_path_angle": Constraint(
                AtEnd("flight_path_angle"), equals=END_PATH_ANGLE
            ),
        },
        published={
            "glide": 34.1412 * degree,
            "glide case limited-heating": 30.6255 * degree,
        },
    )


def to_both_sides() -> FlightProblem:
    """The problem `cross_range` with a bank to either side, for landing footprints."""
    free = FreeControl(START_BANK, -89.0 * degree, 89.0 * degree)
    return dataclasses.replace(cross_range(), bank=free, published={})


MISSION = Mission(
    name="shuttle",
    title="Space Shuttle, the largest cross-range of its re-entry",
    source='Betts, "Practical Methods for Optimal Control and Estimation Using Nonlinear '
    'Programming"',
    laws={"glide": glide},
    cases={"limited-heating": limited_heating},
    former_variants={"limited-heating": "glide case limited-heating"},
    problems={"cross-range": cross_range, "footprint": to_both_sides},
    gains=(),
)
