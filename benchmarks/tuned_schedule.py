"""Tune the gain schedule of SX-2 by gradient: what is in `benchmarks/tuned-sx-2.toml`.

    python benchmarks/tuned_schedule.py --save benchmarks/tuned-sx-2.toml

The eigenvalues of `jentry.guidance.ScheduledEigenvalues`, 42 numbers, on initial errors
combined, drawn anew at each step, for the fourth-power mean of the radial miss and a
penalty on what is near the zero pair. What is found is judged on sets of draws that tuning
has not seen, by the step that the mission flies with; the tuning flies with a longer one.
"""

import argparse
import dataclasses

import jax
import numpy as np
import optax

import jentry
from jentry.guidance import GroundTrackTracking, ScheduledEigenvalues
from jentry.missions.sx_2.tuning import MissAndZeros, ends, zero_pair
from jentry.tuning import Budget, Draws, Record, tune
from jentry.units import nautical_mile


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=100, help="of Adam")
    parser.add_argument("--rate", type=float, default=0.1, help="of learning, at first")
    parser.add_argument("--runs", type=int, default=256, help="at each step")
    parser.add_argument("--step", type=float, default=2.0, help="of integration, s")
    parser.add_argument("--held-out", type=int, default=2000)
    parser.add_argument("--seeds", type=int, default=5, help="sets to judge by")
    parser.add_argument("--course", help="file from which the same call resumes")
    parser.add_argument("--save", help="file for the tuned schedule")
    options = parser.parse_args()
    jentry.setup()

    mission = jentry.find_mission("sx-2")
    scenario = mission.scenario("scheduled")
    errors = mission.dispersion_table("initial-errors")
    law = scenario.guidance
    assert isinstance(law, GroundTrackTracking)

    def build(gains: ScheduledEigenvalues) -> jentry.Scenario:
        return dataclasses.replace(
            scenario, guidance=dataclasses.replace(law, gains=gains)
        )

    def report(entries, best):
        last = entries[-1]
        print(
            f"{len(entries):4} loss {last.loss:.4f}, slope {last.gradient_norm:.3f}, "
            f"{last.seconds:.0f} s",
            flush=True,
        )

    assert isinstance(law.gains, ScheduledEigenvalues)
    tuned = tune(
        law.gains,
        lambda gains: (gains.downrange, gains.crossrange),
        MissAndZeros(zero_pair(scenario)),
        optax.adam(optax.cosine_decay_schedule(options.rate, options.steps)),
        Draws(errors, jax.random.key(0), options.runs, options.held_out, fresh=True),
        build=build,
        outputs=ends,
        solver=jentry.FixedStep(options.step),
        budget=Budget(options.steps, patience=options.steps),
        record=Record(options.course, report=report),
    )
    if options.save:
        tuned.save(options.save, law="scheduled", dispersions="initial-errors")
    # The key of the tuning is 0.
    for seed in range(1, options.seeds + 1):
        key = jax.random.key(seed)
        found = jentry.monte_carlo(tuned.scenario, errors, key, options.held_out)
        miss = np.hypot(found.misses.downrange, found.misses.crossrange) / nautical_mile
        print(f"seed {seed}: 50, 90, 99 % and largest", end=" ")
        print(np.round([*np.percentile(miss, [50, 90, 99]), miss.max()], 3), "n mile")


if __name__ == "__main__":
    main()
