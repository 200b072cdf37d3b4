"""How long does a user wait for the first answer, from a fresh process?

Times the command `jentry monte-carlo` as a whole process, for each mission with its own
number of runs: with an empty cache, and again with the cache that this left, once with and
once without figures. The work of a person who waits is imports, planning the reference,
tracing, compiling, flying, storing, the tables and the figures. Rounds are interleaved.

    python benchmarks/first_answer.py
    python benchmarks/first_answer.py rlv sx-2 --rounds 3
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from records import TIMINGS, Cell, save


RUNS = {
    "mars-drag-tracking": 1000,
    "mars-range-tracking": 1000,
    "cav-h": 500,
    "sx-2": 1000,
    "rlv": 500,
}
WAYS = {
    ("empty", "--no-figures"): "empty cache",
    ("filled", "--no-figures"): "filled cache",
    ("empty", "--figures"): "empty, figures",
    ("filled", "--figures"): "filled, figures",
}


def once(mission: str, cache: Path, figures: str) -> float:
    """Seconds of one process, results in a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "jentry", "monte-carlo", mission]
        command += ["--runs", str(RUNS[mission])]
        command += ["--out", str(Path(out) / "campaign"), figures]
        environment = {**os.environ, "JENTRY_CACHE": str(cache)}
        begin = time.perf_counter()
        subprocess.run(command, env=environment, check=True, capture_output=True)
        return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("missions", nargs="*", default=list(RUNS), metavar="MISSION")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--save", action="store_true", help=f"to {TIMINGS.name}")
    options = parser.parse_args()
    unknown = [name for name in options.missions if name not in RUNS]
    if unknown:
        parser.error(f"no such mission: {unknown}; there are {list(RUNS)}")
    spent = {(m, way): [] for m in options.missions for way in WAYS}
    for _ in range(options.rounds):
        for mission in options.missions:
            for figures in ("--no-figures", "--figures"):
                with tempfile.TemporaryDirectory() as cache:
                    for state in ("empty", "filled"):
                        seconds = once(mission, Path(cache), figures)
                        spent[mission, (state, figures)].append(seconds)
    if options.save:
        save(
            TIMINGS,
            "first-answer",
            [
                Cell(f"`{m}`, {RUNS[m]} runs", f"{words}, {what}", value, 1)
                for m in options.missions
                for way, words in WAYS.items()
                for what, value in (
                    ("median, s", statistics.median(spent[m, way])),
                    ("least", min(spent[m, way])),
                    ("largest", max(spent[m, way])),
                )
                if what == "median, s" or way == ("filled", "--figures")
            ],
        )
    print(f"median of {options.rounds} rounds, s (smallest to largest)")
    print(f"{'':28}" + "".join(f"{name:>24}" for name in WAYS.values()))
    for mission in options.missions:
        cells = ""
        for way in WAYS:
            times = spent[mission, way]
            low, middle, high = min(times), statistics.median(times), max(times)
            cells += f"{middle:10.1f} ({low:4.1f} to {high:4.1f})"
        print(f"{mission + f', {RUNS[mission]} runs':28}{cells}")


if __name__ == "__main__":
    main()
