"""Draws depend on the key, the name and the run alone, and no two are equal."""

import dataclasses
import functools
import math
import zlib

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats

from jentry.campaign import (
    Dispersion,
    Normal,
    OneOfSeveral,
    Uniform,
    add,
    draw,
    monte_carlo,
    multiply,
)
from jentry.campaign.description import describe
from jentry.campaign.dispersions import check_dispersions, dispersed_inputs, key_of
from jentry.flight.scenario_checks import check
from jentry.guidance import Sampled
from jentry.onboard import Accelerometers, FlowSensors


mass = lambda s: s.vehicle.mass
density = lambda s: s.planet.density_scale


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
