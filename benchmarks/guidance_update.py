"""How long does the X-33's regulator take, solved in flight for the horizon that is left?

Prints the milliseconds for each flight of a batch, whose flights are at different times:
matrices built and solved, by median over rounds.

    python benchmarks/guidance_update.py --batch 256
"""

import argparse
import statistics
import time

import equinox as eqx
import jax
import jax.numpy as jnp

import jentry
from jentry.missions.x_33.scenario import reference, regulator


@eqx.filter_jit
def plans(regulated, times):
    return jax.vmap(lambda t: regulated.plans(t).controls)(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    jentry.setup()
    flown = reference()
    for with_range in (False, True):
        regulated = regulator(flown, with_range)
        times = jnp.linspace(0.0, 0.95 * flown.ends[-1], options.batch)
        jax.block_until_ready(plans(regulated, times))
        taken = []
        for _ in range(options.rounds):
            begin = time.perf_counter()
            jax.block_until_ready(plans(regulated, times))
            taken.append(time.perf_counter() - begin)
        each = 1e3 * statistics.median(taken) / options.batch
        print(f"{4 if with_range else 3} states: {each:.3f} ms a flight")


if __name__ == "__main__":
    main()
