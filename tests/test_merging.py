"""Parts of a campaign on several machines: the same numbers, and nothing else taken in."""

import json
import os
import signal
import subprocess
import sys
import time

import cheap
import numpy as np
import pytest
import xarray
from commands import assert_refused, monte_carlo

from jentry.campaign import CampaignError, merge_campaigns, open_campaign
from jentry.campaign.merging import slices_lacking
from jentry.campaign.store import runs_of_part


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "whole"
    cheap.campaign(out, 11)
    return open_campaign(out)


def parts(folder, count=3, runs=11, **options):
    found = []
    for place in range(1, count + 1):
        found.append(folder / f"part-{place}")
        cheap.campaign(found[-1], runs, part=(place, count), **options)
    return found


def test_every_run_is_in_one_part():
    for runs, count in ((10, 3), (7, 7), (1000, 13), (1, 1)):
        all_of_them = [runs_of_part(runs, (i, count)) for i in range(1, count + 1)]
        np.testing.assert_array_equal(np.concatenate(all_of_them), np.arange(runs))
        sizes = [len(each) for each in all_of_them]
        assert max(sizes) - min(sizes) <= 1
    np.testing.assert_array_equal(runs_of_part(4, None), np.arange(4))


@pytest.mark.parametrize(
    "part, message",
    [((0, 3), "from 1 to 3"), ((4, 3), "from 1 to 3"), ((1, 12), "have no 12 parts")],
)
def test_parts_that_there_are_not(tmp_path, part, message):
    with pytest.raises(ValueError, match=message):
        cheap.campaign(tmp_path / "out", 11, part=part)
    assert not (tmp_path / "out").exists()


def test_merged_parts_are_the_campaign(tmp_path, whole):
    """In any order, and again; in each folder lie the runs of the part alone."""
    folders = parts(tmp_path)
    with pytest.raises(CampaignError, match="lacks some of its runs"):
        open_campaign(folders[1])
    told = []
    cheap.campaign(folders[0], 11, part=(1, 3), report=told.append)
    assert told == [3]
    out = tmp_path / "merged"
    assert merge_campaigns(out, [folders[2], folders[0]]) == (4 + 3, 4)
    with pytest.raises(CampaignError, match="lacks some of its runs"):
        open_campaign(out)
    assert merge_campaigns(out, [str(folder) for folder in reversed(folders)]) == (
        11,
        0,
    )
    xarray.testing.assert_identical(open_campaign(out), whole)
    names = sorted(path.name for path in out.glob("runs-*"))
    assert names == sorted(p.name for f in folders for p in f.glob("runs-*"))
    # The same campaign goes on there.
    cheap.campaign(out, 12)
    assert open_campaign(out).sizes["run"] == 12


def test_another_campaign_is_refused(tmp_path):
    cheap.campaign(tmp_path / "one", 4, part=(1, 2))
    cheap.campaign(tmp_path / "other", 4, seed=8, part=(2, 2))
    with pytest.raises(
        CampaignError, match="other is of another .*seed is 7 there and 8"
    ):
        merge_campaigns(tmp_path / "out", [tmp_path / "one", tmp_path / "other"])
    assert not (tmp_path / "out").exists()
    with pytest.raises(CampaignError, match="holds another campaign"):
        merge_campaigns(tmp_path / "other", [tmp_path / "one"])
    with pytest.raises(CampaignError, match="holds no campaign"):
        merge_campaigns(tmp_path / "out", [tmp_path / "nowhere"])
    with pytest.raises(ValueError, match="nothing to merge"):
        merge_campaigns(tmp_path / "out", [])


def test_a_damaged_part_is_not_taken_in(tmp_path):
    one, other = parts(tmp_path, 2, 4)
    (path,) = other.glob("runs-*")
    contents = bytearray(path.read_bytes())
    contents[len(contents) // 2] ^= 1
    path.write_bytes(bytes(contents))
    with pytest.raises(CampaignError, match="not as this campaign has written"):
        merge_campaigns(tmp_path / "out", [one, other])
    assert merge_campaigns(tmp_path / "out", [one]) == (2, 2)


def test_slices_by_the_command(command, tmp_path):
    folders = []
    for place in (1, 2):
        folder = tmp_path / f"part-{place}"
        words = ("--runs", 5, "--seed", 7, "--slice", f"{place}/2", "--out", folder)
        code, printed, said = monte_carlo(command, *words)
        first, last = ((0, 1), (2, 4))[place - 1]
        assert (code, said) == (0, "") and f"runs {first} to {last} of 5" in printed
        assert not (folder / "summary.json").exists()
        folders.append(folder)
    code, printed, _ = command("merge", tmp_path / "all", *folders)
    assert code == 0 and printed == f"stored: {tmp_path / 'all'}, 5 of 5 runs\n"
    words = ("--runs", 5, "--seed", 7, "--out", tmp_path / "same")
    monte_carlo(command, *words)
    same = open_campaign(tmp_path / "same")
    xarray.testing.assert_identical(open_campaign(tmp_path / "all"), same)
    code, printed, _ = command("report", tmp_path / "all", "--no-figures")
    assert code == 0 and "5 of 5 runs" in printed


def test_a_merged_half_says_which_slices_lack(command, tmp_path):
    """The last slice too, of which nothing that is there could tell."""
    parts(tmp_path, 3, 11)
    names = sorted(path for path in tmp_path.iterdir() if path.is_dir())
    first = names[0]
    assert merge_campaigns(tmp_path / "all", [first]) == (3, 8)
    assert slices_lacking(tmp_path / "all") == ["2/3", "3/3"]
    code, printed, _ = command("merge", tmp_path / "all", names[1])
    assert code == 0 and "stored: " in printed and "7 of 11 runs" in printed
    assert "4 runs are not there yet, of slices 3/3" in printed
    assert merge_campaigns(tmp_path / "all", names[2:3]) == (11, 0)
    assert slices_lacking(tmp_path / "all") == []


def test_a_note_of_slices_that_lies_is_refused(tmp_path):
    one, _ = parts(tmp_path, 2, 4)
    note = one / "slices.json"
    told = json.loads(note.read_text())
    assert (told["runs"], told["count"]) == (4, 2)
    for wrong in ({**told, "campaign": "0"}, {**told, "count": 0}, [1]):
        note.write_text(json.dumps(wrong))
        with pytest.raises(CampaignError, match="slices.json is damaged"):
            merge_campaigns(tmp_path / "out", [one])


@pytest.mark.parametrize(
    "words, message",
    [
        (("--slice", "3"), "such as 3/10"),
        (("--slice", "4/3"), "such as 3/10"),
        (("--slice", "a/3"), "such as 3/10"),
        (("--slice", "1/6"), "have no 6 parts"),
        (("--slice", "1/2", "--json"), "flies a share of the runs without a summary"),
    ],
)
def test_slices_that_there_are_not(command, words, message):
    assert_refused(monte_carlo(command, "--runs", 5, *words), message)


_PART = """
import sys
import jentry
jentry.setup(1)
import cheap
cheap.campaign(sys.argv[1], {runs}, part=(int(sys.argv[2]), 2))
"""


@pytest.mark.slow
@pytest.mark.batches  # as those processes fly
def test_parts_that_are_killed_at_any_moment(tmp_path):
    """Two processes, each killed and begun again to fly the rest of its part."""
    runs = 5000
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    folders = [tmp_path / "part-1", tmp_path / "part-2"]
    generator = np.random.default_rng(0)
    kills = 0
    for place, folder in enumerate(folders, start=1):
        words = [sys.executable, "-c", _PART.format(runs=runs), str(folder), str(place)]
        for attempt in range(2):
            process = subprocess.Popen(words, env=environment)
            if attempt == 1:
                assert process.wait(300) == 0
                break
            # Once there is something, at a moment that is drawn.
            limit = time.monotonic() + 120.0
            before = len(list(folder.glob("runs-*")))
            while process.poll() is None and time.monotonic() < limit:
                if len(list(folder.glob("runs-*"))) > before:
                    break
                time.sleep(0.02)
            time.sleep(generator.uniform(0.0, 0.3))
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
                kills += 1
            process.wait()
    assert kills == 2
    out = tmp_path / "merged"
    assert merge_campaigns(out, folders) == (runs, 0)
    cheap.campaign(tmp_path / "whole", runs)
    xarray.testing.assert_identical(
        open_campaign(out), open_campaign(tmp_path / "whole")
    )
