"""Draws have their distribution, depend on key, name and run alone, and reach leaves."""

import dataclasses
import functools
import math
import types
import zlib

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from first_sets import small_batches
from helpers import choices, mars_scenario, observer_law
from scipy import special, stats

from jentry.addresses import leaves_by_address
from jentry.campaign import (
    Discrete,
    Dispersion,
    Normal,
    OneOfSeveral,
    TruncatedNormal,
    Uniform,
    add,
    disperse,
    draw,
    monte_carlo,
    multiply,
)
from jentry.campaign.description import describe
from jentry.campaign.dispersions import (
    check_dispersions,
    dispersed_inputs,
    key_of,
    scaled_dispersions,
)
from jentry.campaign.distributions import Constant
from jentry.flight.scenario import check
from jentry.guidance import BankProfile, Sampled
from jentry.missions import ALL
from jentry.onboard import Accelerometers, FlowSensors


DRAWS = 40_000

# Each beside scipy's; it counts the bounds of a truncated normal in deviations.
DISTRIBUTIONS = {
    "normal": (Normal(3.0, 0.5), stats.norm(3.0, 0.5)),
    "uniform": (Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
    "truncated": (
        TruncatedNormal(10.0, 2.0, 8.0, 14.0),
        stats.truncnorm(-1.0, 2.0, 10.0, 2.0),
    ),
}

sample_of = jax.jit(lambda d, keys: jax.vmap(d.sample)(keys))

mass = lambda s: s.vehicle.mass
density = lambda s: s.planet.density_scale


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_moments_and_bounds(name, key):
    distribution, reference = DISTRIBUTIONS[name]
    deviation = reference.std()
    lower, upper = reference.support()
    sample = jax.jit(jax.vmap(distribution.sample))(jax.random.split(key, DRAWS))
    # Four standard errors; that of a deviation is below that of the mean here.
    error = 4.0 * deviation / np.sqrt(DRAWS)
    assert sample.mean() == pytest.approx(reference.mean(), abs=error)
    assert sample.std() == pytest.approx(deviation, abs=error)
    assert lower <= sample.min() and sample.max() <= upper
    assert sample.dtype == jnp.float64
    # Of 53 bits all are drawn: no two of some ten thousand numbers are equal.
    assert len(np.unique(sample)) == DRAWS


def threefry(key, counts):
    """Threefry-2x32 of 20 rounds, after J. K. Salmon et al., "Parallel Random Numbers: As
    Easy as 1, 2, 3", 2011: two words of a counter enciphered by two words of a key."""
    mask, (first, second), (x, y) = 0xFFFFFFFF, key, counts
    keys = first, second, first ^ second ^ 0x1BD11BDA
    x, y = (x + first) & mask, (y + second) & mask
    rotations = (13, 15, 26, 6), (17, 29, 16, 24)
    for group in range(5):
        for turn in rotations[group % 2]:
            x = (x + y) & mask
            y = ((y << turn | y >> 32 - turn) & mask) ^ x
        x = (x + keys[(group + 1) % 3]) & mask
        y = (y + keys[(group + 2) % 3] + group + 1) & mask
    return x, y


def test_the_cipher_is_threefry():
    """The known answers of the authors' library, Random123."""
    ones = 0xFFFFFFFF, 0xFFFFFFFF
    assert threefry((0, 0), (0, 0)) == (0x6B200159, 0x99BA4EFE)
    assert threefry(ones, ones) == (0x1CB996FC, 0xBB002BE7)
    digits = threefry((0x13198A2E, 0x03707344), (0x243F6A88, 0x85A308D3))
    assert digits == (0xC4923A9C, 0x483DF7A0)


def expected_share(seed, name, run):
    """Of the unit interval, what a run draws: seed, checksum of the name and run, each
    enciphered by what came before; then 52 bits of a word of 64."""
    key = seed >> 32, seed & 0xFFFFFFFF
    for number in (zlib.crc32(name.encode()), run):
        key = threefry(key, (0, number))
    high, low = threefry(key, (0, 0))
    return ((high << 32 | low) >> 12) * 2.0**-52


@pytest.mark.parametrize("seed", [0, 7, 2**40 + 3])
def test_draws_are_what_they_have_always_been(seed):
    """A campaign of a seed is the same in years: other draws are another campaign."""
    table = {
        "density": Dispersion(density, Uniform(0.8, 1.2)),
        "mass": Dispersion(mass, Normal(900.0, 10.0)),
    }
    runs = np.array([0, 1, 63, 2**31 + 5])
    drawn = dispersed_inputs(
        cheap.scenario(), table, jax.random.key(seed), jnp.asarray(runs)
    )
    shares = {
        name: np.array([expected_share(seed, name, int(run)) for run in runs])
        for name in table
    }
    # Of the same 52 bits; the rest is rounding.
    np.testing.assert_allclose(
        drawn["planet.density_scale"], 0.8 + 0.4 * shares["density"], rtol=5e-16
    )
    # By the inverse of the error function, of which XLA has its own, to 1e-15 or so; a
    # share of 2^-53 would be 8 deviations away, and these are within 3.
    deviates = math.sqrt(2.0) * special.erfinv(2.0 * shares["mass"] - 1.0)
    np.testing.assert_allclose(
        drawn["vehicle.mass"], 900.0 + 10.0 * deviates, rtol=1e-14
    )


def test_names_runs_and_keys_draw_apart(key):
    same = Uniform(0.0, 1.0)
    table = {name: Dispersion(mass, same) for name in ("a", "b")}
    draws = [
        draw(table, k, jnp.asarray(run))[name]
        for k in (key, jax.random.key(1))
        for run in (0, 1)
        for name in table
    ]
    assert len(np.unique(draws)) == len(draws)


def test_a_draw_is_the_same_when_another_dispersion_is_added(key):
    """For a run alone and in a batch, and wherever the other one stands."""
    before = {"mass": Dispersion(mass, Normal(1.0, 0.1), apply=multiply)}
    other = {"density": Dispersion(density, Uniform(0.8, 1.2))}
    run = jnp.asarray(4)
    alone = draw(before, key, run)["mass"]
    runs = jnp.arange(7)
    scenario = cheap.scenario()
    batch = dispersed_inputs(scenario, before, key, runs)["vehicle.mass"]
    for after in (before | other, other | before):
        assert draw(after, key, run)["mass"] == alone
        inputs = dispersed_inputs(scenario, after, key, runs)
        assert jnp.array_equal(inputs["vehicle.mass"], batch)
    assert (
        dispersed_inputs(scenario, before, key, runs[4:5])["vehicle.mass"] == batch[4]
    )
    assert batch[4] == scenario.vehicle.mass * alone


def test_each_way_to_move_a_leaf(key):
    scenario = cheap.scenario()
    nominal = {
        a: float(v) for a, v in leaves_by_address(scenario).items() if not v.ndim
    }
    draws = {"mass": 1.04, "density": 0.9, "coefficients": 1.1, "path": 0.001}
    draws = {name: jnp.asarray(value) for name, value in draws.items()}
    inputs = disperse(scenario, cheap.dispersions(), draws)
    path = "initial_state.flight_path_angle"
    assert {address: float(value) for address, value in inputs.items()} == {
        "vehicle.mass": nominal["vehicle.mass"] * 1.04,
        "planet.density_scale": 0.9,
        "vehicle.lift_scale": 1.1,
        "vehicle.drag_scale": 1.1,
        path: nominal[path] + 0.001,
    }


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [(add, multiply, (1.0 + 2.0) * 3.0), (multiply, add, 1.0 * 2.0 + 3.0)],
    ids=["add, multiply", "multiply, add"],
)
@pytest.mark.parametrize("names", [("a", "b"), ("b", "a")], ids=str)
def test_dispersions_of_one_leaf_compose_in_their_order(
    key, first, second, expected, names
):
    """By hand and in a batch, whatever their names."""
    narrow = [Uniform(2.0, 2.0 + 1e-12), Uniform(3.0, 3.0 + 1e-12)]
    table = {
        name: Dispersion(density, distribution, apply)
        for name, distribution, apply in zip(
            names, narrow, (first, second), strict=True
        )
    }
    draws = {name: d.distribution.lower for name, d in table.items()}
    alone = disperse(cheap.scenario(), table, draws)["planet.density_scale"]
    assert alone == expected
    batch = dispersed_inputs(cheap.scenario(), table, key, jnp.arange(2))
    # As wide as the distributions.
    assert batch["planet.density_scale"] == pytest.approx(expected, abs=1e-11)


def test_a_replacement_may_be_moved_but_not_discard_another(key):
    draws = {"one": jnp.asarray(2.0), "two": jnp.asarray(0.5)}
    by_value = Dispersion(density, Uniform(0.8, 1.2))
    by_factor = Dispersion(density, Uniform(0.8, 1.2), apply=multiply)
    moved = disperse(cheap.scenario(), {"one": by_value, "two": by_factor}, draws)
    assert moved["planet.density_scale"] == 1.0
    for first in (by_value, by_factor):
        with pytest.raises(ValueError, match="'two' replaces planet.density_scale"):
            disperse(cheap.scenario(), {"one": first, "two": by_value}, draws)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        (lambda s: s.termination.names, "dispersion 'x': a lens reaches no leaf"),
        (lambda s: s.planet.densty, "dispersion 'x': .*densty"),
        (lambda s: s.termination.conditions["none"], "dispersion 'x': 'none'"),
        (lambda s: s.vehicle.mass + 1.0, "dispersion 'x'"),
        (lambda s: s.planet, "reaches a whole Planet, with planet.radius"),
        (lambda s: (s.vehicle.mass, s.planet.atmosphere), "a whole ExponentialAtmosph"),
        (lambda s: s.termination.conditions, "reaches a whole dict"),
        (lambda s: (s.vehicle.mass,) * 2, "reaches vehicle.mass twice"),
        (lambda s: s.guidance[3], "dispersion 'x'"),
    ],
    ids=["static", "no field", "no key", "computed"]
    + ["module", "number and module", "dictionary", "twice", "no list"],
)
def test_a_dispersion_that_reaches_no_leaf_is_an_error(key, where, message):
    table = {"x": Dispersion(where, Uniform(0.0, 1.0))}
    with pytest.raises(ValueError, match=message):
        disperse(cheap.scenario(), table, {"x": jnp.asarray(1.0)})
    with pytest.raises(ValueError, match=message):
        monte_carlo(cheap.scenario(), table, key, 1)


def test_a_table_of_numbers_is_not_dispersed(key):
    table = {"x": Dispersion(lambda s: s.guidance.cos_bank.coefficients, Normal(0, 1))}
    with pytest.raises(ValueError, match=r"table of shape \(2,\)"):
        monte_carlo(mars_scenario(), table, key, 1)


@pytest.mark.parametrize(
    ("distribution", "message"),
    [
        (Normal(1.0, -0.1), "dispersions.x.standard_deviation is -0.1"),
        (Normal(1.0, 0.0), "dispersions.x.standard_deviation is 0"),
        (Normal(np.nan, 0.1), "dispersions.x.mean is nan"),
        (Uniform(1.2, 0.8), "dispersions.x.lower is 1.2: .*below upper.* 0.8"),
        (TruncatedNormal(1.0, 0.1, 1.0, 1.0), "dispersions.x.lower is 1"),
        (TruncatedNormal(1.0, 0.1, 4.8, 5.0), "dispersions.x.mean is 38 standard dev"),
        (TruncatedNormal(1.0, 0.1, -5.0, -2.8), "dispersions.x.mean is 38 standard d"),
    ],
)
def test_a_distribution_that_cannot_be_drawn_from_is_an_error(distribution, message):
    table = {"x": Dispersion(density, distribution)}
    with pytest.raises(ValueError, match=message):
        check_dispersions(cheap.scenario(), table)


def test_any_mapping_is_a_table(key):
    table = types.MappingProxyType(cheap.mass_only())
    given = dispersed_inputs(cheap.scenario(), table, key, jnp.arange(2))
    assert list(given) == ["vehicle.mass"]


# apollo-10 falls almost vertically at the end.
MARKS = {
    "apollo-10": [pytest.mark.filterwarnings("ignore:.*decisions without prediction")],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "mission",
    [pytest.param(m, marks=MARKS.get(name, []), id=name) for name, m in ALL.items()],
)
def test_every_declared_dispersion_changes_the_flight_when_it_alone_is_drawn_anew(
    mission, key
):
    """A flight of each table, and for every dispersion one in which only that differs."""
    for variant, readings in readings_by_variant(mission).items():
        scenario = mission.scenario_of(variant)
        names, rows = [], []
        for reading in readings:
            table = mission.dispersion_table(reading)
            # Of a distribution that is often zero, the first draw that is another one.
            many = jax.vmap(functools.partial(draw, table, key))(jnp.arange(64))
            base = {name: x[0] for name, x in many.items()}
            other = {name: x[np.argmax(x != x[0])] for name, x in many.items()}
            drawn = [
                n for n, d in table.items() if not isinstance(d.distribution, Constant)
            ]
            for name in [None, *drawn]:
                draws = base if name is None else base | {name: other[name]}
                names.append((reading, name))
                rows.append(disperse(scenario, table, draws))
        leaves = leaves_by_address(scenario)
        addresses = {address for row in rows for address in row}
        inputs = {a: [float(row.get(a, leaves[a])) for row in rows] for a in addresses}
        with small_batches():
            campaign = monte_carlo(scenario, inputs=inputs)
        misses = campaign.misses
        ends = np.stack((campaign.flights.time, misses.downrange, misses.velocity))
        bases = [names.index((reading, None)) for reading, _ in names]
        change = np.abs(ends - ends[:, bases]).max(axis=0)
        # s, m and m/s; far above rounding, far below what a tenth of a deviation does.
        moved = dict(zip(names, change > 1e-6, strict=True))
        assert not [name for name, by in moved.items() if name[1] and not by]


def readings_by_variant(mission):
    """The readings, by as few choices as have what they move: each is compiled."""

    def takes(variant, reading):
        try:
            check_dispersions(
                mission.scenario_of(variant), mission.dispersion_table(reading)
            )
        except ValueError:
            return False
        return True

    found = {}
    # Those that move much first: their choices have what the others move as well.
    for reading in sorted(mission.dispersions, key=lambda r: -size(mission, r)):
        variant = next(v for v in (*found, *choices(mission)) if takes(v, reading))
        found.setdefault(variant, []).append(reading)
    return found


def size(mission, reading):
    return len(mission.dispersion_table(reading))


# What cannot matter, and what cannot be told apart.


NO_EFFECT = {
    "factor on zero": (
        lambda s: s.planet.rotation_rate,
        multiply,
        "factor on planet.rotation_rate, which is zero",
    ),
    "onboard nose radius": (
        lambda s: s.guidance.model.vehicle.nose_radius,
        multiply,
        "guidance.model.vehicle.nose_radius has no effect",
    ),
    "onboard rotation": (
        lambda s: s.guidance.model.planet.rotation_rate,
        add,
        "guidance.model.planet.rotation_rate has no effect",
    ),
    "trim of a vehicle whose lift does not depend on it": (
        lambda s: s.vehicle.trim_angle_of_attack,
        add,
        "vehicle.trim_angle_of_attack has no effect",
    ),
    "temperature without a Mach number": (
        lambda s: s.planet.atmosphere.isothermal_temperature,
        multiply,
        "planet.atmosphere.isothermal_temperature has no effect",
    ),
}


@pytest.fixture(scope="module")
def observer_scenario(reference):
    return mars_scenario(observer_law(reference))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "apply", "message"), NO_EFFECT.values(), ids=NO_EFFECT
)
def test_what_cannot_matter_is_refused(observer_scenario, where, apply, message):
    table = {"x": Dispersion(where, Uniform(0.9, 1.1), apply)}
    with pytest.raises(ValueError, match=message):
        check_dispersions(observer_scenario, table)


@pytest.mark.slow
def test_what_matters_is_taken(observer_scenario):
    """Of motion, sensors, law, peaks and misses one each; and zero may be replaced."""
    wheres = [
        (lambda s: s.planet.rotation_rate, add),
        (lambda s: s.vehicle.nose_radius, multiply),
        (lambda s: s.guidance.model.planet.radius, multiply),
        (lambda s: s.guidance.model.planet.atmosphere.scale_height, multiply),
        (lambda s: s.guidance.gains.epsilon0, multiply),
        (
            lambda s: (
                s.termination.conditions["velocity"].velocity,
                s.target.velocity,
            ),
            multiply,
        ),
        (
            lambda s: (
                s.target.altitude,
                s.termination.conditions["altitude"].altitude,
            ),
            add,
        ),
        (lambda s: s.initial_state.longitude, add),
    ]
    table = {
        str(i): Dispersion(where, Uniform(0.9, 1.1), apply)
        for i, (where, apply) in enumerate(wheres)
    }
    check_dispersions(observer_scenario, table)


def test_a_factor_on_what_another_dispersion_made_is_taken(observer_scenario):
    rotation = lambda s: s.planet.rotation_rate
    table = {
        "one": Dispersion(rotation, Uniform(1e-5, 2e-5)),
        "two": Dispersion(rotation, Uniform(0.9, 1.1), multiply),
    }
    check_dispersions(observer_scenario, table)


def test_leaves_that_move_by_one_draw_have_one_unit():
    both = lambda s: (s.vehicle.mass, s.vehicle.drag_scale)
    table = {"x": Dispersion(both, Uniform(0.9, 1.1))}
    with pytest.raises(
        ValueError, match=r"vehicle.mass \(kg\), vehicle.drag_scale \(1"
    ):
        check_dispersions(cheap.scenario(), table)
    table = {"x": Dispersion(both, Uniform(0.9, 1.1), apply=multiply)}
    check_dispersions(cheap.scenario(), table)


SENSORS = {
    "accelerometers": Accelerometers,
    "flow_sensors": FlowSensors,
}


@pytest.mark.parametrize("name", SENSORS)
def test_noise_is_another_in_each_run(name, key):
    """Of given size or dispersed; and by seeds that are told apart, up to 1."""
    where = {
        n: lambda s, n=n: getattr(getattr(s, name), n) for n in ("noise", "noise_seed")
    }
    noise = Dispersion(where["noise"], Uniform(0.01, 0.02))
    seed = Dispersion(where["noise_seed"], Uniform(0.0, 1.0))

    def sensing(**given):
        law = Sampled(cheap.scenario().guidance, 1.0)
        sensors = SENSORS[name](**given)
        return dataclasses.replace(cheap.scenario(), guidance=law, **{name: sensors})

    silent, noisy = sensing(noise=0.0), sensing(noise=0.01)
    mass = cheap.mass_only()
    refuse = functools.partial(pytest.raises, ValueError)
    with refuse(match=f"{name}.noise is dispersed, and all runs would have the same"):
        check_dispersions(silent, {"noise": noise})
    with refuse(match=f"{name}.noise is 0.01.*, and all runs would have the same"):
        check_dispersions(noisy, mass)
    check_dispersions(silent, mass)
    check_dispersions(silent, {"noise": noise, "seed": seed})
    for wrong in (2.0, -1.0):
        with refuse(match=f"{name}.noise_seed is {wrong:g}"):
            check(sensing(noise_seed=wrong))
        given = {f"{name}.noise_seed": [0.5, wrong]}
        with refuse(match=f"the inputs, run 1: {name}.noise_seed is {wrong:g}"):
            monte_carlo(noisy, inputs=given)


class Counting(BankProfile):
    """A law with a whole number among its leaves."""

    count: jax.Array = dataclasses.field(default_factory=lambda: jnp.asarray(1))


def test_a_whole_number_takes_whole_numbers(key):
    """Anything else would be flown without its fraction, and stored with it."""
    law = Counting(cheap.at_trim().guidance.cos_bank)
    scenario = dataclasses.replace(cheap.scenario(), guidance=law)
    table = {"x": Dispersion(lambda s: s.guidance.count, Discrete([2.0, 3.0]))}
    with pytest.raises(ValueError, match="'x' reaches guidance.count, a whole number"):
        monte_carlo(scenario, table, key, 1)
    with pytest.raises(ValueError, match="the inputs, run 1: guidance.count is 1.5"):
        monte_carlo(scenario, inputs={"guidance.count": [1.0, 1.5]})


# Two words with one CRC-32, well known.
COLLIDING = ("plumless", "buckeroo")


def test_names_that_would_share_their_draws_are_refused(key):
    assert len({zlib.crc32(name.encode()) for name in COLLIDING}) == 1
    table = {
        name: Dispersion(where, Uniform(0.9, 1.1))
        for name, where in zip(COLLIDING, (mass, density), strict=True)
    }
    for refuses in (
        lambda: draw(table, key, jnp.asarray(0)),
        lambda: check_dispersions(cheap.scenario(), table),
    ):
        with pytest.raises(ValueError, match="'plumless' and 'buckeroo' .*CRC-32"):
            refuses()
    del table["plumless"]
    draw(table, key, jnp.asarray(0))


def test_runs_that_would_be_equal_are_refused(key):
    """A key takes 32 bits of the index."""
    last = 2**32 - 1
    runs = jnp.asarray([last - 2**31, last])
    drawn = dispersed_inputs(cheap.scenario(), cheap.mass_only(), key, runs)
    assert len(np.unique(drawn["vehicle.mass"])) == 2
    for runs, wrong in (([0, 2**32], 2**32), ([-1], -1), (2**32 + 1, 2**32)):
        with pytest.raises(
            ValueError, match=f"run {wrong} was asked for: .*2\\^32 - 1"
        ):
            monte_carlo(cheap.scenario(), cheap.mass_only(), key, runs)


@pytest.mark.parametrize("seed", [2**63, 2**64, 10**30, -(2**63) - 1])
def test_a_seed_that_no_key_holds_is_refused(seed):
    with pytest.raises(ValueError, match=f"the seed is {seed}: .*2\\^63 - 1"):
        key_of(seed)


def test_a_key_is_that_of_jax():
    for seed in (0, 7, -1, 2**63 - 1, -(2**63), 2**32):
        assert key_of(seed) == jax.random.key(seed)
    assert key_of(0) != key_of(2**32)


TAILS = {
    "4 above": (4.0, 5.0),
    "5 to 8 above": (5.0, 8.0),
    "7 above": (7.0, 12.0),
    "8.5 above": (8.5, 9.0),
    "20 above": (20.0, 30.0),
    "36 above": (36.0, 40.0),
    "9 below": (-9.5, -9.0),
    "30 below": (-60.0, -30.0),
    "both sides": (-2.0, 30.0),
    "no bounds to speak of": (-30.0, 30.0),
}


@pytest.mark.parametrize("name", TAILS)
def test_draws_in_the_tails_are_quantiles_of_the_distribution(name, key):
    """Each draw is the quantile, by scipy, of the share that its key draws."""
    lower, upper = TAILS[name]
    keys = jax.random.split(key, 2000)
    drawn = sample_of(TruncatedNormal(0.0, 1.0, lower, upper), keys)
    shares = jax.vmap(lambda k: jax.random.uniform(k, dtype=float))(keys)
    expected = stats.truncnorm(lower, upper).ppf(np.asarray(shares))
    assert lower <= drawn.min() and drawn.max() <= upper
    # Beyond that the quantile of scipy itself is iterated for; on both sides it loses
    # what a share near 1 has lost already.
    np.testing.assert_allclose(drawn, expected, rtol=1e-11, atol=1e-9)
    assert len(np.unique(drawn)) == len(drawn)


def test_a_tail_is_filled(key):
    """Not its bound: beyond 8 deviations the distance from it is nearly exponential."""
    keys = jax.random.split(key, DRAWS)
    bound = 9.0
    drawn = sample_of(TruncatedNormal(0.0, 1.0, bound, 20.0), keys)
    reference = stats.truncnorm(bound, 20.0)
    assert stats.kstest(np.asarray(drawn), reference.cdf).pvalue > 1e-4
    # Four standard errors.
    error = 4.0 * reference.std() / np.sqrt(DRAWS)
    assert drawn.mean() == pytest.approx(reference.mean(), abs=error)


# Moments, and the same distributions wider or narrower.

LOPSIDED = {
    "short of the mean": (TruncatedNormal(1.0, 0.1, 0.7, 0.95), (-3.0, -0.5)),
    "beyond the mean": (TruncatedNormal(1.0, 0.1, 1.2, 1.35), (2.0, 3.5)),
    "one-sided": (TruncatedNormal(-2.0, 3.0, -32.0, -2.0), (-10.0, 0.0)),
    "nearly uniform": (TruncatedNormal(5.0, 2.0, 4.9, 5.3), (-0.05, 0.15)),
    "all of it": (TruncatedNormal(5.0, 2.0, -45.0, 55.0), (-25.0, 25.0)),
}
"""Truncated normals, and their bounds in deviations"""

ALL_DISTRIBUTIONS = DISTRIBUTIONS | {
    name: (d, stats.truncnorm(*bounds, float(d.mean), float(d.standard_deviation)))
    for name, (d, bounds) in LOPSIDED.items()
}


@pytest.mark.parametrize("name", ALL_DISTRIBUTIONS)
def test_moments_are_those_of_the_distribution(name):
    distribution, reference = ALL_DISTRIBUTIONS[name]
    mean, deviation = distribution.moments()
    # A variance that is small beside that of the whole normal distribution is what is
    # left of a difference: 3e-3 of it here, of which rounding is 1e-12.
    np.testing.assert_allclose(mean, reference.mean(), rtol=1e-13)
    np.testing.assert_allclose(deviation, reference.std(), rtol=1e-11)


@pytest.mark.parametrize("name", ALL_DISTRIBUTIONS)
def test_moments_are_integrals_of_the_density(name):
    """By the midpoint rule, without what scipy says of moments."""
    distribution, reference = ALL_DISTRIBUTIONS[name]
    lower, upper = reference.support()
    reach = 12.0 * reference.std()
    lower = max(lower, reference.mean() - reach)
    upper = min(upper, reference.mean() + reach)
    x = lower + (upper - lower) * (np.arange(100_000) + 0.5) / 100_000
    weights = reference.pdf(x)
    mean, deviation = distribution.moments()
    first = np.average(x, weights=weights)
    second = np.average((x - first) ** 2, weights=weights)
    # The rule is good to the square of its interval, 24e-5 deviations at most.
    np.testing.assert_allclose(mean, first, atol=1e-7 * deviation, rtol=0.0)
    np.testing.assert_allclose(deviation, np.sqrt(second), rtol=1e-7)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("bound", [6.0, 9.0, 30.0])
def test_moments_far_out_are_those_of_the_closed_form(bound, sign):
    """By the hazard of the normal distribution, which erfcx gives without a difference."""
    bounds = sorted((sign * bound, sign * (bound + 12.0)))
    mean, deviation = TruncatedNormal(0.0, 1.0, *bounds).moments()
    hazard = np.sqrt(2.0 / np.pi) / special.erfcx(bound / np.sqrt(2.0))
    np.testing.assert_allclose(mean, sign * hazard, rtol=1e-14)
    # 1 + b h - h^2 leaves 1 / b^2 of b^2, of which rounding is some 1e-16.
    expected = np.sqrt(1.0 + bound * hazard - hazard**2)
    np.testing.assert_allclose(deviation, expected, rtol=1e-15 * bound**4)


@pytest.mark.parametrize("factor", [0.1, 1.0, 3.5])
@pytest.mark.parametrize("name", ALL_DISTRIBUTIONS)
def test_scaled_is_about_the_same_mean_and_so_many_times_as_wide(name, factor):
    distribution, _ = ALL_DISTRIBUTIONS[name]
    scaled = distribution.scaled(factor)
    assert type(scaled) is type(distribution)
    mean, deviation = distribution.moments()
    about, width = scaled.moments()
    # Rounding of the bounds, which are up to fifty deviations from the mean, and what
    # that is beside a deviation a tenth of the former.
    np.testing.assert_allclose(about, mean, rtol=1e-13)
    np.testing.assert_allclose(width, factor * deviation, rtol=1e-11)


@pytest.mark.parametrize("name", ALL_DISTRIBUTIONS)
def test_each_draw_of_a_scaled_distribution_is_as_much_nearer_to_the_mean(name, key):
    """So that the same runs can be flown with all that is uncertain made small."""
    distribution, _ = ALL_DISTRIBUTIONS[name]
    keys = jax.random.split(key, 100)
    sample = jax.jit(lambda d, keys: jax.vmap(d.sample)(keys))
    wide, narrow = sample(distribution, keys), sample(distribution.scaled(0.1), keys)
    mean, deviation = distribution.moments()
    assert np.all(narrow != wide)
    np.testing.assert_allclose(
        (narrow - mean) / deviation,
        0.1 * (wide - mean) / deviation,
        # Rounding of numbers that are some hundred deviations from zero, and of bounds.
        atol=1e-12,
        rtol=0.0,
    )


def one_of_three(stream="which") -> dict[str, Dispersion]:
    return {
        f"{place}": Dispersion(
            mass, OneOfSeveral(place, 3, 10.0 ** (place + 1)), apply=add, stream=stream
        )
        for place in range(3)
    }


def test_one_of_several_is_drawn_at_a_time(key):
    runs = jnp.arange(3000)
    drawn = jax.vmap(lambda run: draw(one_of_three(), key, run))(runs)
    drawn = np.stack(list(drawn.values()))
    assert np.all(np.sum(drawn != 0.0, axis=0) == 1)
    for place, values in enumerate(drawn):
        chosen = values[values != 0.0]
        # Five standard deviations of a binomial.
        assert abs(len(chosen) - 1000) < 5.0 * math.sqrt(3000 * 2 / 9)
        most = 10.0 ** (place + 1)
        assert stats.kstest(chosen, stats.uniform(-most, 2 * most).cdf).pvalue > 1e-4


def test_one_of_several_by_itself():
    many = OneOfSeveral(2, 4, 6.0)
    mean, deviation = many.moments()
    # A quarter of the variance of a uniform distribution, a^2 / 3.
    assert mean == 0.0
    assert deviation == pytest.approx(math.sqrt(36.0 / 3.0 / 4.0))
    assert many.scaled(0.5).moments()[1] == pytest.approx(0.5 * deviation)
    assert (many.scaled(0.5).place, many.scaled(0.5).count) == (2, 4)
    for place in (-1, 4):
        with pytest.raises(ValueError, match=f"place is {place}: it must be from 0 to"):
            OneOfSeveral(place, 4, 6.0)


def test_dispersions_of_one_stream_go_together(key):
    narrow, wide = Uniform(0.0, 1.0), Uniform(-2.0, 2.0)
    apart = {"a": Dispersion(mass, narrow), "b": Dispersion(mass, wide)}
    together = {
        name: Dispersion(each.where, each.distribution, stream="s")
        for name, each in apart.items()
    }
    drawn = draw(together, key, jnp.asarray(5))
    assert drawn["b"] == pytest.approx(4.0 * drawn["a"] - 2.0)
    # By the name of the stream alone, beside others or not.
    again = draw({"other": apart["a"]} | together, key, jnp.asarray(5))
    assert again["a"] == drawn["a"]
    assert drawn["a"] == draw({"s": apart["a"]}, key, jnp.asarray(5))["s"]
    assert drawn["a"] != draw(apart, key, jnp.asarray(5))["a"]


def test_a_description_tells_streams_and_places():
    def told(table):
        return describe(cheap.scenario(), table, 0, cheap.SOLVER, None)["dispersions"]

    one = told(one_of_three())["1"]
    assert (one["place"], one["count"], one["most"]) == (1, 3, 100.0)
    assert one["stream"] == "which"
    assert "stream" not in told(one_of_three(None))["1"]


def test_a_scaled_table_keeps_all_but_the_widths():
    table = types.MappingProxyType(cheap.dispersions())
    scaled = scaled_dispersions(table, 0.1)
    assert list(scaled) == list(table)
    for name, dispersion in table.items():
        assert scaled[name].where is dispersion.where
        assert scaled[name].apply is dispersion.apply
        mean, deviation = dispersion.distribution.moments()
        about, width = scaled[name].distribution.moments()
        # Rounding of the bounds over the width.
        np.testing.assert_allclose(about, mean, rtol=1e-14, atol=1e-18)
        np.testing.assert_allclose(width, 0.1 * deviation, rtol=1e-13)
    check_dispersions(cheap.scenario(), scaled)
    # The given table is left as it was.
    assert table["mass"].distribution.lower == 0.95


def test_moments_of_a_table_are_differentiable_in_its_numbers():
    """As linear covariance takes them: the deviation of an untruncated normal."""

    def deviation(width):
        return TruncatedNormal(10.0, width, -70.0, 90.0).moments()[1]

    # Bounds at forty deviations change nothing.
    assert jax.jit(jax.grad(deviation))(jnp.asarray(2.0)) == pytest.approx(1.0)
