"""What one prediction of the velocity at the target costs in a batch of flights.

By the network and by the flown model of the CAV-H mission, with and without its derivative
in the shape of the curve, as a law asks for it; and what 500 flights cost with each.

    python benchmarks/velocity_prediction.py
"""

import argparse
import statistics
import time

import jentry


jentry.setup(workers=1)

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

from jentry.campaign.batch import LANES  # noqa: E402
from jentry.campaign.campaign import monte_carlo  # noqa: E402
from jentry.flight.sensing import first_measurement  # noqa: E402
from jentry.guidance import FlownModel  # noqa: E402
from jentry.guidance.bezier.anchoring import Shape  # noqa: E402
from jentry.missions import find_mission  # noqa: E402
from jentry.missions.cav_h.scenario import subdivided  # noqa: E402
from jentry.missions.cav_h.stored_networks import network_predictor  # noqa: E402


def situations():
    """A batch, from entries at other velocities."""
    scenario = subdivided()
    law = scenario.guidance

    def one(velocity):
        start = eqx.tree_at(lambda s: s.velocity, scenario.initial_state, velocity)
        moved = eqx.tree_at(lambda s: s.initial_state, scenario, start)
        held = law.init(first_measurement(moved))[1]
        return law.situation(start, held)

    return law.glide(scenario.constraints), jax.vmap(one)(
        7400.0 + 3.0 * jnp.arange(LANES)
    )


def seconds(function, *arguments, rounds: int) -> float:
    """Median of a call, compiled before."""
    jax.block_until_ready(function(*arguments))
    taken = []
    for _ in range(rounds):
        began = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        taken.append(time.perf_counter() - began)
    return statistics.median(taken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=200)
    rounds = parser.parse_args().rounds
    glide, batch = situations()

    print(f"{'one core, microseconds per flight':36}{'value':>8}{'and slope':>12}")
    for name, predictor in (
        ("network", network_predictor("subdivision")),
        ("flown model, 16 steps", FlownModel(16)),
        ("flown model, 32 steps", FlownModel(32)),
    ):

        def value(situation, predictor=predictor):
            return predictor.predict(glide, situation)

        def slope(situation, value=value):
            def over(second):
                shape = Shape(situation.shape.first, second)
                return value(eqx.tree_at(lambda s: s.shape, situation, shape))

            second = situation.shape.second
            return jax.jvp(over, (second,), (jnp.ones_like(second),))

        costs = [
            1e6 / LANES * seconds(jax.jit(jax.vmap(f)), batch, rounds=rounds)
            for f in (value, slope)
        ]
        print(f"{name:36}{costs[0]:8.2f}{costs[1]:12.2f}")

    mission = find_mission("cav-h")
    print(f"\n{'500 flights':36}{'seconds':>8}")
    for choice in ("stored", "newton-network", "newton"):
        scenario, table = (
            mission.scenario_of(choice),
            mission.dispersion_table("normal"),
        )

        def fly(scenario=scenario, table=table):
            return monte_carlo(scenario, table, jax.random.key(0), 500).flights.time

        print(f"{choice:36}{seconds(fly, rounds=5):8.2f}")


if __name__ == "__main__":
    main()
