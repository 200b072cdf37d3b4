"""How many flights a second under the predictor-corrector, and under the paper's law?

Flies the same dispersed entries of a mission under each, on one core; the programs take
turns. Prints medians of the processor time, flights a second, and ratios.

    python benchmarks/predictor_corrector.py --fast
    python benchmarks/predictor_corrector.py --fast --missions mars-range-tracking
"""

import argparse
import statistics
import time

import equinox as eqx
import jax
import numpy as np

import jentry
from jentry.addresses import replace_leaves
from jentry.campaign.campaign import drawn_inputs


VARIANTS = {
    "mars-range-tracking": (
        "in-plane",
        "predictor-corrector-in-plane",
        "three-dimensional",
        "predictor-corrector",
    ),
    "sx-2": ("full", "predictor-corrector"),
    "x-33": ("with-range", "predictor-corrector"),
    "rlv": ("r5", "predictor-corrector"),
}
ROUNDS = 5


def program(scenario, table, flights):
    """All flights, compiled; a call gives its processor time, s."""
    inputs = drawn_inputs(scenario, table, jax.random.key(0), np.arange(flights))

    @eqx.filter_jit
    def ends(scenario, inputs):
        def end(values):
            flight = jentry.fly(replace_leaves(scenario, values))
            return flight.time, flight.state, flight.peaks

        return jax.vmap(end)(inputs)

    compiled = ends.lower(scenario, inputs).compile()

    def timed() -> float:
        begin = time.process_time()
        jax.block_until_ready(compiled(scenario, inputs))
        return time.process_time() - begin

    timed()
    return timed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--missions", nargs="*", choices=VARIANTS, default=[*VARIANTS])
    parser.add_argument("--flights", type=int, default=64, help="side by side")
    parser.add_argument(
        "--fast", action="store_true", help="as jentry.setup(fast=True)"
    )
    options = parser.parse_args()
    jentry.setup(1, fast=options.fast)
    print("| mission | variant | flights a second | time of the first |")
    print("|---|---|---|---|")
    for name in options.missions:
        mission = jentry.find_mission(name)
        table = mission.dispersion_table()
        programs = {
            variant: program(mission.scenario(variant), table, options.flights)
            for variant in VARIANTS[name]
        }
        times: dict[str, list[float]] = {variant: [] for variant in programs}
        for _ in range(ROUNDS):
            for variant, timed in programs.items():
                times[variant].append(timed())
        medians = {v: statistics.median(t) for v, t in times.items()}
        first = next(iter(medians.values()))
        for variant, median in medians.items():
            rate, ratio = options.flights / median, median / first
            print(f"| {name} | `{variant}` | {rate:.0f} | {ratio:.1f} |", flush=True)


if __name__ == "__main__":
    main()
