"""`jentry list`: missions with their laws, cases, worlds and dispersions."""

from typing import Annotated

import typer

from .options import app


@app.command("list")
def command(
    missions: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MISSION]...",
            help="Names, or your own files that define MISSION; all missions of jentry "
            "and of installed packages if not given.",
        ),
    ] = None,
) -> None:
    """List missions with their laws, cases, worlds and dispersions."""
    from ..missions import every_mission, find_mission
    from .mission_report import print_missions

    if missions:
        print_missions(map(find_mission, missions))
        return
    found = list(every_mission())
    print_missions(m for m in found if not isinstance(m, ValueError))
    for error in found:
        if isinstance(error, ValueError):
            typer.echo(f"jentry: {error}", err=True)
