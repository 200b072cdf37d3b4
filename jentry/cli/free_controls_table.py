"""Splines of the controls in place of a law, as a configuration file has them.

    [free_controls]
    bank = "-45 deg"
    angle_of_attack = "20 deg"
    nodes = 40
    over = "energy"

is what `free_controls` is given; the numbers of the splines stand in `[set]`.
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
    index_named,
)
from ..planning.control_splines import free_controls
from ..planning.flight_problem import FlightProblem, FreeControl
from ..tuning.saving import with_unit
from .overrides import Overrides, apply_values, in_si, one_quantity, require_keys, si_of


_NAMES = {
    TimeIndex: "time",
    VelocityIndex: "velocity",
    EnergyIndex: "energy",
    AltitudeIndex: "altitude",
    DownrangeIndex: "downrange",
}


def name_of_index(index: AbstractIndex) -> str | None:
    """As in the table; None for an index that has no name there."""
    return _NAMES.get(type(index))


def table_of(problem: FlightProblem) -> dict[str, Any]:
    """The table of the splines that a problem begins with.

    Raises `ValueError` for an index of one's own, which has no name in a file.
    """
    over = name_of_index(problem.index)
    if over is None:
        raise ValueError(
            f"the controls are over a {type(problem.index).__name__}, which a file cannot "
            f"name: choose from {', '.join(_NAMES.values())}"
        )
    angle = problem.angle_of_attack
    free = (
        {} if angle is None else {"angle_of_attack": with_unit(angle.start, angle.unit)}
    )
    bank = with_unit(problem.bank.start, problem.bank.unit)
    return {"bank": bank, **free, "nodes": problem.nodes, "over": over}


def with_free_controls(scenario: Scenario, overrides: Overrides) -> Scenario:
    """The scenario with the splines that a file asks for in place of its law.

    What the file sets of the scenario counts before they are laid out.
    """
    table = overrides.free_controls
    assert table is not None
    require_keys(table, ("bank", "angle_of_attack", "nodes", "over"), "free_controls")
    if "bank" not in table:
        raise ValueError("[free_controls] lacks bank: the one to begin with")
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
    origin = scenario.target.origin or scenario.initial_state
    index = index_named(over, origin)
    return free_controls(scenario, _angle(table, "bank"), angle, nodes, index)


def _angle(table: Mapping[str, Any], key: str) -> float:
    place = f"free_controls.{key}"
    return si_of(one_quantity(table[key], place), FreeControl.unit, place)
