"""Merging of the slices of one campaign that several machines have flown."""

from collections.abc import Sequence
from pathlib import Path

from .._files import write_whole
from .description import first_difference
from .errors import CampaignError
from .parts import (
    claim,
    digest_of,
    not_as_written,
    note_slices,
    parts_of,
    read_manifest,
    read_slices,
)
from .store import alone_in


def merge_campaigns(out: Path | str, folders: Sequence[Path | str]) -> tuple[int, int]:
    """Copy the runs of several folders of one campaign into one folder.

    Files are verified to the last bit before they are copied. The originals stay. A second
    call copies the runs that are missing.

    **Arguments:**

    - `out`: folder, created if needed. It may already hold runs of the campaign.
    - `folders`: folders of `run_campaign(..., part=...)`, from any machines.

    **Returns:** the number of runs in `out`, and the number of missing runs. These are
    counted in the whole campaign if a folder states its size, else up to the last run in
    `out`.

    **Raises:** `CampaignError` for folders of different campaigns, with the first
    difference, and for damaged parts; `ValueError` without any folder.

        merge_campaigns("results/all", ["results/part-1", "results/part-2"])
    """
    if not folders:
        raise ValueError("there is nothing to merge: give the folders of the parts")
    sources = [Path(folder) for folder in folders]
    descriptions = [read_manifest(source) for source in sources]
    for source, description in zip(sources, descriptions, strict=True):
        different = first_difference(descriptions[0], description)
        if different:
            raise CampaignError(
                f"{source} is of another campaign than {sources[0]}: {different}"
            )
    campaign = digest_of(descriptions[0])
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    with alone_in(out):
        claim(out, descriptions[0])
        for source in sources:
            for part in parts_of(source):
                contents = part.contents_of(campaign)
                if contents is None:
                    raise not_as_written([part.path])
                if not (out / part.path.name).exists():
                    write_whole(out / part.path.name, contents)
        # The largest size counts: a campaign may have been extended.
        noted = [read_slices(folder, campaign) for folder in (out, *sources)]
        known = [slices for slices in noted if slices is not None]
        if known:
            note_slices(out, max(known, key=lambda slices: slices.runs))
    runs = _runs_in(out)
    total = max([max(runs, default=-1) + 1, *(slices.runs for slices in known)])
    return len(runs), total - len(runs)


def slices_lacking(out: Path | str) -> list[str]:
    """Slices of a merged campaign with missing runs, in the form of the option `--slice`.

    The list is empty if no run is missing, or if no folder stated the size of the campaign.
    """
    out = Path(out)
    slices = read_slices(out, digest_of(read_manifest(out)))
    if slices is None:
        return []
    runs = _runs_in(out)
    return [
        f"{place}/{slices.count}"
        for place in range(1, slices.count + 1)
        if not runs.issuperset(slices.runs_of(place))
    ]


def _runs_in(out: Path) -> set[int]:
    found: set[int] = set()
    for part in parts_of(out):
        found.update(range(part.first, part.last + 1))
    return found
