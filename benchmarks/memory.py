"""How much memory does a campaign of 100 000 runs need, beyond the imports?

Peak resident memory of the command `jentry monte-carlo mars-drag-tracking`, without
histories and figures, against a process that only imports what the command imports. It
should hardly depend on the number of runs.

    python benchmarks/memory.py --runs 1000 100000
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def peak(command: list[str]) -> tuple[float, float]:
    """Peak resident memory (MiB) and duration (s) of a process that must succeed."""
    begin = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        raise RuntimeError(f"{' '.join(command)} ended with status {status}")
    return usage.ru_maxrss / 1024, time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, nargs="+", default=[1000, 100_000])
    options = parser.parse_args()
    imports = "import jentry, jentry.cli, xarray, h5netcdf, rich.progress"
    base, _ = peak([sys.executable, "-c", imports])
    print(f"{'':22}{'peak MiB':>10}{'above import':>14}{'seconds':>10}")
    print(f"{'imports':22}{base:10.0f}")
    for runs in options.runs:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "jentry", "monte-carlo"]
            command += ["mars-drag-tracking", "--no-figures", "--fast"]
            command += ["--runs", str(runs), "--out", str(Path(folder) / "campaign")]
            used, seconds = peak(command)
        print(f"{f'{runs} runs':22}{used:10.0f}{used - base:14.0f}{seconds:10.1f}")


if __name__ == "__main__":
    main()
