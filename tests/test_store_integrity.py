"""A folder holds one campaign, and a file of it that was changed is refused."""

import hashlib
import json
import shutil

import cheap
import numpy as np
import pytest
import xarray
from campaign_folders import parts, rest, written

from jentry.addresses import replace_leaves
from jentry.campaign import CampaignError, open_campaign, run_campaign
from jentry.campaign.parts import MANIFEST


pytestmark = pytest.mark.optimized  # what is stored is compared bit by bit


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A campaign that nobody may change."""
    out = tmp_path_factory.mktemp("stored")
    cheap.campaign(out, 3, mission="cheap")
    return out


def flown_otherwise(out, **changes):
    options = {
        "scenario": cheap.scenario(),
        "dispersions": cheap.dispersions(),
        "seed": cheap.SEED,
        "runs": 3,
        "solver": cheap.SOLVER,
        "mission": "cheap",
    }
    run_campaign(out, **(options | changes))


def test_the_same_campaign_is_welcome(stored):
    before = open_campaign(stored)
    flown_otherwise(stored)
    xarray.testing.assert_identical(open_campaign(stored), before)


def other_scenario():
    return replace_leaves(cheap.scenario(), {"vehicle.mass": 900.0})


def other_order():
    return dict(reversed(cheap.dispersions().items()))


OTHERS = {
    "seed": (lambda: {"seed": 8}, "seed is 7 there and 8 now"),
    "scenario": (
        lambda: {"scenario": other_scenario()},
        "scenario.vehicle.mass.value is 992.0 there and 900.0 now",
    ),
    "dispersions": (
        lambda: {"dispersions": cheap.mass_only()},
        "dispersions.density is given only there",
    ),
    "order": (
        lambda: {"dispersions": other_order()},
        "dispersions.mass.order is 0 there and 3 now",
    ),
    "inputs": (
        lambda: {"dispersions": None, "inputs": {"vehicle.mass": [900.0] * 3}},
        "dispersions.mass is given only there",
    ),
    "history": (lambda: {"history": 10.0}, "history_interval is None there and 10.0"),
    "solver": (
        lambda: {"solver": type(cheap.SOLVER)(0.5)},
        "solver is .*1.0.* there and .*0.5.* now",
    ),
    "label": (lambda: {"mission": "other"}, "mission is cheap there and other now"),
}


@pytest.mark.parametrize(("changes", "message"), OTHERS.values(), ids=OTHERS)
def test_another_campaign_is_refused_with_the_difference_named(
    stored, changes, message
):
    with pytest.raises(CampaignError, match=f"{stored} holds another.*{message}"):
        flown_otherwise(stored, **changes())
    assert open_campaign(stored).sizes["run"] == 3


def test_nothing_is_left_where_nothing_can_be_flown(tmp_path):
    out = tmp_path / "new"
    wrong = [
        {"runs": 0},
        {"scenario": replace_leaves(cheap.scenario(), {"vehicle.mass": -1.0})},
        {"dispersions": {}},
        {"dispersions": None, "inputs": {"vehicle.mas": [1.0] * 3}},
        {"dispersions": None, "inputs": {"vehicle.mass": [900.0]}},
        {"inputs": {"vehicle.mass": [900.0] * 3}},
    ]
    for changes in wrong:
        with pytest.raises(ValueError):
            flown_otherwise(out, **changes)
    assert not out.exists()


def test_a_folder_without_runs_is_taken_over(tmp_path):
    """A campaign that failed before its first part does not occupy the folder."""
    cheap.campaign(tmp_path, 3)
    for name in parts(tmp_path):
        (tmp_path / name).unlink()
    cheap.campaign(tmp_path, 3, seed=8)
    assert json.loads((tmp_path / MANIFEST).read_text())["seed"] == 8


def test_folders_that_are_no_campaign(tmp_path):
    with pytest.raises(CampaignError, match=f"no {MANIFEST} in it"):
        open_campaign(tmp_path / "nowhere")
    with pytest.raises(CampaignError, match=f"no {MANIFEST} in it"):
        open_campaign(tmp_path)
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(CampaignError, match="is a file"):
        cheap.campaign(file, 3)
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "notes.txt").write_text("mine")
    cheap.campaign(empty, 3)
    assert rest(empty) == {"notes.txt"}


@pytest.mark.parametrize("contents", [b"{", b"[]", b'{"seed": 1}', b"3", b"\xff"])
def test_a_manifest_that_is_damaged(tmp_path, contents):
    (tmp_path / MANIFEST).write_bytes(contents)
    for use in (lambda: open_campaign(tmp_path), lambda: cheap.campaign(tmp_path, 3)):
        with pytest.raises(
            CampaignError, match=f"{MANIFEST} is damaged, of an earlier"
        ):
            use()
    assert (tmp_path / MANIFEST).read_bytes() == contents


def test_a_campaign_without_runs_yet(tmp_path):
    cheap.campaign(tmp_path, 3)
    (tmp_path / parts(tmp_path)[0]).unlink()
    with pytest.raises(CampaignError, match="holds no runs yet"):
        open_campaign(tmp_path)


# Nothing is believed that is not, to the last bit, what the campaign has written.


@pytest.fixture
def copy(stored, tmp_path):
    """A copy of the stored campaign, to be changed: its folder, and its only part."""
    out = tmp_path / "copy"
    shutil.copytree(stored, out)
    (name,) = parts(out)
    return out, out / name


def assert_refused_until_deleted(out, path, stored):
    """Neither opened nor flown on; mended by what the message says, and only by that."""
    before = {p: p.read_bytes() for p in out.iterdir()}
    for use in (lambda: open_campaign(out), lambda: flown_otherwise(out)):
        with pytest.raises(CampaignError) as refused:
            use()
        assert f"{path} is not as this campaign has written it" in str(refused.value)
        assert "Delete it and run the same campaign again" in str(refused.value)
    assert {p: p.read_bytes() for p in out.iterdir()} == before
    path.unlink()
    flown_otherwise(out)
    xarray.testing.assert_identical(open_campaign(out), open_campaign(stored))


def flipped(contents, bit):
    place = bit // 8
    changed = bytes([contents[place] ^ 1 << bit % 8])
    return contents[:place] + changed + contents[place + 1 :]


BITS = np.random.default_rng(20261121)


def test_no_flipped_bit_in_a_part_passes(copy, stored):
    """Of 500: neither is one opened, nor does a campaign go on with it."""
    out, path = copy
    contents = path.read_bytes()
    for count, bit in enumerate(BITS.integers(8 * len(contents), size=500)):
        path.write_bytes(flipped(contents, int(bit)))
        with pytest.raises(CampaignError, match=f"{path.name} is not as this campaign"):
            open_campaign(out)
        if count % 100 == 0:  # which takes longer
            with pytest.raises(CampaignError, match=f"{path.name} is not as this"):
                flown_otherwise(out)
    assert_refused_until_deleted(out, path, stored)


def test_no_flipped_bit_in_the_manifest_passes(copy, stored):
    out, _ = copy
    manifest = out / MANIFEST
    contents = manifest.read_bytes()
    for bit in BITS.integers(8 * len(contents), size=500):
        manifest.write_bytes(flipped(contents, int(bit)))
        with pytest.raises(CampaignError, match=f"{MANIFEST} is damaged.*delete it"):
            open_campaign(out)
    with pytest.raises(CampaignError, match=f"{MANIFEST} is damaged.*delete it"):
        flown_otherwise(out)
    # What the message says mends it, and the runs stay.
    before = open_campaign(stored)
    part = out / parts(out)[0]
    untouched = written(part)
    manifest.unlink()
    with pytest.raises(CampaignError, match=f"no {MANIFEST} in it; run the same"):
        open_campaign(out)
    flown_otherwise(out)
    assert manifest.read_bytes() == contents and written(part) == untouched
    xarray.testing.assert_identical(open_campaign(out), before)


CHANGED = {
    "empty": lambda contents: b"",
    "start": lambda contents: contents[:100],
    "most": lambda contents: contents[:-200],
    "longer": lambda contents: contents + b"\0",
    # Turned round, since there may be nothing but zeros: where depends on what is stored.
    "another stretch": lambda contents: (
        contents[:20000]
        + bytes(255 - byte for byte in contents[20000:20512])
        + contents[20512:]
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGED.values(), ids=CHANGED)
def test_a_part_that_is_damaged_is_named_and_mended(copy, stored, change):
    out, path = copy
    path.write_bytes(change(path.read_bytes()))
    assert_refused_until_deleted(out, path, stored)


NAMES = {
    "other runs": lambda name: name.replace("-000000000-", "-000000003-", 1).replace(
        "-000000002-", "-000000005-"
    ),
    "more runs": lambda name: name.replace("-000000002-", "-000000009-"),
    "another digest": lambda name: f"{name[:-4]}{'0' if name[-4] != '0' else '1'}.nc",
    "no digest": lambda name: f"{name[:-20]}.nc",
    "a copy": lambda name: f"{name[:-3]} (2).nc",
}


@pytest.mark.parametrize("rename", NAMES.values(), ids=NAMES)
def test_a_name_that_lies_is_refused_and_mended(copy, stored, rename):
    out, path = copy
    path = path.rename(out / rename(path.name))
    assert_refused_until_deleted(out, path, stored)


@pytest.mark.parametrize("name", ["theirs", "ours"])
def test_a_part_of_another_seed_is_not_taken_in(copy, stored, tmp_path, name):
    out, path = copy
    other = tmp_path / "other"
    flown_otherwise(other, seed=8)
    foreign = other / parts(other)[0]
    path.unlink()
    path = out / (foreign.name if name == "theirs" else path.name)
    shutil.copy(foreign, path)
    assert_refused_until_deleted(out, path, stored)


def test_a_part_says_of_which_campaign_it_is(stored):
    manifest = json.loads((stored / MANIFEST).read_text())
    digest = manifest.pop("digest")
    canonical = json.dumps(manifest, sort_keys=True).encode()
    assert digest == hashlib.sha256(canonical).hexdigest()
    path = stored / parts(stored)[0]
    with xarray.open_dataset(path, engine="h5netcdf") as part:
        assert part.attrs["campaign_digest"] == digest
    sealed = hashlib.sha256(f"{digest} 0 2 ".encode() + path.read_bytes()).hexdigest()
    assert path.name == f"runs-000000000-000000002-{sealed[:16]}.nc"


def test_parts_without_a_manifest_are_not_given_to_another_campaign(copy):
    out, _ = copy
    (out / MANIFEST).unlink()
    with pytest.raises(CampaignError, match=f"{out} has runs but no {MANIFEST}.*other"):
        flown_otherwise(out, seed=8)
    assert not (out / MANIFEST).exists()


def test_folders_of_an_earlier_jentry_are_refused(copy):
    """Without digests, in the manifest and in the names."""
    out, path = copy
    manifest = json.loads((out / MANIFEST).read_text())
    del manifest["digest"]
    (out / MANIFEST).write_text(json.dumps(manifest))
    path.rename(out / "runs-000000000-000000002.nc")
    for use in (lambda: open_campaign(out), lambda: flown_otherwise(out)):
        with pytest.raises(CampaignError, match="of an earlier jentry"):
            use()


def test_names_that_were_prepared_are_not_written_through(tmp_path):
    """Links at the names under which files were written meanwhile, once."""
    victim = tmp_path / "victim"
    victim.write_text("precious")
    out = tmp_path / "out"
    out.mkdir()
    for name in (MANIFEST, "runs-000000000-000000002.nc"):
        (out / f".{name}.unfinished").symlink_to(victim)
    cheap.campaign(out, 3)
    assert victim.read_text() == "precious"
    assert open_campaign(out).sizes["run"] == 3


def test_the_results_say_what_was_flown(stored):
    results = open_campaign(stored)
    described = json.loads(results.attrs["campaign"])
    assert described["mission"] == "cheap"
    assert described["seed"] == cheap.SEED
    assert described["scenario"]["vehicle.mass"] == {"value": 992.0, "unit": "kg"}
    assert described["dispersions"]["mass"] == {
        "order": 0,
        "addresses": ["vehicle.mass"],
        "distribution": "Uniform",
        "lower": 0.95,
        "upper": 1.05,
        "apply": "jentry.campaign.dispersions.multiply",
    }
    assert {"jentry", "jax"} <= set(described["versions"])
    # A part that is copied away still says it.
    with xarray.open_dataset(stored / parts(stored)[0], engine="h5netcdf") as part:
        assert json.loads(part.attrs["seed"]) == cheap.SEED
        assert "vehicle.mass" in json.loads(part.attrs["scenario"])
