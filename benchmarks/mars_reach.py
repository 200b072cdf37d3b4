"""How near does the predictor-corrector come to what full lift reaches, and in harder air?

Flies the Mars lander with independent coefficients: with all of its lift up all the way,
and under the predictor-corrector in three dimensions, the same draws. Prints the share
that falls short with full lift up, over all and by sets of 1000, the largest miss of those
that do not, and how much nearer full lift brings the others. Then it flies two seeds of a
sixteenth as many through air with waves and another scale height, with errors of the
accelerometers.

    python benchmarks/mars_reach.py --runs 16000

With `--tune` it tunes the memory of the factors in that air instead, in the vertical plane.
"""

import argparse
import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

import jentry
from jentry.missions.mars.air_with_waves import hard_air, hard_air_errors
from jentry.missions.mars.drag_tracking import entry, independent
from jentry.missions.mars.predictor_corrector import guided
from jentry.missions.mars.range_tracking import in_plane
from jentry.tuning import (
    AutomaticDifferentiation,
    Bounds,
    Budget,
    Draws,
    MeanSquare,
    tune,
)
from jentry.units import km


def harder():
    """The scenario in hard air, and its dispersions."""
    return hard_air(guided()), hard_air_errors()


MEMORY = "guidance.estimator.time_constant"


def tuned(runs: int = 256, held_out: int = 1000, steps: int = 12):
    """The memory of the factors (s) in harder air, tuned from 20 s on."""
    scenario, table = harder()
    plane = in_plane(guided())
    memory = lambda s: s.guidance.estimator.time_constant
    law = eqx.tree_at(memory, plane, jnp.asarray(20.0)).guidance
    scenario = eqx.tree_at(lambda s: s.guidance, scenario, law)
    return tune(
        dataclasses.replace(scenario, dynamics=plane.dynamics),
        memory,
        MeanSquare(lambda misses: misses.downrange / km),
        optimistix.LBFGS(rtol=1e-4, atol=1e-6),
        Draws(table, jax.random.key(0), runs=runs, held_out=held_out),
        gradient=AutomaticDifferentiation(forward=True),
        ranges={MEMORY: Bounds(0.1, 100.0)},
        budget=Budget(steps=steps),
    )


def downrange_std(judged):
    """Before and after, with the interval of the change."""
    (found,) = (
        c
        for c in judged.comparisons
        if (c.quantity, c.statistic) == ("downrange", "std")
    )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=16_000)
    parser.add_argument("--tune", action="store_true", help="the memory in harder air")
    options = parser.parse_args()
    jentry.setup()
    if options.tune:
        found = tuned()
        std = downrange_std(found.judgement)
        print(
            f"memory {float(found.values[MEMORY]):.2f} s; downrange, standard deviation "
            f"of other draws: {std.before.value:.0f} m before, {std.after.value:.0f} after"
        )
        return
    key, runs = jax.random.key(0), options.runs
    reached, ended = (
        np.asarray(jentry.monte_carlo(s, independent(), key, runs).misses.downrange)
        for s in (entry(), guided())
    )
    short = reached < 0.0
    sets = [np.mean(one) for one in np.array_split(short, max(1, runs // 1000))]
    print(f"{np.mean(short):.2%} short, {min(sets):.2%} to {max(sets):.2%} of a set")
    print(f"largest miss of the others: {np.max(np.abs(ended[~short])):.1f} m")
    print(f"full lift brings the short {np.max((reached - ended)[short]):.1f} m nearer")
    scenario, table = harder()
    for seed in range(2):
        flown = jentry.monte_carlo(scenario, table, jax.random.key(seed), runs // 16)
        off = np.abs(flown.misses.downrange)
        high = np.percentile(off, 95)
        print(
            f"harder, seed {seed}: 95 % within {high:.0f} m, all within {off.max():.0f}"
        )


if __name__ == "__main__":
    main()
