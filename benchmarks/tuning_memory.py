"""Does the memory of a gradient grow with the number of flights?

Peak resident memory of a process that evaluates loss and gradient of the Mars mission once,
in forward and in reverse mode, for several batches.

    python benchmarks/tuning_memory.py --flights 256 16384
"""

import argparse
import subprocess
import sys


_PROGRAM = """
import resource, sys
import jentry
jentry.setup(cache=False)
import jax, optax
from jentry.tuning import AutomaticDifferentiation, Budget, Draws, MeanSquare
from jentry.units import km
mission = jentry.find_mission("mars-drag-tracking")
how, flights = sys.argv[1], int(sys.argv[2])
jentry.tune(
    mission.scenario(),
    lambda s: (s.guidance.gains, s.guidance.observer),
    MeanSquare(lambda misses: misses.downrange / km),
    optax.adam(0.1),
    Draws(mission.dispersion_table(), jax.random.key(0), flights, held_out=2),
    gradient=AutomaticDifferentiation(forward=how == "forward"),
    budget=Budget(2),
)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def peak(how: str, flights: int) -> float:
    """MiB"""
    command = [sys.executable, "-c", _PROGRAM, how, str(flights)]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(ran.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, nargs="+", default=[256, 16384])
    options = parser.parse_args()
    columns = "".join(f"{count:>10}" for count in options.flights)
    print(f"{'peak MiB, flights':20}{columns}{'last / first':>15}")
    for how in ("forward", "reverse"):
        peaks = [peak(how, flights) for flights in options.flights]
        columns = "".join(f"{used:10.0f}" for used in peaks)
        print(f"{how:20}{columns}{peaks[-1] / peaks[0]:15.2f}")


if __name__ == "__main__":
    main()
