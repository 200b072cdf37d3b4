"""Mission, scenario and solver of a stored campaign, as objects."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..addresses import leaves_by_address, replace_leaves
from ..campaign.description import describe, first_difference, leaf_of
from ..campaign.errors import CampaignError
from ..flight.scenario import Scenario
from ..flight.solver import FixedStep
from . import find_mission
from .choice import Choice
from .mission import Mission


_FIXED_STEP = re.compile(r"FixedStep\((?:step=(?P<step>[^,()]+))?\)")
_ANOTHER = "another version of jentry flew it, or more than numbers changed"


def stored_mission(
    description: Mapping[str, Any], file: str | Path | None = None
) -> Mission:
    """The mission of a stored campaign.

    **Arguments:**

    - `description`: description of the campaign, from `read_manifest`.
    - `file`: file of your own mission; the description has its name, but not its path.

    **Raises:** `CampaignError` if the campaign has no mission, if its mission is not that
    of the file, or if the file has changed since; `ValueError` as `find_mission`.
    """
    name = description.get("mission")
    if name is None:
        raise CampaignError("the campaign was flown in Python, and names no mission")
    if file is None and description.get("code"):
        try:
            mission = find_mission(name)
        except ValueError:
            raise CampaignError(
                f"the campaign is of {name}, a mission of your own: give its file, "
                "--mission FILE.py"
            ) from None
    else:
        mission = find_mission(name if file is None else file)
    if mission.name != name:
        raise CampaignError(f"the campaign is of {name}, and {file} is {mission.name}")
    if dict(mission.code) != description.get("code", {}):
        changed = first_difference(description.get("code", {}), dict(mission.code))
        raise CampaignError(
            f"the files of {name} are not those that the campaign was flown with: "
            f"{changed}"
        )
    return mission


def stored_scenario(description: Mapping[str, Any], mission: Mission) -> Scenario:
    """The nominal scenario of a campaign, with every number to the last bit.

    **Raises:** `CampaignError` if the mission does not have the scenario of the campaign,
    or has it with another structure.
    """
    choice = stored_choice(description, mission)
    try:
        scenario = mission.scenario_of(choice)
    except ValueError as error:
        raise CampaignError(
            f"the campaign is of {choice}, which {mission.name} does not have, {error}: "
            f"{_ANOTHER}"
        ) from None
    stored = {a: leaf["value"] for a, leaf in description["scenario"].items()}
    ours = {address: None for address in leaves_by_address(scenario)}
    missing = first_difference(dict.fromkeys(stored), ours)
    if missing is not None:
        raise CampaignError(f"the scenario cannot be made again, {missing}: {_ANOTHER}")
    try:
        scenario = replace_leaves(scenario, {a: leaf_of(x) for a, x in stored.items()})
    except ValueError as error:
        raise CampaignError(f"the scenario cannot be made again: {error}") from None
    again = _described(scenario)
    for part in ("structure", "scenario"):
        difference = first_difference(description[part], again[part], part)
        if difference is not None:
            raise CampaignError(
                f"the scenario cannot be made again, {difference}: {_ANOTHER}"
            )
    return scenario


def stored_choice(description: Mapping[str, Any], mission: Mission) -> Choice:
    """Law, case and worlds of a campaign, also of one with a variant of earlier versions of
    jentry."""
    former = description.get("variant")
    if former is not None:
        return Choice.of(mission.former_variants.get(former, former))
    axes = (description.get(axis) for axis in ("law", "case", "world"))
    return Choice.given(*axes)


def stored_solver(description: Mapping[str, Any]) -> FixedStep:
    """The solver of a campaign that was flown from the command line.

    Raises `CampaignError` for a solver other than `FixedStep` with its default method.
    """
    found = _FIXED_STEP.fullmatch(description["solver"])
    if found is None:
        raise CampaignError(
            f"the campaign was flown with {description['solver']}, which cannot be made "
            "again from its name: fly it in Python"
        )
    return FixedStep(None if found["step"] is None else float(found["step"]))


def is_as_published(description: Mapping[str, Any], mission: Mission) -> bool:
    """Whether the published values of the mission apply to a campaign.

    They do for the published law with all of its numbers and the published dispersions.
    The step of the solver may differ.
    """
    if (
        not mission.published
        or description["inputs"]
        or "sampler" in description
        or stored_choice(description, mission) != Choice(mission.published_law)
    ):
        return False
    table = mission.dispersion_table(mission.published_dispersions)
    ours = describe(
        mission.scenario(mission.published_law), table, 0, FixedStep(), None
    )
    parts = "structure", "scenario", "dispersions"
    return all(
        first_difference(description[part], _as_read(ours[part])) is None
        for part in parts
    )


def _described(scenario: Scenario) -> dict[str, Any]:
    return _as_read(describe(scenario, None, 0, FixedStep(), None))


def _as_read(described: Any) -> Any:
    """Plain values as they are read from a file: tuples become lists."""
    return json.loads(json.dumps(described))
