"""How near the RLV's drag can be kept to its reference where what is sensed is noisy.

    python benchmarks/drag_noise.py --sets 3

Of `lag-inverted-fast` with an attitude of 3 rad/s and noise, in its guidance cycles of
0.05 s and in longer ones. The drag a flight
would have with its angle of attack on the reference, less that of the reference, is what a
law has to take off: the disturbance w. A linear law adds to it its own answer g to all
samples so far, of disturbance and noise: at sample k the drag error is

    e[k] = w[k] - sum over j >= 1 of g[j] (w[k - j] + n[k - j]),  n white.

For each cycle three rows: the law as flown; the law in this model, frozen, with an effect
of the angle of attack that is known exactly (its standard deviation is that of a linear
covariance); and the best g that L-BFGS finds, of whatever order: with the fewest samples of
noisy flights that leave 0.7e-3 g, of all that follow a disturbance of constant rate and
remember 12 s. All else that limits a law is left out, such as the limits of the attitude,
an effect that is not known, and the damping. Below, how many flights of two laws are
lost, also with wider dispersions.
"""

import argparse
import dataclasses

import jentry


jentry.setup()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jax.scipy.special import logsumexp  # noqa: E402
from jax.scipy.stats import norm  # noqa: E402
from scipy.interpolate import CubicSpline  # noqa: E402
from scipy.linalg import expm  # noqa: E402
from scipy.optimize import minimize  # noqa: E402

from jentry.campaign.campaign import drawn_inputs  # noqa: E402
from jentry.campaign.dispersions import scaled_dispersions  # noqa: E402
from jentry.campaign.distributions import Normal  # noqa: E402
from jentry.flight import has_end  # noqa: E402
from jentry.guidance.composition import compose  # noqa: E402
from jentry.guidance.cycle import FixedCycle  # noqa: E402
from jentry.missions.rlv.scenario import CYCLE, JUDGED_BELOW, plan  # noqa: E402
from jentry.units import standard_gravity  # noqa: E402


BAR = 0.7e-3
"""Largest drag error that is asked for, g"""
FLIGHTS = 500
SAMPLE_TIME = 0.4
"""s: of the disturbances, which are splines in between"""
LONGEST = 12.0
"""s: of what the best law remembers"""


def in_cycles(period: float) -> jentry.Scenario:
    """`lag-inverted-fast` in cycles of a period (s)."""
    scenario = jentry.find_mission("rlv").scenario_of(
        "lag-inverted-fast world attitude-3 world noise"
    )
    law = scenario.guidance
    sampled = compose(
        dataclasses.replace(law.angle_of_attack, cycle=FixedCycle(period)),
        jentry.Sampled(law.bank.law, period),
        law.limits,
    )
    return dataclasses.replace(scenario, guidance=sampled)


def inputs(scenario: jentry.Scenario, seed: int, runs: int) -> dict[str, np.ndarray]:
    table = jentry.find_mission("rlv").dispersion_table("table-1-noise")
    return drawn_inputs(scenario, table, jax.random.key(seed), np.arange(runs))


def disturbances(scenario, seed: int, flights: int) -> list[tuple[np.ndarray, ...]]:
    """Of each flight without noise: times (s), disturbances (g), velocities (m/s)."""
    given = inputs(scenario, seed, flights)
    given["accelerometers.noise"] = np.zeros(flights)
    history = jentry.monte_carlo(
        scenario, inputs=given, history=SAMPLE_TIME
    ).flights.history
    assert history is not None
    found = []
    for row in range(flights):
        velocity = np.asarray(history.states.velocity[row])
        judged = velocity < scenario.guidance.angle_of_attack.gate.velocity
        velocity = velocity[judged]
        angle = np.asarray(history.controls.angle_of_attack[row])[judged]
        drag = np.asarray(history.constraints["drag"][row])[judged]
        wanted = jax.vmap(plan().over_index)(jnp.asarray(velocity))
        there, reference = wanted["angle_of_attack"][0], wanted["drag"][0]
        coefficient = jax.vmap(lambda a: scenario.vehicle.coefficients(a, 1.0, 1.0)[1])
        share = coefficient(there) / coefficient(jnp.asarray(angle))
        off = np.asarray((drag * share - reference) / standard_gravity)
        found.append((np.asarray(history.time[row])[judged], off - off[0], velocity))
    return found


def answer_of_the_law(scenario, period: float, count: int) -> np.ndarray:
    """g of the paper's law with its lag inverted, in the time, frozen; shape (count,).

    In units in which an angle of attack is a drag: u'' = v, the law's own states are u, u',
    xi2bar and dbar of (40), (41), the sample is on a straight line over a cycle.
    """
    law, response = (
        scenario.guidance.angle_of_attack,
        scenario.attitude.angle_of_attack_response,
    )
    slows = law.gains.scheduled_at / law.domain.circular_velocity
    frequency = float(law.gains.frequency * slows)
    pole = float(law.gains.observer_pole * slows)
    across = 2.0 * float(law.gains.damping) * frequency
    tau1, tau2 = 2.0 * pole, pole * pole
    v = np.array([0.0, 0.0, -across, -1.0])
    v_sample = -across * tau1 - frequency**2 - tau2
    rates = np.zeros((6, 6))  # u, u', xi2bar, dbar, the sample and its rate
    rates[0, 1] = rates[4, 5] = 1.0
    rates[1, :4], rates[1, 4] = v, v_sample
    rates[2, 2], rates[2, 4] = -across - tau1, -(across + tau1) * tau1 - frequency**2
    rates[3, 2], rates[3, 4] = -tau2, -tau2 * tau1
    over = expm(rates * period)[:4]
    from_last = over[:, 4] - over[:, 5] / period
    from_this = over[:, 5] / period
    w, damping = float(response.frequency), float(response.damping)
    lead = v / w**2 + np.array([1.0, 2.0 * damping / w, 0.0, 0.0])
    attitude = np.zeros((3, 3))
    attitude[0, 1], attitude[1] = 1.0, [-w * w, -2.0 * damping * w, w * w]
    follows = expm(attitude * period)[:2]
    # Angle, its rate, the law's four, the last sample.
    step, push = np.zeros((7, 7)), np.zeros(7)
    step[2:6, 2:6], step[2:6, 6] = over[:, :4], from_last
    step[2:6, 0], step[6, 0] = from_this, 1.0
    push[2:6], push[6] = from_this, 1.0
    commanded, pushed = lead @ step[2:6], lead @ push[2:6] + v_sample / w**2
    commanded[0] += v_sample / w**2
    step[:2] = np.outer(follows[:, 2], commanded)
    step[:2, :2] += follows[:, :2]
    push[:2] = follows[:, 2] * pushed
    found, state = [], push
    for _ in range(count):
        found.append(-state[0])
        state = step @ state
    return np.array(found)


class Linear:
    """Flights of a linear law: disturbances of shape (flights, samples), in g."""

    def __init__(self, found, period: float, noise: float):
        resampled = []
        for time, off, velocity in found:
            at = np.arange(time[0], time[-1], period)
            resampled.append(
                (CubicSpline(time, off)(at), np.interp(at, time, velocity))
            )
        longest = max(len(off) for off, _ in resampled)
        fill = lambda x, value: np.pad(x, (0, longest - len(x)), constant_values=value)
        self.off = jnp.stack([fill(off, 0.0) for off, _ in resampled])
        velocity = np.stack([fill(v, np.inf) for _, v in resampled])
        self.judged = jnp.asarray(velocity < JUDGED_BELOW)
        self.noise, self.count = noise, round(LONGEST / period)

    def answered(self, g, samples):
        """What a law adds to samples, of shape (flights, samples)."""
        length = samples.shape[1]
        size = length + self.count
        late = jnp.concatenate([jnp.zeros(1), g])
        spectrum = jnp.fft.rfft(samples, size) * jnp.fft.rfft(late, size)
        return -jnp.fft.irfft(spectrum, size)[:, :length]

    def beyond(self, g):
        """Logarithm of the expected number of samples beyond the bar in all flights."""
        error = jnp.abs(self.off + self.answered(g, self.off))
        deviation = self.noise * jnp.sqrt(jnp.sum(g * g))
        tails = norm.logcdf((error - BAR) / deviation)
        return logsumexp(jnp.where(self.judged, tails, -jnp.inf))

    def best(self, start):
        """The g with the fewest samples beyond the bar; it takes off a constant rate."""
        # A disturbance may go on as it goes: sum of g = 1, sum of k g = 0.
        k = np.arange(1.0, self.count + 1.0)
        conditions = np.stack([np.ones_like(k), k])
        one = np.linalg.lstsq(conditions, np.array([1.0, 0.0]), rcond=None)[0]
        free = np.linalg.svd(conditions)[2][2:]
        value = jax.jit(jax.value_and_grad(lambda y: self.beyond(one + free.T @ y)))
        numbers = lambda y: tuple(map(np.asarray, value(jnp.asarray(y))))
        options = {"maxiter": 2000, "ftol": 1e-10, "gtol": 1e-6, "maxcor": 30}
        first = free @ (start - one)
        found = minimize(numbers, first, jac=True, method="L-BFGS-B", options=options)
        return one + free.T @ found.x

    def peaks(self, g, seed: int) -> np.ndarray:
        """Largest error of each of 500 flights with noise, g."""
        generator = np.random.default_rng(seed)
        sets = []
        for _ in range(-(-FLIGHTS // len(self.off))):
            sensed = self.off + self.noise * generator.standard_normal(self.off.shape)
            error = np.abs(self.off + self.answered(g, sensed))
            sets.append(np.max(np.where(self.judged, error, 0.0), axis=1))
        return np.concatenate(sets)[:FLIGHTS]


def lost(choice: str, seed: int, wider: float) -> int:
    """How many of 500 flights come to more than 1 g of drag error, or to no end, with
    normal dispersions so many times as wide: the attitude has met its limits."""
    mission = jentry.find_mission("rlv")
    table = mission.dispersion_table("table-1-noise")
    normal = {n: d for n, d in table.items() if isinstance(d.distribution, Normal)}
    table = {**table, **scaled_dispersions(normal, wider)}
    key = jax.random.key(seed)
    flown = jentry.monte_carlo(mission.scenario_of(choice), table, key, FLIGHTS).flights
    far = np.asarray(flown.peaks["drag_deviation"]) > 1.0
    return int(np.sum(far | ~np.asarray(has_end(flown.outcome))))


def row(name: str, deviation: float | None, sets: list[np.ndarray]) -> None:
    spread = "" if deviation is None else f"{1e3 * deviation:.3f}"
    median = 1e3 * np.median(np.concatenate(sets))
    largest = ", ".join(f"{1e3 * np.max(peaks):.2f}" for peaks in sets)
    print(f"{name:40}{spread:>10}{median:>9.2f}   {largest}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=3, help="of 500 flights")
    parser.add_argument("--disturbances", type=int, default=64, help="that are flown")
    options = parser.parse_args()
    found = disturbances(in_cycles(CYCLE), 0, options.disturbances)
    print(f"{'drag error, 1e-3 g':40}{'noise, std':>10}{'median':>9}   largest of 500")
    for period in (0.05, 0.1, 0.2):
        scenario = in_cycles(period)
        noise = float(scenario.accelerometers.noise) / standard_gravity
        model = Linear(found, period, noise)
        law = answer_of_the_law(scenario, period, model.count)
        seeds = range(1, options.sets + 1)
        flown = [
            jentry.monte_carlo(scenario, inputs=inputs(scenario, seed, FLIGHTS))
            for seed in seeds
        ]
        peaks = [np.asarray(f.flights.peaks["drag_deviation"]) for f in flown]
        row(f"cycles of {period} s, flown", None, peaks)
        for name, g in (("linear, frozen", law), ("best linear law", model.best(law))):
            deviation = noise * float(np.sqrt(np.sum(g * g)))
            row(f"    {name}", deviation, [model.peaks(g, seed) for seed in seeds])
    print(f"flights lost, of {options.sets} sets of {FLIGHTS}")
    for wider in (1.0, 1.4):
        for choice in (
            "lag-inverted world attitude-3 world noise",
            "lag-inverted-fast world attitude-3 world noise",
        ):
            counts = [lost(choice, seed, wider) for seed in seeds]
            name = f"{choice}, dispersions {wider} times as wide"
            print(f"{name:50}{', '.join(map(str, counts))}", flush=True)


if __name__ == "__main__":
    main()
