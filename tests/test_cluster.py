"""Campaigns and gradients on real clusters of Dask: the same bits, whoever is lost."""

import contextlib
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import types
from pathlib import Path

import cheap
import distributed
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from commands import Arrived, assert_refused, intercepted, monte_carlo
from dask_cluster import ROOT, DaskCluster, kill, that_kills, wait_for

import jentry
from jentry.campaign import (
    batch,
    carried,
    cluster as cluster_module,
    worker as worker_module,
)
from jentry.campaign.batch import LANES, over_runs, sum_over_runs
from jentry.missions import find_mission


# What is compared is bits, and workers compile as users do.
pytestmark = pytest.mark.optimized

CACHE = ROOT / ".pytest_cache" / "processes"
"""Of all processes that are started here"""

RUNS = 5 * LANES + 3
WORDS = jnp.asarray(1.0), "a part of the program"


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    """What this process has compiled, those that are started find, where it is the same."""
    link, compiled = CACHE / "compiled", Path(os.environ["JAX_COMPILATION_CACHE_DIR"])
    if not link.is_symlink() or link.readlink() != compiled:
        CACHE.mkdir(parents=True, exist_ok=True)
        compiled.mkdir(parents=True, exist_ok=True)
        link.unlink(missing_ok=True)
        link.symlink_to(compiled)


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """A scheduler with two workers, one of them with two threads."""
    with DaskCluster(tmp_path_factory.mktemp("two"), CACHE) as cluster:
        cluster.worker(1)
        cluster.worker(2)
        yield cluster


@pytest.fixture(scope="module")
def alike(tmp_path_factory):
    """A scheduler with two workers of one thread, which find compiled what a process has
    flown on one core: for programs that take long to compile."""
    with DaskCluster(tmp_path_factory.mktemp("alike"), CACHE) as cluster:
        cluster.worker(1)
        cluster.worker(1)
        yield cluster


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """It gives up a part with which two workers have been lost (the usual is four)."""
    failures = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
    folder = tmp_path_factory.mktemp("scheduler")
    with DaskCluster(folder, CACHE, **failures) as cluster:
        yield cluster


@pytest.fixture
def of_its_own(scheduler):
    """A scheduler without workers, for those of a test that may be killed."""
    yield scheduler
    scheduler.kill_workers()


def in_small_parts(monkeypatch):
    monkeypatch.setattr(batch, "_CHUNKS", 1)
    monkeypatch.setattr(batch, "_BLOCKS", 1)


@pytest.fixture
def small_parts(monkeypatch):
    in_small_parts(monkeypatch)


def same(one, other):
    """In every bit."""
    bits = lambda x: (np.shape(x), np.asarray(x).dtype, np.asarray(x).tobytes())
    return jax.tree.all(jax.tree.map(lambda x, y: bits(x) == bits(y), one, other))


@pytest.mark.slow
def test_a_stored_campaign_is_that_of_one_machine(tmp_path, two, small_parts):
    """By a scheduler file; its law is of these tests, which no worker can import."""
    cheap.campaign(tmp_path / "here", RUNS)
    reports = []
    with jentry.Cluster(str(two.file)):
        cheap.campaign(tmp_path / "there", RUNS, report=reports.append)
    here, there = (jentry.open_campaign(tmp_path / name) for name in ("here", "there"))
    xarray.testing.assert_identical(here, there)
    # Of 128 runs, the last of 67: in whatever order they are done.
    assert reports[0] == 0 and reports[-1] == RUNS
    assert sorted(np.diff(reports)) == [67, 128, 128]


def with_words(shared, run):
    """Of what the worker is set to, and of what these tests alone have."""
    factor, word = shared
    raises = jax.config.values["jax_numpy_rank_promotion"] == "raise"
    if word != "a part of the program":  # pytest makes other code of what asserts
        raise ValueError(word)
    return factor * run["x"], jnp.asarray(raises), jnp.asarray(len(jax.devices()))


def of_batch(factor, runs, counts):
    return jnp.sum(jnp.where(counts, jnp.sin(factor * runs["x"]), 0.0)), jnp.sum(counts)


def test_values_and_sums_are_those_of_one_machine(two, small_parts):
    """By an address, with the settings of this process, on the threads of each worker."""
    runs = {"x": np.linspace(1.0, 2.0, RUNS)}
    shared = (jnp.asarray(3.0), "a part of the program")
    here = over_runs(with_words, shared, runs), sum_over_runs(of_batch, 7.0, runs)
    with jentry.Cluster(two.address):
        there = over_runs(with_words, shared, runs), sum_over_runs(of_batch, 7.0, runs)
    assert same(here[0][0], there[0][0]) and same(here[1], there[1])
    assert there[0][1].all()
    assert set(there[0][2]) <= {1, 2}
    assert int(there[1][1]) == RUNS


class Wrong(Exception):
    """Of these tests"""


def that_fails(message, run):
    raise message


def test_an_error_of_a_flight_is_itself(two):
    """Also one that could be taken for that of a connection."""
    runs = {"x": np.ones(3)}
    with jentry.Cluster(two.address):
        for error in (
            ValueError("no flight"),
            OSError("no file"),
            TimeoutError("late"),
        ):
            with pytest.raises(type(error), match=str(error)):
                over_runs(that_fails, error, runs)
        with pytest.raises(jentry.ClusterError, match="has no my_package: install"):
            over_runs(that_fails, ModuleNotFoundError(name="my_package"), runs)
        # It goes on.
        assert same(over_runs(with_words, WORDS, runs)[0], np.ones(3))


@pytest.mark.parametrize(
    "where", ["local", "local:0", "local:999", "local:two", "localhost:2"]
)
def test_local_clusters_that_there_are_not(command, where):
    with pytest.raises(
        ValueError, match=f"'{where}': one on this machine is local:1 to"
    ):
        jentry.Cluster(where)
    assert_refused(monte_carlo(command, "--cluster", where), "one on this machine")


@pytest.mark.parametrize(
    "words",
    [
        ("monte-carlo", "cheap", "--runs", 3),
        ("compare", "cheap", "--law", "right", "--law", "steep"),
        ("tune", "cheap", "--gains", "guidance.bank_angle"),
    ],
)
def test_the_commands_fly_there(command, monkeypatch, words):
    seen = intercepted(monkeypatch, "jentry.campaign.cluster", "Cluster")
    with pytest.raises(Arrived):
        command(*words, "--step", 1, "--cluster", "tcp://10.0.0.1:8786")
    assert seen["given"] == ("tcp://10.0.0.1:8786",)


def test_stored_campaigns_are_compared_without_a_cluster(command, tmp_path):
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    words = "one", "other", "--cluster", "local:1"
    assert_refused(command("compare", *words), "leave out --law")


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("tcp://127.0.0.1:9", "there is no scheduler at tcp://127.0.0.1:9: "),
        ("nowhere", "there is no scheduler at nowhere: missing port"),
        ("post://1.2.3.4:5", "there is no scheduler at post://1.2.3.4:5: "),
        ("none.json", "none.json is no scheduler file"),
        ("other.json", "other.json is no scheduler file"),
        ("text.json", "text.json is no scheduler file"),
    ],
)
def test_schedulers_that_there_are_not(command, monkeypatch, where, message):
    monkeypatch.setattr(cluster_module, "_ANSWER", 0.3)
    Path("other.json").write_text('{"workers": {}}')
    Path("text.json").write_text("tcp://127.0.0.1:8786")
    with pytest.raises(jentry.ClusterError, match=message):
        with jentry.Cluster(where):
            pass
    refused = monte_carlo(command, "--cluster", where)
    assert_refused(refused, message, code=4)
    assert "the same command resumes" in refused[2]


def test_without_dask_it_is_said_what_to_install(command, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    refused = monte_carlo(command, "--cluster", "tcp://127.0.0.1:9")
    assert_refused(refused, "python -m pip install 'jentry[cluster]'", code=4)


@pytest.mark.parametrize(
    ("differs", "message"),
    [
        ({"code of jentry": "0" * 64}, "code of jentry differs"),
        ({"jax": "0.1"}, r"jax is \d.* there and 0.1 now"),
        ({"XLA_FLAGS": ["--xla_of_mine"]}, "XLA_FLAGS differs"),
    ],
)
def test_a_worker_on_other_terms_is_refused(two, monkeypatch, differs, message):
    ours = worker_module.terms()
    monkeypatch.setattr(cluster_module, "terms", lambda: ours | differs)
    whole = (
        f"worker tcp://127.0.0.1:.* cannot give the numbers of this .*{message}.*same"
    )
    with jentry.Cluster(two.address), pytest.raises(jentry.ClusterError, match=whole):
        over_runs(with_words, WORDS, {"x": np.ones(3)})


def test_settings_are_those_of_who_asks(two):
    """Each time: workers are for several, who may have others."""
    for wanted in ("raise", "allow", "raise"):
        with jax.numpy_rank_promotion(wanted), jentry.Cluster(two.address):
            raises = over_runs(with_words, WORDS, {"x": np.ones(3)})[1]
            assert raises.all() == (wanted == "raise")


def test_a_worker_gets_ready_as_who_asks(monkeypatch):
    """With so many threads and with the options, or not at all."""
    seen = []
    setup = lambda *given, **options: seen.append((given, options))
    monkeypatch.setattr(worker_module, "setup", setup)
    known = worker_module.terms() | {"fast": True}
    with pytest.raises(jentry.ClusterError, match="fast is False there and True now"):
        worker_module._get_ready(3, known, "tcp://here")
    assert seen == [((3,), {"fast": True})]


def test_the_time_without_workers_begins_anew(two, monkeypatch):
    """Looks at a cluster with so many workers at so many seconds."""
    with jentry.Cluster(two.address, patience=5.0):
        machines = batch._MACHINES.get()
        for now, workers in ((1, 0), (5, 0), (6, 1), (99, 0), (103, 0)):
            clock = types.SimpleNamespace(monotonic=lambda now=now: float(now))
            monkeypatch.setattr(cluster_module, "time", clock)
            there = lambda self, workers=workers: workers * [1]
            monkeypatch.setattr(type(machines), "_threads", there)
            machines._look()
        clock = types.SimpleNamespace(monotonic=lambda: 105.0)
        monkeypatch.setattr(cluster_module, "time", clock)
        with pytest.raises(jentry.ClusterError, match="none for 5 s"):
            machines._look()
        monkeypatch.undo()


def test_a_scheduler_that_is_lost_while_it_is_asked(two, monkeypatch):
    def gone():
        raise OSError("the connection is closed")

    with jentry.Cluster(two.address):
        monkeypatch.setattr(batch._MACHINES.get()._client, "nthreads", gone)
        with pytest.raises(jentry.ClusterError, match="the scheduler at .* is lost"):
            over_runs(with_words, WORDS, {"x": np.ones(3)})


class Late(distributed.Future):
    """A value that is lost with its worker, and flown again by another one."""

    def __init__(self):
        self.waits = []

    def __del__(self):
        pass

    @property
    def status(self):
        return "pending"

    def result(self, timeout=None):
        self.waits.append(timeout)
        if len(self.waits) < 3:
            raise TimeoutError
        here = worker_module.kind_of_processor()
        return worker_module.Flown(carried.dumped(7.0), "tcp://here", here)


def test_a_value_that_is_lost_is_waited_for(two):
    with jentry.Cluster(two.address, patience=5.0):
        late = Late()
        assert batch._MACHINES.get()._value(late) == 7.0
        assert late.waits == 3 * [5.0]


def test_changed_files_of_jentry_are_refused(two, monkeypatch):
    monkeypatch.setattr("jentry._provenance.program_keys._IMPORTED", 0.0)
    with (
        jentry.Cluster(two.address),
        pytest.raises(jentry.ClusterError, match="changed"),
    ):
        over_runs(with_words, WORDS, {"x": np.ones(3)})


def test_another_processor_is_said_once(two, monkeypatch):
    monkeypatch.setattr(cluster_module, "kind_of_processor", lambda: "another")
    with jentry.Cluster(two.address):
        with pytest.warns(UserWarning, match="has another processor than this machine"):
            over_runs(with_words, WORDS, {"x": np.ones(3)})
        over_runs(with_words, WORDS, {"x": np.ones(3)})


def test_what_is_equal_may_be_another():
    """True is equal to 1, and 0.0 to -0.0: each comes back as it went."""
    structures = worker_module.Structures()
    for given in (1, True, 1.0, 0.0, -0.0):
        for tree in ({"x": given}, eqx.Partial(words_of, given)):
            back = carried.loaded(structures.packed(tree).structure)
            assert repr(back) == repr(tree)


def words_of(x):
    return repr(x)


@pytest.fixture
def nothing_sent(monkeypatch):
    """As in a worker that begins, and this process as it was afterwards."""
    monkeypatch.setattr(carried, "_SENT", {})
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        del sys.modules[name]


def test_what_imports_a_changed_module_is_imported_again(nothing_sent):
    source = lambda name, text: {name: carried.Source(text, f"{name}.py", False)}
    whole = source("sent_whole", "from sent_part import VALUE\n")
    for value in (1, 2):
        sent = whole | source("sent_part", f"VALUE = {value}\n")
        assert carried.receive(sent)
        assert importlib.import_module("sent_whole").VALUE == value
        assert not carried.receive(sent)


def test_a_class_that_no_worker_finds_is_refused(two):
    """It would be another class there, without its fields."""

    class Hidden(eqx.Module):
        factor: jax.Array

    with (
        jentry.Cluster(two.address),
        pytest.raises(ValueError, match="Hidden is defined"),
    ):
        over_runs(with_words, (Hidden(jnp.ones(())), ""), {"x": np.ones(3)})


def test_one_cluster_at_a_time(two):
    with jentry.Cluster(two.address):
        with pytest.raises(RuntimeError, match="one cluster flies already"):
            with jentry.Cluster(two.address):
                pass
        assert over_runs(with_words, WORDS, {"x": np.ones(3)})[1].all()


# What is jentry's own comes first: a worker that has been sent a law keeps no programs.


@pytest.mark.slow
def test_a_campaign_of_a_mission(alike, key):
    mission = find_mission("mars-drag-tracking")
    fly = lambda: jentry.monte_carlo(
        mission.scenario(), mission.dispersion_table(), key, 2500, history=20.0
    )
    here = fly()
    with jentry.Cluster(alike.address):
        there = fly()
    assert same(here, there)


def started(*words, cwd, **options):
    """A process of Python as a user starts it, with warnings as errors."""
    return subprocess.Popen(
        [sys.executable, "-W", "error", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env={**os.environ, "JENTRY_CACHE": str(CACHE)},
        **options,
    )


TUNING = """
import dataclasses
import sys
import equinox as eqx
import jax
import numpy as np
import optax
import jentry

LOSS = jentry.MeanSquare(lambda misses: misses.downrange / jentry.km)


def tuned(flights):
    mission = jentry.find_mission("my_lander.py")
    tuned = jentry.tune(
        dataclasses.replace(mission.scenario(), step=1.0),
        lambda s: (s.guidance.bank, s.guidance.gain),
        LOSS,
        optax.adam(0.1),
        jentry.Draws(
            mission.dispersion_table(), jax.random.key(0), flights, held_out=200
        ),
        budget=jentry.tuning.Budget(3),
    )
    return tuned, tuned.scenario


def bits(tree):
    numbers = map(np.asarray, filter(eqx.is_array_like, jax.tree.leaves(tree)))
    return [(x.shape, x.dtype, x.tobytes()) for x in numbers]


if __name__ == "__main__":
    jentry.setup(1)
    here = tuned(300)
    with jentry.Cluster(sys.argv[1]):
        there = tuned(300)
    assert bits(here) == bits(there)
    print(len(bits(here)))
"""


@pytest.mark.slow
def test_tuning_takes_the_same_course(lander, alike):
    """Of flights that are several batches."""
    (lander / "script.py").write_text(TUNING)
    flown = started("script.py", alike.address, cwd=lander)
    printed, errors = flown.communicate(timeout=600)
    assert flown.returncode == 0 and not errors, errors
    assert int(printed) > 10


# Who is lost, and who does not fit.


PARTS = 10
MANY = PARTS * LANES + 3


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A campaign of many parts, of one machine."""
    out = tmp_path_factory.mktemp("whole") / "whole"
    with pytest.MonkeyPatch.context() as monkeypatch:
        in_small_parts(monkeypatch)
        cheap.campaign(out, MANY)
    return jentry.open_campaign(out)


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_its_part(
    tmp_path, of_its_own, whole, small_parts, monkeypatch
):
    killed, _ = of_its_own.worker(1), of_its_own.worker(1)
    out = tmp_path / "there"
    reports, tasks = [], []
    made = worker_module.task
    monkeypatch.setattr(
        cluster_module, "task", lambda *given: tasks.append(1) or made(*given)
    )

    def report(stored):
        reports.append(stored)
        if len(reports) == 4:
            kill(killed)

    with jentry.Cluster(of_its_own.address):
        cheap.campaign(out, MANY, report=report)
        assert of_its_own.workers() == 1
    assert sorted(np.diff(reports)) == [3] + PARTS * [LANES]
    assert len(tasks) == PARTS + 1  # what is lost, Dask gives to another one
    xarray.testing.assert_identical(jentry.open_campaign(out), whole)


@pytest.mark.slow
def test_a_worker_that_comes_later_flies_too(tmp_path, of_its_own, whole, small_parts):
    """Also the first one, for which it waits; and once more where all have been lost."""
    first = of_its_own.worker(1)
    out = tmp_path / "there"

    def report(stored):
        if stored == 3 * LANES:
            kill(first)
            of_its_own.worker(1)

    with jentry.Cluster(of_its_own.address):
        cheap.campaign(out, MANY, report=report)
    xarray.testing.assert_identical(jentry.open_campaign(out), whole)


@pytest.mark.slow
def test_a_scheduler_that_is_lost(tmp_path, whole, small_parts, alike):
    """In one sentence; what is stored is resumed, by another cluster or without one."""
    out = tmp_path / "there"
    with DaskCluster(tmp_path, CACHE) as cluster:
        cluster.worker(1)

        def report(stored):
            if stored >= 3 * LANES:
                kill(cluster.scheduler)

        with pytest.raises(
            jentry.ClusterError, match="^the scheduler at tcp://.* is lost$"
        ):
            with jentry.Cluster(cluster.address):
                cheap.campaign(out, MANY, report=report)
    reports = []
    with jentry.Cluster(alike.address):
        cheap.campaign(out, 8 * LANES, report=reports.append)
    assert 3 * LANES <= reports[0] < reports[-1] == 8 * LANES
    cheap.campaign(out, MANY)
    xarray.testing.assert_identical(jentry.open_campaign(out), whole)


@pytest.mark.slow
def test_no_workers(of_its_own):
    with pytest.raises(jentry.ClusterError, match="has no workers after 0.5 s: start"):
        with jentry.Cluster(of_its_own.address, patience=0.5):
            pass
    worker = of_its_own.worker(1)
    with jentry.Cluster(of_its_own.address, patience=0.5):
        kill(worker)
        with pytest.raises(jentry.ClusterError, match="has lost all of its workers"):
            over_runs(with_words, WORDS, {"x": np.ones(3)})


@pytest.mark.slow
def test_a_part_that_kills_its_workers(of_its_own):
    for _ in range(2):
        of_its_own.worker(1)
    with jentry.Cluster(of_its_own.address):
        with pytest.raises(
            jentry.ClusterError, match="^2 workers of .* with the same part"
        ):
            over_runs(that_kills, WORDS, {"x": np.ones(3)})


@pytest.mark.slow
def test_a_worker_with_other_code_is_refused(tmp_path, of_its_own):
    """Whose jentry differs by a comment."""
    other = tmp_path / "other"
    shutil.copytree(Path(jentry.__file__).parent, other / "jentry")
    with (other / "jentry" / "units.py").open("a") as file:
        file.write("# Another one\n")
    of_its_own.worker(1, PYTHONPATH=str(other))
    with jentry.Cluster(of_its_own.address):
        with pytest.raises(jentry.ClusterError, match="code of jentry differs"):
            over_runs(with_words, WORDS, {"x": np.ones(3)})


@pytest.mark.slow
def test_a_worker_without_jentry_is_refused(tmp_path, of_its_own):
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / "jentry.py").write_text(
        "raise ModuleNotFoundError(name='jentry')"
    )
    of_its_own.worker(1, PYTHONPATH=str(tmp_path / "none"))
    with jentry.Cluster(of_its_own.address):
        with pytest.raises(jentry.ClusterError, match="has no jentry: install there"):
            over_runs(with_words, WORDS, {"x": np.ones(3)})


@pytest.fixture
def lander(tmp_path):
    """A mission of one file, with its law in another one beside it."""
    text = ROOT.joinpath("tests", "lander.py").read_text()
    begin, end = text.index("class LiftAgainstDrag"), text.index("def scenario()")
    (tmp_path / "its_law.py").write_text(text[:end].replace("import functools\n", ""))
    rest = text[:begin] + "import its_law\n\n" + text[end:]
    rest = rest.replace("=LiftAgainstDrag(", "=its_law.LiftAgainstDrag(")
    (tmp_path / "my_lander.py").write_text(rest)
    return tmp_path


FLY = ("-m", "jentry", "monte-carlo", "my_lander.py", "--runs", 1300, "--no-figures")
FLY += ("--step", 1)


@pytest.mark.slow
def test_the_command_flies_a_mission_of_a_file(lander, two):
    """On workers that cannot import the law. Processes that it starts itself fly in
    `test_a_law_of_a_script_and_the_same_changed` and in the tutorial."""
    said = {}
    for name, words in {"here": (), "there": ("--cluster", two.address)}.items():
        flown = started(*FLY, "--json", "--out", name, *words, cwd=lander)
        printed, errors = flown.communicate(timeout=300)
        assert flown.returncode == 0, errors
        assert not [line for line in errors.splitlines() if " of 1300 runs" not in line]
        said[name] = json.loads(printed)
    assert said["here"] == said["there"]
    xarray.testing.assert_identical(
        *(jentry.open_campaign(lander / name) for name in said)
    )


SCRIPT = """
import sys
import equinox as eqx
import jax
import numpy as np
import jentry
from its_law import LiftAgainstDrag
from my_lander import dispersions, scenario


class Turned(jentry.AbstractContinuousLaw[None]):
    bank: jentry.Scalar = jentry.scalar(2.0, unit="rad")

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        bank = {sign}self.bank
        return jentry.Controls.from_bank(bank, measurement.trim_angle_of_attack), None


if __name__ == "__main__":
    jentry.setup(1)
    turned = eqx.tree_at(lambda s: s.guidance, scenario(), Turned(0.5))
    fly = lambda: jentry.monte_carlo(
        turned, dispersions(), jax.random.key(0), 200, solver=jentry.FixedStep(1.0)
    )
    here = fly()
    for where in sys.argv[1:]:
        with jentry.Cluster(where):
            there = fly()
        for pair in zip(jax.tree.leaves(here), jax.tree.leaves(there), strict=True):
            assert np.array_equal(*pair)
        print(np.mean(there.flights.state.latitude))
"""


@pytest.mark.slow
def test_a_law_of_a_script_and_the_same_changed(lander, alike):
    """The same workers fly the one, then the other; and those that it starts."""
    latitudes = []
    for sign, *where in (("", alike.address), ("-", alike.address, "local:2")):
        (lander / "script.py").write_text(SCRIPT.replace("{sign}", sign))
        flown = started("script.py", *where, cwd=lander)
        printed, errors = flown.communicate(timeout=300)
        assert flown.returncode == 0 and not errors, errors
        latitudes += map(float, printed.split())
    one, other, started_for_it = latitudes
    assert one < 0.0 < other == started_for_it


CHANGED = {
    "a file after its import": (
        "    jentry.setup(1)\n",
        "    jentry.setup(1)\n    file = pathlib.Path('its_law.py')\n"
        "    file.write_text(file.read_text() + MORE)\n",
        "its_law.<lambda>",
    ),
    "a number in memory": (
        "    jentry.setup(1)\n",
        "    jentry.setup(1)\n    MORE = ''\n",
        "__main__.MORE",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(("before", "after", "name"), CHANGED.values(), ids=CHANGED)
def test_what_is_not_in_the_file_is_refused(lander, alike, before, after, name):
    """Workers would fly another law than this process, and nobody would know."""
    more = "\n\nLiftAgainstDrag.init = lambda self, measurement: None\n"
    script = SCRIPT.replace("{sign}", "len(MORE) / len(MORE) * ").replace(before, after)
    script = script.replace("Turned(0.5))", "Turned(0.5, LiftAgainstDrag(1.5, 0.01)))")
    field = '    bank: jentry.Scalar = jentry.scalar(2.0, unit="rad")\n'
    assert field in script
    script = script.replace(field, f"{field}    other: LiftAgainstDrag | None = None\n")
    script = script.replace("\n    here = fly()", "\n    here = None")
    head = f"\nimport pathlib\nMORE = {more!r}\n\n\nclass"
    (lander / "script.py").write_text(script.replace("\n\n\nclass", head, 1))
    flown = started("script.py", alike.address, cwd=lander)
    _, errors = flown.communicate(timeout=300)
    assert flown.returncode == 1
    assert f"ClusterError: {name} is not what its file says" in errors


def test_other_code_than_of_who_asks_is_refused():
    structures = worker_module.Structures()
    given = eqx.Partial(words_of, 1.0)
    known = structures.packed(given).code
    assert list(known) == ["test_cluster.words_of"]
    worker_module._refuse_other_code(known, given)
    for wrong in (
        {},
        {"test_cluster.words_of": "another"},
        known | {"more": "another"},
    ):
        with pytest.raises(jentry.ClusterError, match="is not what its file says"):
            worker_module._refuse_other_code(wrong, given)


@pytest.mark.slow
def test_a_script_that_does_not_look_whether_it_is_the_main_one(lander, alike):
    """Which workers would fly within what they fly."""
    begin, end = SCRIPT.split('if __name__ == "__main__":')
    (lander / "script.py").write_text(
        f"{begin}if True:{end}".replace("{sign}", "")
        .replace("jentry.setup(1)", "jax.config.update('jax_enable_x64', True)")
        .replace("\n    here = fly()", "")
    )
    flown = started("-W", "default", "script.py", alike.address, cwd=lander)
    _, errors = flown.communicate(timeout=300)
    assert flown.returncode == 1
    assert "ClusterError: a worker runs this script" in errors


def _is_there(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
def test_ctrl_c_ends_it_in_one_line(lander):
    """With the processes that it has started, to which a terminal tells it too."""
    many = [word if word != 1300 else 200_000 for word in FLY]
    words = (*many, "--cluster", "local:1", "--out", "out")
    flown = started(*words, cwd=lander, start_new_session=True)
    try:
        stored = lambda: list((lander / "out").glob("runs-*.nc"))
        wait_for(lambda: stored() or flown.poll() is not None, "the first part")
        os.killpg(flown.pid, signal.SIGINT)
        printed, errors = flown.communicate(timeout=60)
        assert flown.returncode == 130
        lines = [line for line in errors.splitlines() if " of 200000 runs" not in line]
        assert lines == ["jentry: interrupted; the same command resumes"]
        wait_for(lambda: not _is_there(flown.pid), "the end of all processes")
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(flown.pid, signal.SIGKILL)
