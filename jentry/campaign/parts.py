"""What stands in a campaign's folder: a manifest and parts, each sealed with a digest.

The name of a part ends in a digest of its campaign, its runs and all of its bytes. What
was damaged since, renamed, or brought from another campaign is found before anything in
the file is believed; and since the name comes with the rename that puts the part in its
place, no kill leaves the one without the other.
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
"""In the manifest, of all the rest of it"""
_NAMED = 5
"""Files that one message names"""


def digest_of(description: Mapping[str, Any]) -> str:
    """Digest of a campaign: the same for the same description, in whatever order."""
    return hashlib.sha256(json.dumps(description, sort_keys=True).encode()).hexdigest()


def name_of_part(campaign: str, first: int, last: int, contents: bytes) -> str:
    """File name of the runs from the first to the last, of a campaign of this digest."""
    return f"runs-{first:09d}-{last:09d}-{_seal(campaign, first, last, contents)}.nc"


def _seal(campaign: str, first: int, last: int, contents: bytes) -> str:
    sealed = hashlib.sha256(f"{campaign} {first} {last} ".encode())
    sealed.update(contents)
    return sealed.hexdigest()[:16]


@dataclasses.dataclass(frozen=True, order=True)
class Part:
    """A stored part of a campaign, by what its file name says."""

    first: int
    last: int
    digest: str
    path: Path

    def contents_of(self, campaign: str) -> bytes | None:
        """Bytes of the part; None unless a campaign of this digest has written them."""
        contents = _read(self.path)
        seal = _seal(campaign, self.first, self.last, contents)
        return contents if seal == self.digest else None


def parts_of(out: Path) -> list[Part]:
    """The parts in a folder, in order. Refuses a file that only looks like one."""
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
    """Sentence about files that are no parts of the campaign whose folder they are in."""
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
    """Make a folder a campaign's, or find that it is; its description and its parts.

    A folder of another campaign that has no runs yet holds nothing, and is taken over. A
    manifest that is lost is written again if all parts are of this campaign.

    **Raises:** `CampaignError` for a folder of another campaign, and for parts that are
    not as the campaign has written them.
    """
    manifest = out / MANIFEST
    parts = parts_of(out)
    # As it will be read.
    ours = json.loads(json.dumps(description))
    known = read_manifest(out) if manifest.exists() else None
    different = known and first_difference(known, ours)
    if different and parts:
        raise CampaignError(
            f"{out} holds another campaign: {different}. Give another folder, or the "
            "same options as before"
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
"""File beside the manifest of a part: the whole of which it is one"""


class Slices(NamedTuple):
    """Into how many slices the runs of a campaign are divided."""

    campaign: str
    """Digest of the campaign"""
    runs: int
    """Of all slices together"""
    count: int

    def runs_of(self, place: int) -> range:
        """Runs of the slice at a place, which is 1 for the first."""
        first, last = (i * self.runs // self.count for i in (place - 1, place))
        return range(first, last)


def note_slices(out: Path, slices: Slices) -> None:
    """Write down of which whole the runs in a folder are a part."""
    write_whole(out / SLICES, (json.dumps(slices._asdict()) + "\n").encode())


def read_slices(out: Path, campaign: str) -> Slices | None:
    """Of which whole the runs in a folder are a part; None where that is not written.

    Raises `CampaignError` for a file that is damaged, or of another campaign.
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

    **Raises:** `CampaignError` where there is none, or not as it was written.
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
        # Byte by byte: nothing may differ, be it in what is said or between.
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
