"""What does the gradient of a 256-flight loss with respect to six gains cost?

Mean square downrange miss of the Mars drag-tracking mission, on one core: the loss alone,
its reverse-mode gradient and its forward-mode gradient. Loss and gradients are computed
chunk by chunk, so that memory does not grow with the number of flights.

    python benchmarks/gradient.py
"""

import argparse
import time

from records import TIMINGS, Cell, save

import jentry


LANES = 64
FLIGHTS = 256


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--step", type=float, default=0.1)
    parser.add_argument("--save", action="store_true", help=f"to {TIMINGS.name}")
    options = parser.parse_args()
    jentry.setup(workers=1)

    import jax
    import jax.numpy as jnp
    import numpy as np

    from jentry.addresses import leaves_by_address, replace_leaves
    from jentry.campaign.dispersions import dispersed_inputs

    mission = jentry.find_mission("mars-drag-tracking")
    scenario = mission.scenario("energy-index")
    inputs = dispersed_inputs(
        scenario, mission.dispersion_table(), jax.random.key(0), jnp.arange(FLIGHTS)
    )
    chunks = jax.tree.map(lambda x: x.reshape(-1, LANES), inputs)
    names = ["gains.epsilon0", "gains.a", "gains.b"]
    names += ["observer.epsilon", "observer.l1", "observer.l2"]
    addresses = [f"guidance.{name}" for name in names]

    def loss_of(solver):
        def miss(gains, inputs):
            given = inputs | dict(zip(addresses, gains, strict=True))
            dispersed = replace_leaves(scenario, given)
            return jentry.misses(dispersed, jentry.fly(dispersed, solver)).downrange

        def loss(gains, chunk):
            misses = jax.vmap(miss, in_axes=(None, 0))(gains, chunk)
            return jnp.mean(misses**2)

        return loss

    def over_chunks(function):
        def total(gains, chunks):
            parts = jax.lax.map(lambda chunk: function(gains, chunk), chunks)
            return jax.tree.map(lambda x: jnp.mean(x, axis=0), parts)

        return jax.jit(total)

    leaves = leaves_by_address(scenario)
    gains = jnp.stack([leaves[address] for address in addresses])
    flown = loss_of(jentry.FixedStep(options.step))
    programs = {
        "loss": over_chunks(flown),
        "reverse": over_chunks(jax.value_and_grad(flown)),
        "forward, 6 tangents": over_chunks(jax.jacfwd(flown)),
    }
    compile_seconds, results = {}, {}
    for name, program in programs.items():
        begin = time.perf_counter()
        programs[name] = program.lower(gains, chunks).compile()
        compile_seconds[name] = time.perf_counter() - begin
        results[name] = jax.block_until_ready(programs[name](gains, chunks))

    seconds = {name: [] for name in programs}
    for _ in range(options.rounds):
        for name, program in programs.items():
            begin = time.perf_counter()
            jax.block_until_ready(program(gains, chunks))
            seconds[name].append(time.perf_counter() - begin)

    base = np.median(seconds["loss"])
    print(f"{FLIGHTS} flights, 6 gains, step {options.step} s, one core", end=", ")
    print(f"jax {jax.__version__}, {jax.devices()[0].device_kind}")
    print(f"{'program':26}{'compile s':>10}{'median ms':>11}{'of the loss':>13}")
    for name, values in seconds.items():
        median = np.median(values)
        print(
            f"{name:26}{compile_seconds[name]:10.1f}{1e3 * median:11.1f}"
            f"{median / base:13.2f}"
        )
    if options.save:
        cells = []
        for name, values in seconds.items():
            median = float(np.median(values))
            row = f"{name} of {FLIGHTS} flights"
            cells += [
                Cell(row, "median, ms", 1e3 * median, 0),
                Cell(row, "least", 1e3 * min(values), 0),
                Cell(row, "largest", 1e3 * max(values), 0),
                Cell(row, "in units of the loss", median / float(base), 1),
            ]
        save(TIMINGS, "gradient", cells)
    forward = results["forward, 6 tangents"]
    worst = np.max(np.abs(results["reverse"][1] / forward - 1.0))
    print(f"reverse against forward: {worst:.1e} relative at worst")


if __name__ == "__main__":
    main()
