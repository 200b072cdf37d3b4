"""`jentry show`: every number of a mission, and its dispersions."""

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    Case,
    Config,
    Dispersions,
    Law,
    MissionName,
    Set,
    World,
    app,
    chosen_scenario,
    dispersion_table,
    set_up,
)


File = Annotated[
    Path | None,
    typer.Option(
        dir_okay=False,
        help="TOML file for planet, vehicle, entry, target, limits and all dispersions of "
        "the mission, with units, for programs without jentry.",
    ),
]


@app.command("show")
def command(
    mission: MissionName,
    law: Law = None,
    case: Case = None,
    world: World = None,
    dispersions: Dispersions = None,
    set_: Set = None,
    config: Config = None,
    file: File = None,
) -> None:
    """Show every number of a mission, those without effect, and the dispersions.

    If some dispersions are chosen or changed, those that would be flown are shown;
    otherwise all dispersions of the mission.
    """
    set_up(workers=1)
    from ..missions.data_file import write_mission_data
    from .dispersions_report import print_dispersions, print_what_is_flown
    from .mission_report import print_leaves

    chosen, scenario, overrides = chosen_scenario(
        mission, (law, case, world), config, set_
    )
    print_leaves(scenario)
    if file is not None:
        write_mission_data(file, chosen, overrides.choice, scenario)
    if overrides.dispersions is not None:
        base, table = dispersion_table(chosen, overrides, dispersions)
        print_what_is_flown(chosen, scenario, overrides, base, table)
        return
    one = dispersions if dispersions is not None else overrides.base
    for base in chosen.dispersions if one is None else [one]:
        table = chosen.dispersion_table(base)
        print_dispersions(f"dispersions: {base}", scenario, table)
