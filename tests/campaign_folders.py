"""The files of a campaign in its folder."""

from jentry.campaign.parts import MANIFEST


def parts(out):
    return sorted(path.name for path in out.glob("runs-*.nc"))


def written(path):
    """Another one whenever a file is written: which it is, and when it was."""
    return path.stat().st_ino, path.stat().st_mtime_ns


def rest(out):
    """What is in a folder besides parts and manifest."""
    return {path.name for path in out.iterdir()} - {*parts(out), MANIFEST}
