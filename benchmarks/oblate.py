"""What does an oblate planet cost: an ellipsoid, and gravity with J2?

Flies dispersed Mars entries on one core, over the sphere of the mission and over an
ellipsoid with J2. The onboard model of the law is the same. Prints medians of the
processor time of a round, the programs interleaved, and the median of their ratios.

    python benchmarks/oblate.py
    python benchmarks/oblate.py --fast
"""

import argparse
import dataclasses
import statistics

import jax
import numpy as np
from costs import program

import jentry
from jentry.campaign.campaign import drawn_inputs


FLIGHTS, ROUNDS = 300, 15


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
    mission = jentry.find_mission("mars-range-tracking")
    sphere, table = mission.scenario(), mission.dispersion_table()
    inputs = drawn_inputs(sphere, table, jax.random.key(0), np.arange(FLIGHTS))
    scenarios = {
        "sphere": sphere,
        "ellipsoid, J2": dataclasses.replace(sphere, planet=oblate(sphere.planet)),
    }
    programs = {name: program(s, inputs) for name, s in scenarios.items()}
    rounds = [[timed() for timed in programs.values()] for _ in range(ROUNDS)]
    ratio = statistics.median(one / other for one, other in rounds)
    print(f"{FLIGHTS} Mars entries, {'fast, ' if options.fast else ''}one core")
    for name, times in zip(programs, zip(*rounds, strict=True), strict=True):
        print(f"{name:16}{1e3 * statistics.median(times):8.1f} ms")
    print(
        f"flights per second over an ellipsoid with J2: {ratio:.3f} of those over a sphere"
    )


if __name__ == "__main__":
    main()
