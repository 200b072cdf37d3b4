"""How many flights a second under the predictor-corrector, and under the paper's law?

Flies the same dispersed entries of a mission under each, on one core; the programs take
turns. Prints medians of the processor time, flights a second, and ratios.

    python benchmarks/predictor_corrector.py --fast
    python benchmarks/predictor_corrector.py --fast --missions mars-range-tracking
"""

import argparse
import dataclasses
import statistics

import jax
import numpy as np
from costs import program

import jentry
from jentry.campaign.campaign import drawn_inputs


CHOICES = {
    "mars-range-tracking": (
        "range-tracking world in-plane",
        "predictor-corrector world in-plane",
        "predictor-corrector-network world in-plane",
        "range-tracking",
        "predictor-corrector",
        "predictor-corrector-network",
    ),
    "sx-2": ("full", "predictor-corrector"),
    "x-33": ("with-range", "predictor-corrector", "predictor-corrector-limited"),
    "rlv": ("modulation", "predictor-corrector"),
    "cav-h": ("newton", "predictor-corrector"),
}
ROUNDS = 5


def drawn_program(scenario, table, flights):
    """The first dispersed flights of seed 0."""
    inputs = drawn_inputs(scenario, table, jax.random.key(0), np.arange(flights))
    return program(scenario, inputs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--missions", nargs="*", choices=CHOICES, default=[*CHOICES])
    parser.add_argument("--flights", type=int, default=64, help="side by side")
    parser.add_argument(
        "--fast", action="store_true", help="as jentry.setup(fast=True)"
    )
    options = parser.parse_args()
    jentry.setup(1, fast=options.fast)
    print("| mission | flown | flights a second | time of the first |")
    print("|---|---|---|---|")
    for name in options.missions:
        mission = jentry.find_mission(name)
        table = mission.dispersion_table()
        scenarios = {choice: mission.scenario_of(choice) for choice in CHOICES[name]}
        for choice, scenario in list(scenarios.items()):
            if getattr(scenario.guidance, "predicts_limits", False):
                law = dataclasses.replace(scenario.guidance, predicts_limits=False)
                blind = dataclasses.replace(scenario, guidance=law)
                scenarios[f"{choice}, limits not foreseen"] = blind
        programs = {
            choice: drawn_program(scenario, table, options.flights)
            for choice, scenario in scenarios.items()
        }
        times: dict[str, list[float]] = {choice: [] for choice in programs}
        for _ in range(ROUNDS):
            for choice, timed in programs.items():
                times[choice].append(timed())
        medians = {v: statistics.median(t) for v, t in times.items()}
        first = next(iter(medians.values()))
        for choice, median in medians.items():
            rate, ratio = options.flights / median, median / first
            print(f"| {name} | `{choice}` | {rate:.0f} | {ratio:.1f} |", flush=True)


if __name__ == "__main__":
    main()
