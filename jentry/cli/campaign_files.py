"""Files beside the runs of a campaign: summary, page, figures, acceptance."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._files import write_whole
from ..campaign.errors import CampaignError
from ..flight.scenario import Scenario
from ..missions.mission import Mission
from ..plots.campaign import FORMATS
from ..statistics.acceptance import Requirement
from ..statistics.summary import Summary
from .figures import FIGURES, draw_figures
from .html_page import page_of


if TYPE_CHECKING:
    import xarray


_DIGEST = "campaign_digest"

JSON, CSV, PAGE = "summary.json", "summary.csv", "report.html"

ACCEPTANCE = "until-decided.json"
"""File of a campaign whose runs were added until requirements were decided"""


def write_summary(folder: Path, summary: Summary) -> None:
    """Write `summary.json` and `summary.csv`."""
    write_whole(folder / JSON, summary.as_json().encode())
    write_whole(folder / CSV, summary.as_csv().encode())


def write_page(
    folder: Path, title: str, summary: Summary, drawn: Sequence[Path]
) -> Path:
    """Write `report.html` with those of the drawn figures that are png files."""
    images = sorted(path for path in drawn if path.suffix == ".png")
    figures = {path.stem: path.read_bytes() for path in images}
    write_whole(folder / PAGE, page_of(title, summary, figures).encode())
    return folder / PAGE


def write_figures(
    folder: Path,
    mission: Mission,
    scenario: Scenario,
    results: "xarray.Dataset",
    flown: "xarray.Dataset | None",
    formats: Sequence[str],
) -> list[Path]:
    """Draw the figures, and remove older figures that are not among them."""
    # Always as png too: the page contains png figures.
    kinds = dict.fromkeys((*formats, "png"))
    paths = draw_figures(folder, mission, scenario, results, flown, list(kinds))
    for kind in FORMATS:
        for old in (folder / FIGURES).glob(f"*.{kind}"):
            if old not in paths:
                old.unlink()
    return paths


def note_until_decided(
    folder: Path, requirements: Sequence[Requirement], campaign: str
) -> None:
    """Store the requirements that decided how many runs a campaign has.

    The file has the digest of the campaign, since it holds for no other.
    """
    contents = {
        "requirements": [requirement.text for requirement in requirements],
        _DIGEST: campaign,
    }
    write_whole(folder / ACCEPTANCE, (json.dumps(contents, indent=2) + "\n").encode())


def decided_by(folder: Path, campaign: str) -> list[Requirement] | None:
    """Requirements that decided how many runs a campaign has; None if there are none.

    `campaign` is its digest.

    **Raises:** `CampaignError` for a file that cannot be read.
    """
    path = folder / ACCEPTANCE
    if not path.exists():
        return None
    try:
        contents: Any = json.loads(path.read_text(encoding="utf-8"))
        requirements = [Requirement.of(text) for text in contents["requirements"]]
        return requirements if contents[_DIGEST] == campaign else None
    except (ValueError, TypeError, KeyError) as error:
        raise CampaignError(
            f"{path} is not as it was written ({error}): run the campaign again with "
            "--until-decided, which writes it again"
        ) from None
