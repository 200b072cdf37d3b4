"""How many guided entries per second on one GPU, and against the cores beside it?

    python benchmarks/gpu.py
    python benchmarks/gpu.py --missions mars-drag-tracking --sizes 1000000
    python benchmarks/gpu.py --rehearse

It flies the missions on a GPU and on all cores of the same machine, and prints one table:
what flew (one kernel a flight, or XLA, with the reason), flights a second for each size,
the first call with all that compiles, and how far the ends lie from those of the cores.
Then it takes gradients, and flies the CUDA program of `flights.cu` where there is `nvcc`.
With the usual sizes it takes some minutes; a mission that has no time left is named.
`--rehearse` takes a core in place of the GPU, and few flights: it shows that the program
runs, and measures nothing.

It also prints how long the flights of a block wait for its longest one, which is what any
order of the flights could gain.
"""

import argparse
import ctypes
import functools
import importlib.metadata
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import comparators
import monte_carlo
import numpy as np
from records import processor

import jentry


CHOICES = (
    ("mars-drag-tracking", "energy-index"),
    ("mars-range-tracking", "range-tracking"),
    ("mars-range-tracking", "predictor-corrector"),
    ("mars-range-tracking", "neural"),
    ("cav-h", "newton"),
    ("sx-2", "small-angle"),
    ("rlv", "modulation"),
    ("x-33", "tracking"),
    ("apollo-10", "predictor-corrector"),
    ("cav-h-glide", "predictor-corrector"),
)
"""The missions and laws that are flown"""

KERNEL = "each flight in one kernel"
"""What a campaign says of itself that a kernel has flown"""

ENOUGH_BY_XLA = 16_384
"""Size after which XLA flies no larger one: it needs minutes for a million"""

SECONDS_ON_CORES = 5.0
"""Time that the cores of the machine may fly a mission, about"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--missions", nargs="*", default=[name for name, _ in CHOICES], metavar="NAME"
    )
    sizes = [1_000, 16_384, 131_072, 1_048_576]
    parser.add_argument("--sizes", nargs="*", type=int, default=sizes)
    parser.add_argument("--seconds", type=float, default=420.0, help="for all missions")
    parser.add_argument("--gradient", type=int, default=65_536, help="flights")
    parser.add_argument(
        "--rehearse", action="store_true", help="on a core, few flights"
    )
    options = parser.parse_args()
    jentry.setup(device=None if options.rehearse else "gpu")

    import jax

    from jentry import _devices

    if options.rehearse:
        options.sizes, options.gradient = [16, 40], 16
        gpu = _devices.Gpu(jax.devices("cpu")[0], "c")
        _devices.gpu = lambda: gpu
    else:
        gpu = _devices.gpu()
    versions = (f"{n} {importlib.metadata.version(n)}" for n in ("jentry", "jax"))
    print(f"{gpu.name}; {processor()}; {', '.join(versions)}\n")
    until = time.perf_counter() + options.seconds
    for name, law in CHOICES:
        if name not in options.missions:
            continue
        if time.perf_counter() > until:
            print(f"{name}, {law}: no time left; --seconds gives more")
            continue
        print_mission(name, law, options.sizes)
    print_gradients(gpu, options.gradient)
    print_cuda(options.sizes, options.rehearse)


def flown(scenario, table, runs: int, device: str):
    """A campaign on a device, and the seconds it took."""
    from jentry import _devices

    _devices.choose(device)
    begin = time.perf_counter()
    campaign = jentry.monte_carlo(scenario, table, 0, runs)
    return campaign, time.perf_counter() - begin


def print_mission(name: str, law: str, sizes: list[int]) -> None:
    """Flights a second on both, and how far their ends lie apart."""
    mission = jentry.find_mission(name)
    scenario = mission.scenario(law)
    table = mission.dispersion_table()
    _, first_on_cores = flown(scenario, table, sizes[0], "cpu")
    few, seconds = flown(scenario, table, sizes[0], "cpu")
    rate = sizes[0] / seconds
    runs = int(min(max(rate * SECONDS_ON_CORES, sizes[0]), sizes[-1]))
    on_cores, seconds = (
        (few, seconds) if runs == sizes[0] else flown(scenario, table, runs, "cpu")
    )
    cores = runs / seconds
    print(f"{name}, {law}: cores {cores:,.0f} flights/s, first {first_on_cores:.1f} s")
    first = None
    for size in sizes:
        try:
            found, begun = flown(scenario, table, size, "gpu")
            found, seconds = flown(scenario, table, size, "gpu")
        except Exception as error:  # the other missions are flown all the same
            print(f"  {size:>9,}: {type(error).__name__}: {str(error)[:200]}\n")
            return
        if first is None:
            first = begun
            print(f"  {found.flown_on[:300]}; first {first:.1f} s")
        print(
            f"  {size:>9,} flights: {size / seconds:>12,.0f}/s, "
            f"{size / seconds / cores:6.1f} times the cores"
        )
        if size >= ENOUGH_BY_XLA and KERNEL not in found.flown_on:
            break
    if KERNEL in found.flown_on:
        print_kernel_alone(scenario, table, sizes[-1], cores)
    print_apart(found, on_cores)


def print_kernel_alone(scenario, table, runs: int, cores: float) -> None:
    """Flights a second of the kernel that flew last, from arrays on the GPU to others."""
    import jax

    from jentry import _devices
    from jentry.campaign import on_gpu
    from jentry.campaign.campaign import drawn_inputs

    kernel = next(reversed(on_gpu._KERNELS.values()))
    drawn = timed(
        lambda: drawn_inputs(scenario, table, jax.random.key(0), np.arange(runs))
    )
    inputs = drawn_inputs(scenario, table, jax.random.key(0), np.arange(runs))
    seconds = timed(kernel, jax.device_put(inputs, _devices.gpu().device))
    print(
        f"  {runs:>9,} flights: {runs / seconds:>12,.0f}/s, "
        f"{runs / seconds / cores:6.1f} times the cores, by the kernel alone; "
        f"draws {drawn:.3f} s"
    )


def print_apart(found, expected) -> None:
    """How many outcomes differ, and the largest distance of the ends."""
    count = min(len(found.runs), len(expected.runs))
    other = found.flights.outcome[:count] != expected.flights.outcome[:count]
    apart = [
        np.abs(getattr(found.misses, x)[:count] - getattr(expected.misses, x)[:count])
        for x in ("downrange", "crossrange", "altitude")
    ]
    largest = np.max(np.where(other, 0.0, np.max(apart, axis=0)))
    far = int(np.sum(np.max(apart, axis=0) > 1e-4))
    times = expected.flights.time[: count // 32 * 32].reshape(-1, 32)
    waits = np.mean(times.max(1)) / np.mean(times) - 1.0
    print(
        f"  of {count:,} flights {int(np.sum(other))} have another outcome, {far} end more "
        f"than 0.1 mm off, the farthest {largest:.2g} m; flights of a block of 32 wait "
        f"{waits:.1%}\n"
    )


def print_gradients(gpu, flights: int) -> None:
    """Reverse gradient and six tangents of a loss, in times of the loss."""
    import jax
    import jax.numpy as jnp

    from jentry.addresses import leaves_by_address, replace_leaves
    from jentry.campaign.campaign import drawn_inputs
    from jentry.kernel import NotInKernel, kernel_of, with_tangents

    mission = jentry.find_mission("mars-drag-tracking")
    scenario = mission.scenario("energy-index")
    names = ["gains.epsilon0", "gains.a", "gains.b"]
    names += ["observer.epsilon", "observer.l1", "observer.l2"]
    addresses = [f"guidance.{name}" for name in names]
    leaves = leaves_by_address(scenario)
    gains = jnp.stack([leaves[address] for address in addresses])
    table = mission.dispersion_table()
    inputs = drawn_inputs(scenario, table, jax.random.key(0), np.arange(flights))
    gains, inputs = jax.device_put((gains, inputs), gpu.device)

    def miss(gains, inputs):
        given = inputs | dict(zip(addresses, gains, strict=True))
        dispersed = replace_leaves(scenario, given)
        return jentry.misses(dispersed, jentry.fly(dispersed)).downrange

    def loss(gains, inputs):
        return jnp.mean(jax.vmap(miss, (None, 0))(gains, inputs) ** 2)

    programs = {
        "loss": loss,
        "reverse gradient": jax.value_and_grad(loss),
        "six tangents": jax.jacfwd(loss),
    }
    seconds = {n: timed(jax.jit(f), gains, inputs) for n, f in programs.items()}
    print(f"gradients of {flights:,} flights by XLA: loss {seconds['loss']:.3f} s")
    for name in list(programs)[1:]:
        print(f"  {name}: {seconds[name] / seconds['loss']:.2f} times the loss")
    push = with_tangents(lambda run: miss(*run))
    same = lambda x: jnp.broadcast_to(x, (flights, *x.shape))
    zeros = jax.tree.map(lambda x: jnp.zeros((flights, 6)), inputs)
    given = (same(gains), inputs), (same(jnp.eye(6)), zeros)
    one = jax.tree.map(lambda x: x[0], given)
    try:
        value = kernel_of(lambda run: miss(*run), one[0], form=gpu.form)
        pushed = kernel_of(push, one, form=gpu.form)
    except NotInKernel as error:
        print(f"  six tangents in the kernel: a flight {error}\n")
        return
    alone, both = timed(value, given[0]), timed(pushed, given)
    print(
        f"  in the kernel: {alone:.4f} s, with six tangents {both / alone:.2f} times that\n"
    )


def timed(function, *given) -> float:
    """Median of the seconds of three calls, after one that compiles."""
    import jax

    jax.block_until_ready(function(*given))
    taken = []
    for _ in range(3):
        begin = time.perf_counter()
        jax.block_until_ready(function(*given))
        taken.append(time.perf_counter() - begin)
    return float(np.median(taken))


@functools.cache
def cuda_program():
    """`flights.cu`, compiled into a folder that is gone afterwards; None without `nvcc`."""
    compiler = shutil.which("nvcc")
    if compiler is None:
        return None
    source = Path(__file__).with_name("flights.cu")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "flights.so"
        flags = "-O3", "-shared", "-arch=sm_90", "-Xcompiler", "-fPIC"
        subprocess.run([compiler, *flags, source, "-o", library], check=True)
        return ctypes.CDLL(str(library))


def print_cuda(sizes: list[int], on_host: bool) -> None:
    """The flights of `mars-drag-tracking` by a program in CUDA, and how far it is off."""
    program = cuda_program()
    if program is None:
        print("flights.cu: there is no nvcc here")
        return
    mission, reference = monte_carlo.in_own_process(monte_carlo.jentry_mission)
    inputs = monte_carlo.draw_inputs(max(sizes[-1], 64))
    shared = (
        np.array(mission, float),
        np.array(comparators.plan(mission, reference), float),
    )
    rows = comparators._rows_for_c(reference)
    lift, drag = map(np.ascontiguousarray, comparators.force_factors(mission, **inputs))
    few = {name: x[:64] for name, x in inputs.items()}
    expected = np.array(comparators.c_flights(mission, reference, **few))
    place = lambda x: ctypes.c_void_p(x.ctypes.data)
    for size in [64] if on_host else sizes:
        out, seconds = np.empty((4, size)), ctypes.c_double()
        given = [*map(place, (*shared, rows))]
        flights = [*map(place, (lift, drag)), ctypes.c_long(size), ctypes.c_double(0.1)]
        if on_host:
            code = program.fly_host(*given, *flights, place(out))
        else:
            given.append(ctypes.c_long(len(rows)))
            ends = ctypes.c_int(128), place(out), ctypes.byref(seconds)
            code = program.fly_gpu(*given, *flights, *ends)
        if code:
            print(f"flights.cu: error {code} of CUDA")
            return
        count = min(size, 64)
        off = np.max(np.abs(out[1:3, :count] - expected[1:3, :count]))
        rate = "" if on_host else f"{size / seconds.value:,.0f}/s, "
        print(f"flights.cu, {size:,} flights: {rate}{off:.2g} m from flights.c")


if __name__ == "__main__":
    main()
