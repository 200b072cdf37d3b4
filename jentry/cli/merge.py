"""`jentry merge`: parts of a campaign that several machines have flown, put together."""

from pathlib import Path
from typing import Annotated

import typer

from .options import app, set_up


@app.command("merge")
def command(
    out: Annotated[Path, typer.Argument(help="Folder for the whole campaign.")],
    folders: Annotated[
        list[Path], typer.Argument(help="Folders of its parts, monte-carlo --slice.")
    ],
) -> None:
    """Put the parts of a campaign together; `jentry report` says what they say."""
    set_up(workers=1)
    from ..campaign.merging import merge_campaigns

    runs = merge_campaigns(out, folders)
    typer.echo(f"stored: {out}, {runs} runs")
