"""`jentry merge`: put together the slices of a campaign that several machines flew."""

from pathlib import Path
from typing import Annotated

import typer

from .options import app, set_up


@app.command("merge")
def command(
    out: Annotated[Path, typer.Argument(help="Folder for the whole campaign.")],
    folders: Annotated[
        list[Path],
        typer.Argument(help="Folders of its slices, flown by monte-carlo --slice."),
    ],
) -> None:
    """Put the slices of a campaign together, for `jentry report`."""
    set_up(workers=1)
    from ..campaign.merging import merge_campaigns, slices_lacking
    from ..campaign.parts import digest_of, read_manifest
    from .campaign_files import decided_by, note_until_decided

    runs, lacking = merge_campaigns(out, folders)
    digest = digest_of(read_manifest(out))
    # Requirements that decided the number of runs of a slice decided that of the whole.
    decided = [decided_by(folder, digest) for folder in folders]
    if any(each is not None for each in decided):
        every = dict.fromkeys(r for each in decided for r in each or ())
        note_until_decided(out, list(every), digest)
    typer.echo(f"stored: {out}, {runs} of {runs + lacking} runs")
    if lacking:
        slices = slices_lacking(out)
        which = f", of slices {', '.join(slices)}" if slices else ""
        typer.echo(
            f"{lacking} runs are not there yet{which}: merge the folders that have them"
        )
