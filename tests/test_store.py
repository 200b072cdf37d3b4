"""A campaign in a folder is resumed, extended and described."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import cheap
import jax
import numpy as np
import pytest
import xarray
from campaign_folders import parts, rest, written
from helpers import fly_compiled

from jentry.campaign import CampaignError, batch, open_campaign, run_campaign, store
from jentry.campaign.batch import LANES
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
