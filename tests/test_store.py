"""What is reported as stored stays stored, and a folder holds one campaign."""

import errno
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import cheap
import jax
import numpy as np
import pytest
import xarray
from helpers import fly_compiled

from jentry.addresses import replace_leaves
from jentry.campaign import CampaignError, batch, open_campaign, run_campaign, store
from jentry.campaign.batch import LANES
from jentry.campaign.parts import MANIFEST
from jentry.campaign.store import write_flight
from jentry.flight import Outcome


RUNS = 3 * LANES + 8

pytestmark = pytest.mark.optimized  # what is stored is compared bit by bit


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A campaign that nothing has interrupted."""
    out = tmp_path_factory.mktemp("whole") / "campaign"
    cheap.campaign(out, RUNS)
    return open_campaign(out)


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(batch, "_CHUNKS", 1)


def parts(out):
    return sorted(path.name for path in out.glob("runs-*.nc"))


def written(path):
    """Another one whenever a file is written: which it is, and when it was."""
    return path.stat().st_ino, path.stat().st_mtime_ns


def rest(out):
    """What is in a folder besides parts and manifest."""
    return {path.name for path in out.iterdir()} - {*parts(out), MANIFEST}


# Told by the first argument, it stops for good either right after it has said that so
# many runs are stored, or in the middle of writing the next part.
FLY = """
import os, sys, time
import jax
jax.config.update("jax_enable_x64", True)
import cheap
import jentry.campaign.store
sys.modules["jentry.campaign.batch"]._CHUNKS = 1
where, stop, out, runs = sys.argv[1], int(sys.argv[2]), sys.argv[3], int(sys.argv[4])
stored = 0

def wait():
    print("waiting", flush=True)
    time.sleep(600)

def report(so_many):
    global stored
    stored = so_many
    print("stored", stored, flush=True)
    if where == "after" and stored == stop:
        wait()

fsync = os.fsync

def half(file):
    if where == "within" and stored == stop:
        os.truncate(file, os.fstat(file).st_size // 2)
        wait()
    fsync(file)

os.fsync = half
cheap.campaign(out, runs, report=report)
"""


def fly_and_kill(where, stop, out):
    """Reports of a process that is killed at a place."""
    process = subprocess.Popen(
        [sys.executable, "-c", FLY, where, str(stop), str(out), str(RUNS)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
    )
    reports = []
    for line in process.stdout:
        if line == "waiting\n":
            process.kill()
            break
        reports.append(int(line.split()[1]))
    process.stdout.close()
    assert process.wait() == -9
    return reports


@pytest.mark.slow
def test_a_killed_campaign_is_resumed_to_the_same_numbers(tmp_path, whole, small_parts):
    """Killed after a report, again within a part, and resumed twice by the same call."""
    out = tmp_path / "campaign"
    assert fly_and_kill("after", LANES, out) == [0, LANES]
    first = open_campaign(out)
    xarray.testing.assert_identical(
        first.drop_attrs(), whole.isel(run=slice(LANES)).drop_attrs()
    )
    assert fly_and_kill("within", 2 * LANES, out) == [LANES, 2 * LANES]
    assert len(parts(out)) == 2
    assert len(rest(out)) == 1  # half of a part, under another name

    reports = []
    cheap.campaign(out, RUNS, report=reports.append)
    assert reports == [2 * LANES, 3 * LANES, RUNS]
    xarray.testing.assert_identical(open_campaign(out), whole)
    assert not rest(out)


TWO_DEVICES = """
import sys
import jentry
jentry.setup(workers=2, cache=False)
import cheap
cheap.campaign(sys.argv[1], int(sys.argv[2]))
"""


@pytest.mark.slow
def test_a_campaign_on_two_devices_is_the_same(tmp_path, whole):
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    arguments = [sys.executable, "-c", TWO_DEVICES, tmp_path, str(RUNS)]
    subprocess.run(arguments, check=True, env=environment)
    xarray.testing.assert_identical(open_campaign(tmp_path), whole)


def test_a_stored_campaign_is_not_flown_again(tmp_path, small_parts):
    cheap.campaign(tmp_path, LANES)
    before = written(tmp_path / parts(tmp_path)[0])
    reports = []
    cheap.campaign(tmp_path, LANES, report=reports.append)
    cheap.campaign(tmp_path, 3, report=reports.append)
    assert reports == [LANES, 3]
    assert written(tmp_path / parts(tmp_path)[0]) == before


@pytest.mark.slow
@pytest.mark.batches
def test_more_runs_are_added(tmp_path, whole):
    for runs in (5, LANES, RUNS):
        cheap.campaign(tmp_path, runs)
        assert open_campaign(tmp_path).sizes["run"] == runs
    assert len(parts(tmp_path)) == 3
    xarray.testing.assert_identical(open_campaign(tmp_path), whole)
    assert open_campaign(tmp_path, 7).sizes["run"] == 7


def test_a_part_that_is_missing_is_flown_again(tmp_path, whole, small_parts):
    cheap.campaign(tmp_path, RUNS)
    (tmp_path / parts(tmp_path)[1]).unlink()
    reports = []
    cheap.campaign(tmp_path, RUNS, report=reports.append)
    assert reports == [RUNS - LANES, RUNS]
    xarray.testing.assert_identical(open_campaign(tmp_path), whole)


def test_two_gaps_are_flown_and_nothing_else(tmp_path, whole, small_parts):
    """Parts of the beginning and of the middle are lost."""
    cheap.campaign(tmp_path, RUNS)
    first, second, third, last = parts(tmp_path)
    stays = {name: written(tmp_path / name) for name in (second, last)}
    (tmp_path / first).unlink()
    (tmp_path / third).unlink()
    reports = []
    cheap.campaign(tmp_path, RUNS, report=reports.append)
    assert reports == [LANES + 8, 2 * LANES + 8, RUNS]
    assert parts(tmp_path) == [first, second, third, last]
    assert {name: written(tmp_path / name) for name in stays} == stays
    xarray.testing.assert_identical(open_campaign(tmp_path), whole)


def test_one_stored_run_parts_what_is_missing_beside_it():
    missing = store._unbroken(np.array([0, 2, 3, 7]))
    assert [block.tolist() for block in missing] == [[0], [2, 3], [7]]


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


def no_space(*given):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_without_space_earlier_parts_stay_and_nothing_half_written(
    tmp_path, whole, small_parts, monkeypatch
):
    reports = []

    def report(stored):
        reports.append(stored)
        if stored == LANES:
            monkeypatch.setattr(os, "fsync", no_space)

    with pytest.raises(OSError, match="No space left"):
        cheap.campaign(tmp_path, RUNS, report=report)
    assert reports == [0, LANES]
    assert len(parts(tmp_path)) == 1 and not rest(tmp_path)
    monkeypatch.undo()
    cheap.campaign(tmp_path, RUNS)
    xarray.testing.assert_identical(open_campaign(tmp_path), whole)


FULL = """
import errno, resource, sys
import xarray
from pathlib import Path
from jentry._files import write_whole
from jentry.campaign.store import _netcdf
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
out = Path(sys.argv[1])
contents = _netcdf(xarray.Dataset({"x": ("run", [1.0] * 10_000)}))
try:
    write_whole(out / "x.nc", contents)
except OSError as error:
    assert error.errno == errno.EFBIG, error
    assert not list(out.iterdir()), list(out.iterdir())
    print("refused")
"""


@pytest.mark.slow
def test_a_real_limit_of_the_disk_is_an_error_and_no_crash(tmp_path):
    """HDF5 writing to a full disk itself ends the process with a segmentation fault."""
    run = subprocess.run(
        [sys.executable, "-c", FULL, tmp_path], capture_output=True, text=True
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "refused\n", "")


def test_every_variable_says_what_it_is(whole):
    for name, variable in whole.data_vars.items():
        assert variable.dims == ("run",)
        assert variable.attrs["long_name"], name
        assert variable.attrs["units"], name
    units = {str(name): v.attrs["units"] for name, v in whole.data_vars.items()}
    assert units["vehicle.mass"] == "kg"
    assert units["initial_state.flight_path_angle"] == "rad"
    assert units["downrange_error"] == "m"
    assert units["peak_heat_rate"] == "W/m2"
    assert units["end_time"] == "s"
    assert whole["vehicle.mass"].attrs["long_name"] == "input vehicle.mass"
    meanings = whole["outcome"].attrs["flag_meanings"].split()
    assert meanings == [outcome.name.lower() for outcome in Outcome]
    ends = whole["ended_by"].attrs["flag_meanings"].split()
    assert tuple(ends) == cheap.scenario().termination.names
    assert np.array_equal(whole["run"], np.arange(RUNS))


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


def test_given_inputs_are_stored(tmp_path, whole):
    inputs = {
        str(name): whole[name].values[:3]
        for name in whole.data_vars
        if "." in str(name)
    }
    run_campaign(
        tmp_path, cheap.scenario(), None, 0, 3, inputs=inputs, solver=cheap.SOLVER
    )
    three = whole.isel(run=slice(3)).drop_attrs()
    xarray.testing.assert_identical(open_campaign(tmp_path).drop_attrs(), three)


@pytest.mark.slow
def test_histories_are_stored(tmp_path):
    cheap.campaign(tmp_path, 3, history=20.0)
    results = open_campaign(tmp_path)
    assert results.sizes == {"run": 3, "time": 15}
    assert results["time"].attrs["units"] == "s"
    flying = results["time"] < results["end_time"]
    for name in ("altitude", "velocity", "bank_angle", "angle_of_attack", "drag"):
        assert results[name].dims == ("run", "time")
        assert results[name].attrs["units"] != "1"
        assert np.array_equal(np.isfinite(results[name]), flying.T)


def test_one_flight_is_written(tmp_path):
    path = tmp_path / "flight.nc"
    flight = fly_compiled(cheap.scenario(), cheap.SOLVER)
    write_flight(path, cheap.scenario(), flight, cheap.SOLVER, None, mission="cheap")
    with xarray.open_dataset(path, engine="h5netcdf") as written:
        assert written["end_time"].values == [float(flight.time)]
        described = json.loads(written.attrs["campaign"])
    assert described["solver"] == str(cheap.SOLVER)
    assert jax.tree.leaves(flight.history) == []


def test_two_processes_do_not_share_a_folder(tmp_path):
    import fcntl

    folder = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    with pytest.raises(CampaignError, match="another process flies a campaign into"):
        cheap.campaign(tmp_path, 2)
    os.close(folder)
    cheap.campaign(tmp_path, 2)
    assert open_campaign(tmp_path).sizes["run"] == 2
