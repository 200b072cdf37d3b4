"""What do parts of a flight cost that could be left out, or computed in another way?

Flies dispersed Mars entries on one core, as they are and with one thing changed. Of drag
tracking in a plane:

- the rates of the drag by forward differentiation (`twice_along`) in place of equations
  (8), (9) and (11), which `jentry/guidance/drag_tracking.py` keeps,
- the peak of one constraint located in time (`Scenario.located_peaks`).

Of range tracking in three dimensions, with the same onboard model:

- an ellipsoid and gravity with J2 in place of a sphere,
- position and velocity integrated as vectors (`VectorDynamics`) in place of angles.

Prints medians of the processor time of a round, the programs interleaved, and the median of
their ratios to the flights as they are.

    python benchmarks/costs.py
    python benchmarks/costs.py --fast
"""

import argparse
import dataclasses
import statistics
import time
from collections.abc import Callable
from unittest import mock

import equinox as eqx
import jax
import numpy as np

import jentry
from jentry.addresses import replace_leaves
from jentry.campaign.campaign import drawn_inputs
from jentry.guidance import drag_tracking


FLIGHTS, ROUNDS = 200, 15

Timed = Callable[[], float]
"""A program; a call gives its processor time, s"""


def program(scenario, inputs) -> Timed:
    """All flights, compiled."""
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


def drawn(name: str, law: str):
    """Scenario of a mission and the inputs of its flights."""
    mission = jentry.find_mission(name)
    scenario, table = mission.scenario(law), mission.dispersion_table()
    inputs = drawn_inputs(scenario, table, jax.random.key(0), np.arange(FLIGHTS))
    return scenario, inputs


def drag_tracking_in_a_plane() -> dict[str, Timed]:
    scenario, inputs = drawn("mars-drag-tracking", "energy-index")
    located = dataclasses.replace(scenario, located_peaks=("drag",))
    programs = {"as it is": program(scenario, inputs)}
    with mock.patch.object(drag_tracking, "_is_of_the_paper", lambda model: False):
        programs["rates by differentiation"] = program(scenario, inputs)
    return programs | {"one peak located": program(located, inputs)}


def range_tracking_in_space() -> dict[str, Timed]:
    scenario, inputs = drawn("mars-range-tracking", "range-tracking")
    over = dataclasses.replace(scenario, planet=oblate(scenario.planet))
    vectors = dataclasses.replace(scenario, dynamics=jentry.VectorDynamics())
    return {
        "as it is": program(scenario, inputs),
        "over an ellipsoid, with J2": program(over, inputs),
        "as vectors": program(vectors, inputs),
    }


def oblate(planet: jentry.Planet) -> jentry.Planet:
    """The planet with the shape and the J2 of Mars, and its own size and mass."""
    gravity = planet.gravity
    assert isinstance(gravity, jentry.InverseSquareGravity)
    return dataclasses.replace(
        planet,
        shape=jentry.Ellipsoid(planet.radius, 1 / 169.894447),
        gravity=jentry.ZonalGravity(
            gravity.gravitational_parameter, planet.radius, {"j2": 1.9566e-3}
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--fast", action="store_true", help="as jentry.setup(fast=True)"
    )
    options = parser.parse_args()
    jentry.setup(1, fast=options.fast)
    for group in (drag_tracking_in_a_plane, range_tracking_in_space):
        programs = group()
        rounds = [[timed() for timed in programs.values()] for _ in range(ROUNDS)]
        title = group.__name__.replace("_", " ")
        print(f"{FLIGHTS} Mars entries, {title}, {'fast, ' * options.fast}one core")
        for name, times in zip(programs, zip(*rounds, strict=True), strict=True):
            ratio = statistics.median(
                t / first for t, (first, *_) in zip(times, rounds, strict=True)
            )
            median = 1e3 * statistics.median(times)
            print(f"  {name:27}{median:8.1f} ms{ratio:8.3f}")


if __name__ == "__main__":
    main()
