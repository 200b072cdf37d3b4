"""How long does a user wait for the first 1000 runs, from a fresh process?

Times the command `jentry monte-carlo mars-drag-tracking` as a whole process: with an
empty compilation cache, and again with the cache that this left. The work of a person who
waits is imports, planning the reference, tracing, compiling, flying, storing, the tables
and, with --figures, the figures.

    python benchmarks/cold_start.py
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def once(cache: Path, figures: bool) -> float:
    """Seconds of one process, results in a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "jentry", "monte-carlo", "mars-drag-tracking"]
        command += ["--out", str(Path(out) / "campaign")]
        command += ["--figures" if figures else "--no-figures"]
        environment = {**os.environ, "JENTRY_CACHE": str(cache)}
        begin = time.perf_counter()
        subprocess.run(command, env=environment, check=True, capture_output=True)
        return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--figures", action="store_true")
    options = parser.parse_args()
    cold, warm = [], []
    for _ in range(options.rounds):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(once(Path(cache), options.figures))
            warm.append(once(Path(cache), options.figures))
    what = "with" if options.figures else "without"
    print(f"1000 runs from a fresh process, {what} figures, {options.rounds} rounds")
    print(f"{'':14}{'minimum s':>10}{'median s':>10}{'maximum s':>10}")
    for name, seconds in (("empty cache", cold), ("filled cache", warm)):
        low, middle, high = min(seconds), statistics.median(seconds), max(seconds)
        print(f"{name:14}{low:10.2f}{middle:10.2f}{high:10.2f}")


if __name__ == "__main__":
    main()
