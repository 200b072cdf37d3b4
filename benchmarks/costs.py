"""What do parts of the flight loop cost that could be computed in another way?

Flies 200 dispersed Mars entries on one core, as they are and with one thing changed:

- the rates of the drag by forward differentiation (`twice_along`) in place of equations
  (8), (9) and (11), which `jentry/guidance/drag_tracking.py` keeps,
- the peak of one constraint located in time (`Scenario.located_peaks`).

Prints medians of the processor time, the programs interleaved, and their ratios.

    python benchmarks/costs.py
    python benchmarks/costs.py --fast
"""

import argparse
import dataclasses
import statistics
import time
from unittest import mock

import equinox as eqx
import jax
import numpy as np

import jentry
from jentry.addresses import replace_leaves
from jentry.campaign.campaign import drawn_inputs
from jentry.guidance import drag_tracking


FLIGHTS, ROUNDS = 200, 15


def program(scenario, inputs):
    """All flights, compiled; a call gives its processor time, s."""
    jax.clear_caches()  # nothing that was traced for another program

    @eqx.filter_jit
    def ends(scenario, inputs):
        def end(values):
            flight = jentry.fly(replace_leaves(scenario, values))
            return flight.time, flight.peaks, flight.at_peaks

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
    parser.add_argument(
        "--fast", action="store_true", help="as jentry.setup(fast=True)"
    )
    options = parser.parse_args()
    jentry.setup(1, fast=options.fast)
    mission = jentry.find_mission("mars-drag-tracking")
    scenario, table = mission.scenario("energy-index"), mission.dispersion_table()
    inputs = drawn_inputs(scenario, table, jax.random.key(0), np.arange(FLIGHTS))
    located = dataclasses.replace(scenario, located_peaks=("drag",))
    programs = {"as it is": program(scenario, inputs)}
    with mock.patch.object(drag_tracking, "_is_of_the_paper", lambda model: False):
        programs["rates by differentiation"] = program(scenario, inputs)
    programs["one peak located"] = program(located, inputs)
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(ROUNDS):
        for name, timed in programs.items():
            seconds[name].append(timed())
    usual = statistics.median(seconds["as it is"])
    print(f"{FLIGHTS} Mars entries, {'fast, ' if options.fast else ''}one core")
    for name, times in seconds.items():
        median = statistics.median(times)
        print(f"{name:26}{1e3 * median:8.1f} ms{median / usual:8.3f}")


if __name__ == "__main__":
    main()
