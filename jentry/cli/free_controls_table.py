"""Splines of the controls in place of a law, from a configuration file.

    [free_controls]
    bank = "-45 deg"
    angle_of_attack = "20 deg"
    nodes = 40
    over = "energy"

These are the arguments of `free_controls`. The coefficients of the splines are in `[set]`.
"""

from collections.abc import Mapping
from typing import Any

from ..flight.scenario import Scenario
from ..motion.index import (
    AbstractIndex,
    AltitudeIndex,
    DownrangeIndex,
    EnergyIndex,
    TimeIndex,
    VelocityIndex,
)
from ..planning.control_splines import free_controls
from ..planning.flight_problem import FlightProblem, FreeControl
from ..tuning.saving import with_unit
from .options import index_over
from .overrides import Overrides, apply_values, in_si, one_quantity, require_keys, si_of


_NAMES = {
    TimeIndex: "time",
    VelocityIndex: "velocity",
    EnergyIndex: "energy",
    AltitudeIndex: "altitude",
    DownrangeIndex: "downrange",
}


def name_of_index(index: AbstractIndex) -> str | None:
    """Name of an index in the table; None for an index without a name."""
    return _NAMES.get(type(index))


def table_of(problem: FlightProblem) -> dict[str, Any]:
    """Table of the splines with which a problem begins.

    **Raises:** `ValueError` for a user's own index, which has no name in a file.
    """
    over = name_of_index(problem.index)
    if over is None:
        raise ValueError(
            f"the index of the controls is a {type(problem.index).__name__}, which a file "
            f"cannot name: choose from {', '.join(_NAMES.values())}"
        )
    angle = problem.angle_of_attack
    free = (
        {} if angle is None else {"angle_of_attack": with_unit(angle.start, angle.unit)}
    )
    bank = with_unit(problem.bank.start, problem.bank.unit)
    return {"bank": bank, **free, "nodes": problem.nodes, "over": over}


def with_free_controls(scenario: Scenario, overrides: Overrides) -> Scenario:
    """The scenario with the splines of a file in place of its law.

    Values that the file sets in the scenario apply before the splines are laid out.
    """
    table = overrides.free_controls
    assert table is not None
    require_keys(table, ("bank", "angle_of_attack", "nodes", "over"), "free_controls")
    if "bank" not in table:
        raise ValueError("[free_controls] lacks bank: give the bank at the start")
    nodes, over = table.get("nodes", 40), table.get("over", "energy")
    if not isinstance(nodes, int) or isinstance(nodes, bool):
        raise ValueError(
            f"free_controls.nodes is {nodes!r}: it must be a number of nodes"
        )
    if not isinstance(over, str):
        raise ValueError(f"free_controls.over is {over!r}: it must be a name")
    beside = {
        a: x for a, x in overrides.values.items() if not a.startswith("guidance.")
    }
    values = in_si(Overrides(values=beside), scenario).values
    scenario = apply_values(scenario, values)
    angle = _angle(table, "angle_of_attack") if "angle_of_attack" in table else None
    index = index_over(over, scenario)
    return free_controls(scenario, _angle(table, "bank"), angle, nodes, index)


def _angle(table: Mapping[str, Any], key: str) -> float:
    place = f"free_controls.{key}"
    return si_of(one_quantity(table[key], place), FreeControl.unit, place)
