"""`jentry show`: every number of a mission."""

from .options import Config, MissionName, Set, Variant, app, chosen_scenario, set_up


@app.command("show")
def command(
    mission: MissionName,
    variant: Variant = None,
    set_: Set = None,
    config: Config = None,
) -> None:
    """Every number of a mission: address, value and unit."""
    set_up(workers=1)
    from .report import print_leaves

    print_leaves(chosen_scenario(mission, variant, config, set_)[1])
