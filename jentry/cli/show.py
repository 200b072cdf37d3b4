"""`jentry show`: every number of a mission, and what is dispersed of them."""

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


@app.command("show")
def command(
    mission: MissionName,
    law: Law = None,
    case: Case = None,
    world: World = None,
    dispersions: Dispersions = None,
    set_: Set = None,
    config: Config = None,
) -> None:
    """Every number of a mission, what has no effect, and what is dispersed.

    Dispersions are those that would be flown, if one reading is chosen or changed, and all
    readings of the mission if not.
    """
    set_up(workers=1)
    from .dispersions_report import print_dispersions, print_what_is_flown
    from .mission_report import print_leaves

    chosen, scenario, overrides = chosen_scenario(
        mission, (law, case, world), config, set_
    )
    print_leaves(scenario)
    if overrides.dispersions is not None:
        reading, table = dispersion_table(chosen, overrides, dispersions)
        print_what_is_flown(chosen, scenario, overrides, reading, table)
        return
    one = dispersions if dispersions is not None else overrides.reading
    for reading in chosen.dispersions if one is None else [one]:
        table = chosen.dispersion_table(reading)
        print_dispersions(f"dispersions: {reading}", scenario, table)
