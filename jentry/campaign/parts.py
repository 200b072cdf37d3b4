"""Files of a campaign's folder: a manifest and parts, each sealed with a digest.

The name of a part ends with a digest of its campaign, its runs and all of its bytes. So a
part that was damaged, renamed or copied from another campaign is found before it is read.
A part gets this name in the same step in which it appears in the folder, so an interrupted
process leaves no part without its digest.
"""

import dataclasses
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from .._files import write_whole
from .description import first_difference
from .errors import CampaignError


MANIFEST = "campaign.json"
AGAIN = "run the same campaign again, which flies what is missing"

_PART = re.compile(r"runs-(\d{9,})-(\d{9,})-([0-9a-f]{16})\.nc")
_DIGEST = "digest"
"""Name in the manifest of the digest of all other entries"""
_NAMED = 5
"""Largest number of files that a message names"""


def digest_of(description: Mapping[str, Any]) -> str:
    """Digest of a campaign. The order of its description does not change it."""
    return hashlib.sha256(json.dumps(description, sort_keys=True).encode()).hexdigest()


def name_of_part(campaign: str, first: int, last: int, contents: bytes) -> str:
    """File name of the runs from the first to the last of a campaign with this digest."""
    return f"runs-{first:09d}-{last:09d}-{_seal(campaign, first, last, contents)}.nc"


def _seal(campaign: str, first: int, last: int, contents: bytes) -> str:
    sealed = hashlib.sha256(f"{campaign} {first} {last} ".encode())
    sealed.update(contents)
    return sealed.hexdigest()[:16]


@dataclasses.dataclass(frozen=True, order=True)
class Part:
    """A stored part of a campaign, as its file name describes it."""

    first: int
    last: int
    digest: str
    path: Path

    def contents_of(self, campaign: str) -> bytes | None:
        """Bytes of the part, or None if no campaign with this digest has written them."""
        contents = _read(self.path)
        seal = _seal(campaign, self.first, self.last, contents)
        return contents if seal == self.digest else None


def parts_of(out: Path) -> list[Part]:
    """The parts in a folder, in order. Refuses a file with a similar name."""
    found, wrong = [], []
    for path in sorted(out.glob("runs-*.nc")):
        match = _PART.fullmatch(path.name)
        if match:
            found.append(Part(int(match[1]), int(match[2]), match[3], path))
        else:
            wrong.append(path)
    if wrong:
        raise not_as_written(wrong)
    return sorted(found)


def not_as_written(paths: list[Path]) -> CampaignError:
    """Error for files that are no parts of the campaign in whose folder they are."""
    named = ", ".join(map(str, paths[:_NAMED]))
    if len(paths) > _NAMED:
        named += f" and {len(paths) - _NAMED} more"
    be, them = ("is", "it") if len(paths) == 1 else ("are", "them")
    return CampaignError(
        f"{named} {be} not as this campaign has written {them}: damaged, renamed, of "
        f"another campaign or of an earlier jentry. Delete {them} and {AGAIN}"
    )


def claim(
    out: Path, description: Mapping[str, Any]
) -> tuple[dict[str, Any], list[Part]]:
    """Reserve a folder for a campaign, or check that it belongs to the campaign already.

    The folder of another campaign without runs is reused. A lost manifest is written again
    if all parts belong to this campaign.

    **Returns:** the description of the campaign and its stored parts.

    **Raises:** `CampaignError` for a folder of another campaign, and for parts that the
    campaign has not written.
    """
    manifest = out / MANIFEST
    parts = parts_of(out)
    # In the form in which the manifest is read.
    ours = json.loads(json.dumps(description))
    known = read_manifest(out) if manifest.exists() else None
    different = known and first_difference(known, ours)
    if different and parts:
        raise CampaignError(
            f"{out} holds another campaign: {different}. Give another folder, or the "
            "same options and files as before"
        )
    agreed = ours if known is None or different else known
    campaign = digest_of(agreed)
    wrong = [part.path for part in parts if part.contents_of(campaign) is None]
    if wrong and known is None and len(wrong) == len(parts):
        raise CampaignError(
            f"{out} has runs but no {MANIFEST}, and they are not of this campaign: give "
            "another folder, or the options that they were flown with"
        )
    if wrong:
        raise not_as_written(wrong)
    if agreed is ours:
        write_whole(manifest, _manifest_of(ours))
    return agreed, parts


def _manifest_of(description: Mapping[str, Any]) -> bytes:
    return json.dumps({**description, _DIGEST: digest_of(description)}).encode()


SLICES = "slices.json"
"""File beside the manifest of a slice, with the size of the whole campaign"""


class Slices(NamedTuple):
    """The division of the runs of a campaign into slices."""

    campaign: str
    """Digest of the campaign"""
    runs: int
    """Number of runs of all slices together"""
    count: int

    def runs_of(self, place: int) -> range:
        """Indices of the runs of a slice. The first slice is 1."""
        first, last = (i * self.runs // self.count for i in (place - 1, place))
        return range(first, last)


def note_slices(out: Path, slices: Slices) -> None:
    """Store the division of the campaign whose slice is in a folder."""
    write_whole(out / SLICES, (json.dumps(slices._asdict()) + "\n").encode())


def read_slices(out: Path, campaign: str) -> Slices | None:
    """The division of the campaign whose slice is in a folder, or None if none is stored.

    **Raises:** `CampaignError` for a file that is damaged or of another campaign.
    """
    path = out / SLICES
    if not path.exists():
        return None
    try:
        found = Slices(**json.loads(path.read_bytes()))
        sound = found.campaign == campaign and 0 < found.count <= found.runs
    except (ValueError, TypeError):
        sound = False
    if not sound:
        raise CampaignError(
            f"{path} is damaged or of another campaign: delete it, and fly the slice "
            "again, which writes it"
        )
    return found


def read_manifest(out: Path) -> dict[str, Any]:
    """The description of the campaign in a folder.

    **Raises:** `CampaignError` if there is none, or if it has changed since it was written.
    """
    manifest = out / MANIFEST
    if not manifest.exists():
        lost = f"; {AGAIN}, and writes that too" if parts_of(out) else ""
        raise CampaignError(
            f"{out} holds no campaign: there is no {MANIFEST} in it{lost}"
        )
    contents = _read(manifest)
    try:
        known = json.loads(contents)
        del known[_DIGEST]
        # All bytes are compared, including those between the values.
        as_written = contents == _manifest_of(known)
    except (ValueError, RecursionError, TypeError, KeyError):
        as_written, known = False, {}
    if not as_written:
        raise CampaignError(
            f"{manifest} is damaged, of an earlier jentry, or no campaign at all: give "
            "another folder; or delete it and run the same campaign again, which writes "
            "it again where the runs in the folder are of that campaign"
        )
    return known


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise CampaignError(f"{path} cannot be read: {error}") from error
