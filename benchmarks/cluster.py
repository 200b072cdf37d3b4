"""What does a cluster cost, and from how many runs on does a second machine pay?

Flies a stored campaign in this process, on two workers of Dask that have flown it before,
on `local:2`, whose processes are started for it and ended, and on `local:2` with an empty
cache: in interleaved rounds. Told are medians with the smallest and the largest, what the
parts are made of, and what follows for a second machine like this one, which has the same
code and packages: it halves the time of flight, and costs what its workers take before they
fly. Other work on the machine makes the times longer; their ratios bear that better.

    python benchmarks/cluster.py
    python benchmarks/cluster.py sx-2 --runs 5000 --rounds 3
"""

import argparse
import contextlib
import logging
import os
import statistics
import tempfile
import time
from collections.abc import Iterator
from typing import NamedTuple

import distributed
from records import TIMINGS, Cell, save

import jentry
from jentry.campaign import cluster as cluster_module, worker as worker_module
from jentry.campaign.batch import in_blocks


WAYS = {
    "one": "one process, {cores} cores",
    "warm": "two workers that have flown it",
    "fresh": "local:2, its start and end included",
    "start": "  start of the processes",
    "end": "  their end",
    "load": "  import and load, by the difference",
    "empty": "local:2, nothing compiled",
}


class Parts(NamedTuple):
    """What goes to and fro in a campaign on a cluster."""

    there: list[int]
    """Bytes of each task"""
    back: list[int]
    """Bytes of what each gives"""
    seconds: float
    """Of the processor, in the process that stores, for each part"""


def cost(rate: float, before: float) -> float:
    """Runs from which on a second machine pays that is not there for so many seconds.

    One machine flies them in runs / rate, and two in half of that and the wait.
    """
    return 2.0 * rate * before


class Campaign:
    """Flown into a folder that is thrown away."""

    def __init__(self, name: str, runs: int):
        mission = jentry.find_mission(name)
        self._scenario, self._table = mission.scenario(), mission.dispersion_table()
        self._runs = runs

    def __call__(self) -> float:
        """Seconds that it takes."""
        with tempfile.TemporaryDirectory() as out:
            begin = time.perf_counter()
            jentry.run_campaign(out, self._scenario, self._table, 0, self._runs)
            return time.perf_counter() - begin


@contextlib.contextmanager
def cache_in(folder: str) -> Iterator[None]:
    """Processes that begin within it keep what they compile in a folder."""
    before = os.environ.get("JENTRY_CACHE")
    os.environ["JENTRY_CACHE"] = folder
    try:
        yield
    finally:
        if before is None:
            del os.environ["JENTRY_CACHE"]
        else:
            os.environ["JENTRY_CACHE"] = before


def on_its_own(fly: Campaign) -> tuple[float, float, float]:
    """Seconds of `local:2`: its start, the flight, its end."""
    begin = time.perf_counter()
    with contextlib.ExitStack() as ending:
        ending.enter_context(jentry.Cluster("local:2"))
        start = time.perf_counter() - begin
        flight = fly()
        begin = time.perf_counter()
    return start, flight, time.perf_counter() - begin


def parts_of(fly: Campaign, address: str) -> Parts:
    """Of one campaign on workers that have flown it before."""
    there, back = [], []
    task, loaded = worker_module.task, cluster_module.loaded

    def told_task(*given):
        made = task(*given)
        there.append(len(made))
        return made

    def told_loaded(carried):
        back.append(len(carried.contents))
        return loaded(carried)

    cluster_module.task, cluster_module.loaded = told_task, told_loaded
    try:
        with jentry.Cluster(address):
            begin = time.process_time()
            fly()
            spent = time.process_time() - begin
    finally:
        cluster_module.task, cluster_module.loaded = task, loaded
    return Parts(there, back, spent / len(there))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mission", nargs="?", default="mars-drag-tracking")
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--save", action="store_true", help=f"to {TIMINGS.name}")
    options = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        parser.error("two workers take two cores")
    jentry.setup()
    fly = Campaign(options.mission, options.runs)
    spent: dict[str, list[float]] = {way: [] for way in WAYS}
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=cores // 2,
        processes=True,
        memory_limit=None,
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    ) as workers:
        address = workers.scheduler_address
        fly()
        with jentry.Cluster(address):
            fly()
        for _ in range(options.rounds):
            spent["one"].append(fly())
            with jentry.Cluster(address):
                spent["warm"].append(fly())
            start, flight, end = on_its_own(fly)
            spent["fresh"].append(start + flight + end)
            spent["start"].append(start)
            spent["end"].append(end)
            spent["load"].append(flight - spent["warm"][-1])
            with tempfile.TemporaryDirectory() as cache, cache_in(cache):
                spent["empty"].append(sum(on_its_own(fly)))
        parts = parts_of(fly, address)
        with jentry.Cluster(address):
            size = len(next(in_blocks(range(10**9)))) // (cores // 2)
    report(options, cores, spent, parts, size)


def report(options, cores: int, spent, parts: Parts, size: int) -> None:
    """Print all of it."""
    middle = {way: statistics.median(times) for way, times in spent.items()}
    print(f"{options.runs} runs of {options.mission}, stored; medians of")
    print(f"{options.rounds} interleaved rounds, s (smallest to largest)")
    ratios = {
        way: statistics.median(
            x / y for x, y in zip(spent[way], spent["one"], strict=True)
        )
        for way in WAYS
    }
    for way, words in WAYS.items():
        low, high = min(spent[way]), max(spent[way])
        print(
            f"{words.format(cores=cores):38}{middle[way]:6.1f} ({low:.1f} to {high:.1f})"
            f"{ratios[way]:8.2f} of one process"
        )
    if options.save:
        cells = []
        for way, words in WAYS.items():
            row = words.format(cores=cores)
            cells += [
                Cell(row, "median, s", middle[way], 1),
                Cell(row, "least", min(spent[way]), 1),
                Cell(row, "largest", max(spent[way]), 1),
                Cell(row, "in units of one process", ratios[way], 2),
            ]
        save(TIMINGS, "cluster", cells)
    there, back = (statistics.median(sizes) / 1e6 for sizes in parts[:2])
    print(f"a part: {size} runs for each core of a worker; {there:.2f} MB there,")
    print(f"{back:.2f} MB back, {parts.seconds:.3f} s of the process that stores it,")
    each = cores // 2
    fed = each * size / parts.seconds
    print(f"which feeds {fed:.0f} runs/s of workers with this many cores: {each}")
    rate = options.runs / middle["one"]
    before = middle["start"] + middle["load"] + middle["end"]
    print("a second machine like this one, in place of none, pays")
    print(f"from {cost(rate, before):.0f} runs if its workers have just been started,")
    print(f"which is from {2.0 * before:.0f} s of flying, and from two parts,")
    print(f"{2 * size * cores} runs, if they are there")


if __name__ == "__main__":
    main()
