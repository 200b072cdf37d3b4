"""`jentry list`: the missions, their variants and their dispersions."""

from .options import app


@app.command("list")
def command() -> None:
    """The missions, their variants and their dispersions."""
    from ..missions import ALL
    from .report import print_missions

    print_missions(ALL.values())
