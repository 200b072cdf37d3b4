"""Options of `jentry optimize`: the objective, the constraints and the free controls."""

import dataclasses
from collections.abc import Iterable
from typing import Any

from ..addresses import nearest
from ..flight.scenario import Scenario
from ..missions.mission import Mission
from ..planning.flight_constraints import Constraint
from ..planning.flight_problem import (
    END_QUANTITIES,
    AtEnd,
    FlightProblem,
    FreeControl,
    Peak,
)
from ..units import parse_quantity
from .options import index_over


def problem_asked(
    mission: Mission,
    name: str | None,
    scenario: Scenario,
    *,
    maximize: str | None,
    minimize: str | None,
    end: Iterable[str],
    keeps_limits: bool,
    bank: str | None,
    angle_of_attack: str | None,
    nodes: int | None,
    over: str | None,
    history: float | None,
) -> FlightProblem:
    """Problem of a mission with the changes of the options, or of the options alone.

    **Raises:** `ValueError` for a name that is not known and for an option that is given
    twice. Also for a mission without problems if the options do not give the objective
    and the bank.
    """
    if maximize is not None and minimize is not None:
        raise ValueError("give --maximize or --minimize, not both")
    wanted = maximize if minimize is None else minimize
    changes: dict[str, Any] = {"keeps_limits": keeps_limits}
    if wanted is not None:
        changes["objective"] = _quantity(wanted, scenario)
        changes |= {"largest": minimize is None, "published": {}}
    ends = _constraints(end)
    if ends:
        changes |= {"constraints": ends, "published": {}}
    for key, given in (("bank", bank), ("angle_of_attack", angle_of_attack)):
        if given is not None:
            changes[key] = _control(f"--{key.replace('_', '-')}", given)
    if history is not None and not 0.0 < history < float("inf"):
        raise ValueError(f"--every is {history} s: it must be positive and finite")
    index = None if over is None else index_over(over, scenario)
    beside = {"nodes": nodes, "index": index, "history": history}
    changes |= {key: given for key, given in beside.items() if given is not None}
    if name is not None or mission.problems:
        return dataclasses.replace(mission.problem(name), **changes)
    if "objective" not in changes or "bank" not in changes:
        raise ValueError(
            f"mission {mission.name} has no problem: give the objective, such as "
            "--maximize downrange, and the range of the bank, such as "
            "--bank -60deg:-90deg:90deg"
        )
    return FlightProblem(**changes)


def _quantity(name: str, scenario: Scenario) -> AtEnd | Peak:
    if name in END_QUANTITIES:
        return AtEnd(name)
    if name in scenario.constraints:
        return Peak(name)
    known = [*END_QUANTITIES, *scenario.constraints]
    raise ValueError(
        f"no quantity {name!r} at the end, and no path constraint; {nearest(name, known)}"
    )


def _constraints(options: Iterable[str]) -> dict[str, Constraint]:
    found = {}
    for option in options:
        name, equals, value = option.partition("=")
        if not equals:
            raise ValueError(
                f"--end {option}: write QUANTITY=VALUE or QUANTITY=LOW:HIGH"
            )
        if name not in END_QUANTITIES:
            raise ValueError(
                f"--end {option}: no quantity {name!r} at the end; "
                f"{nearest(name, END_QUANTITIES)}"
            )
        if name in found:
            raise ValueError(f"--end {name} is given twice: give it once")
        quantity = AtEnd(name)
        low, colon, high = value.partition(":")
        try:
            numbers = [
                parse_quantity(x, quantity.unit)
                for x in ([low, high] if colon else [low])
            ]
            scale = None if any(numbers) else quantity.much
            if colon:
                limits = {"at_least": numbers[0], "at_most": numbers[1]}
            else:
                limits = {"equals": numbers[0]}
            found[name] = Constraint(quantity, **limits, scale=scale)
        except ValueError as error:
            raise ValueError(f"--end {option}: {error}") from None
    return found


def _control(option: str, given: str) -> FreeControl:
    parts = given.split(":")
    if len(parts) != 3:
        raise ValueError(
            f"{option} {given}: write its start, its least and its largest value, "
            "20deg:0deg:40deg"
        )
    try:
        return FreeControl(*(parse_quantity(part, FreeControl.unit) for part in parts))
    except ValueError as error:
        raise ValueError(f"{option} {given}: {error}") from None
