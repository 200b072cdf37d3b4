"""Samplers: how evenly the runs are spread, and that a run is the same in any batch."""

import json

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from commands import monte_carlo as command_line
from scipy import stats
from scipy.stats import qmc

from jentry.campaign import (
    AbstractDistribution,
    CampaignError,
    Constant,
    Dispersion,
    LatinHypercube,
    Normal,
    Sobol,
    TruncatedNormal,
    Uniform,
    add,
    correlated_normals,
    monte_carlo,
    open_campaign,
)
from jentry.campaign.campaign import drawn_inputs
from jentry.campaign.description import describe
from jentry.campaign.samplers import check_sampler, shares_of


STREAMS = {"a": 1, "b": 1, "c": 2, "none": 0}

SAMPLERS = {"latin hypercube": LatinHypercube(64), "sobol": Sobol()}


@pytest.fixture(params=SAMPLERS)
def sampler(request):
    return SAMPLERS[request.param]


def table_of(sampler, key, runs, streams=STREAMS):
    """Shares of all random numbers, shape (runs, numbers)."""
    shares = shares_of(sampler, key, streams, np.arange(runs))
    columns = [np.reshape(shares[name], (runs, n)) for name, n in streams.items() if n]
    return np.concatenate(columns, axis=1)


def in_cells(shares, cells):
    """How many of the shares are in each of as many parts of the unit interval."""
    return np.bincount(np.floor(shares * cells).astype(int), minlength=cells)


def test_every_number_has_one_run_in_each_of_as_many_parts(sampler, key):
    table = table_of(sampler, key, 64)
    assert table.shape == (64, 4)
    for column in table.T:
        np.testing.assert_array_equal(in_cells(column, 64), 1)
    # In orders of their own.
    ranks = np.argsort(table, axis=0)
    assert len({tuple(column) for column in ranks.T}) == 4


def test_the_orders_of_a_hypercube_are_independent():
    """Correlations of two orders of n are normal with a variance of 1 / (n - 1)."""
    found = [
        np.corrcoef(table_of(LatinHypercube(64), jax.random.key(k), 64).T)[
            np.triu_indices(4, 1)
        ]
        for k in range(100)
    ]
    assert np.mean(found) == pytest.approx(0.0, abs=5.0 / np.sqrt(63 * 600))
    # The six of a key are independent two by two: the spread of a variance of 600.
    assert np.var(found) == pytest.approx(1.0 / 63.0, rel=5.0 * np.sqrt(2.0 / 600))


@pytest.mark.parametrize("first", [0, 64, 192])
def test_sobol_points_are_a_net(key, first):
    """In its first two dimensions each 64 consecutive points have one in each rectangle
    of an area of 1/64 with sides of powers of 2."""
    runs = np.arange(first, first + 64)
    shares = shares_of(Sobol(), key, {"a": 1, "b": 1}, runs)
    for power in range(7):
        wide, high = 2**power, 2 ** (6 - power)
        place = np.floor(shares["a"] * wide) * high + np.floor(shares["b"] * high)
        assert len(np.unique(place)) == 64


def test_sobol_points_are_those_of_scipy(key):
    """One dimension after the other, with its own scrambling."""
    table = table_of(Sobol(), key, 300)
    words = [int(word) for word in jax.random.key_data(key)]
    codes = [(0xE8B7BE43, 0), (0x71BEEFF9, 0), (0x06B9DF6F, 0), (0x06B9DF6F, 1)]
    for dimension, code in enumerate(codes):  # CRC-32 of the letters a, b and c
        rng = np.random.default_rng([*words, *code])
        scipys = qmc.Sobol(dimension + 1, bits=52, rng=rng).random(512)[:300, -1]
        np.testing.assert_array_equal(table[:, dimension], scipys + 2.0**-53)


def test_a_run_is_the_same_alone_and_in_any_batch(sampler, key):
    whole = shares_of(sampler, key, STREAMS, np.arange(64))
    some = np.array([63, 5, 5, 40])
    for runs in (some, some[:1]):
        for name, shares in shares_of(sampler, key, STREAMS, runs).items():
            np.testing.assert_array_equal(shares, whole[name][runs])


def test_a_sobol_sequence_goes_on(key):
    few, many = (table_of(Sobol(), key, runs) for runs in (50, 5000))
    np.testing.assert_array_equal(few, many[:50])
    assert len(np.unique(many)) == many.size
    far = shares_of(Sobol(), key, {"a": 1}, np.array([2**18 - 1]))["a"]
    words = [int(word) for word in jax.random.key_data(key)]
    rng = np.random.default_rng([*words, 0xE8B7BE43, 0])
    engine = qmc.Sobol(1, bits=52, rng=rng)
    assert far[0] == engine.random(2**18)[-1, 0] + 2.0**-53


def test_what_is_added_leaves_the_others_alone(key):
    """For a Latin hypercube wherever it stands, for Sobol at the end of the table."""
    before = {"a": 1, "b": 1}
    for sampler, after in (
        (LatinHypercube(64), {"new": 1, "a": 1, "b": 1}),
        (LatinHypercube(64), {"a": 1, "b": 1, "new": 3}),
        (Sobol(), {"a": 1, "b": 1, "new": 3}),
    ):
        alone = shares_of(sampler, key, before, np.arange(64))
        beside = shares_of(sampler, key, after, np.arange(64))
        for name in before:
            np.testing.assert_array_equal(alone[name], beside[name])
    moved = shares_of(Sobol(), key, {"new": 1} | before, np.arange(64))
    assert not np.array_equal(moved["b"], alone["b"])


def test_keys_spread_apart_and_evenly(sampler):
    """Over the seeds, the share of any run is uniform: no draw is preferred."""
    keys = [jax.random.key(seed) for seed in range(300)]
    for run in (0, 37):
        shares = [
            shares_of(sampler, key, {"a": 1}, np.array([run]))["a"][0] for key in keys
        ]
        assert stats.kstest(shares, stats.uniform.cdf).pvalue > 1e-4


def test_the_variance_of_a_mean_is_that_of_the_cells():
    """Of n shares, each uniform in a cell of its own: 1 / (12 n^3), and 1 / (12 n) of
    independent ones. Of a sum over the columns likewise, in whatever orders."""
    n, seeds = 16, 400
    tables = [
        table_of(LatinHypercube(n), jax.random.key(seed), n) for seed in range(seeds)
    ]
    one = np.array([table[:, 0].mean() for table in tables])
    four = np.array([table.sum(axis=1).mean() for table in tables])
    error = 5.0 * np.sqrt(2.0 / seeds)
    assert one.var() == pytest.approx(1.0 / (12.0 * n**3), rel=error)
    assert four.var() == pytest.approx(4.0 / (12.0 * n**3), rel=error)
    assert one.mean() == pytest.approx(0.5, abs=5.0 / np.sqrt(12.0 * n**3 * seeds))


def test_shares_are_never_0_or_1(key):
    for sampler in (LatinHypercube(100_000), Sobol()):
        shares = shares_of(sampler, key, {"a": 1}, np.arange(100_000))["a"]
        assert 0.0 < shares.min() < 2e-5 and 1.0 - 2e-5 < shares.max() < 1.0


# What is drawn by them.


def table() -> dict[str, Dispersion]:
    """Of each kind one: correlated, in one stream, and not random at all."""
    wheres = {
        "lift": lambda s: s.vehicle.lift_scale,
        "drag": lambda s: s.vehicle.drag_scale,
    }
    together = {n: Dispersion(where, Normal(1.0, 0.02)) for n, where in wheres.items()}
    path = lambda s: s.initial_state.flight_path_angle
    return {
        "mass": Dispersion(lambda s: s.vehicle.mass, Uniform(900.0, 1000.0)),
        **correlated_normals(together, [[1.0, 0.9], [0.9, 1.0]]),
        "path": Dispersion(path, Normal(0.0, 1e-3), add, stream="s"),
        "density": Dispersion(
            lambda s: s.planet.density_scale,
            TruncatedNormal(1.0, 0.1, 0.8, 1.2),
            stream="s",
        ),
        "radius": Dispersion(lambda s: s.vehicle.nose_radius, Constant(1.5)),
    }


def test_draws_are_quantiles_of_the_shares(sampler, key):
    inputs = drawn_inputs(cheap.scenario(), table(), key, np.arange(64), sampler)
    mass = np.sort(inputs["vehicle.mass"])
    cells = in_cells((mass - 900.0) / 100.0, 64)
    np.testing.assert_array_equal(cells, 1)
    # One share of the stream for both.
    nominal = float(cheap.scenario().initial_state.flight_path_angle)
    shares = stats.norm.cdf(
        (inputs["initial_state.flight_path_angle"] - nominal) / 1e-3
    )
    density = stats.truncnorm(-2.0, 2.0, 1.0, 0.1).ppf(shares)
    np.testing.assert_allclose(inputs["planet.density_scale"], density, rtol=1e-9)
    np.testing.assert_array_equal(in_cells(shares, 64), 1)
    np.testing.assert_array_equal(inputs["vehicle.nose_radius"], 1.5)
    both = inputs["vehicle.lift_scale"], inputs["vehicle.drag_scale"]
    # Of 64 runs, five of its standard deviations (1 - r^2) / n^0.5 with evenness to spare.
    assert np.corrcoef(both)[0, 1] == pytest.approx(0.9, abs=5.0 * 0.19 / 8.0)
    normal = (both[0] - 1.0) / 0.02
    np.testing.assert_array_equal(in_cells(stats.norm.cdf(normal), 64), 1)


def flown(key, runs, sampler, dispersions=None):
    return monte_carlo(
        cheap.scenario(),
        table() if dispersions is None else dispersions,
        key,
        runs,
        solver=cheap.SOLVER,
        sampler=sampler,
    )


TABLE = table()


def test_a_flight_is_the_same_alone_bit_by_bit(sampler, key):
    whole = flown(key, 64, sampler, TABLE)
    some = flown(key, [50, 3], sampler, TABLE)
    assert np.array_equal(some.runs, [50, 3])
    for a, b in zip(
        jax.tree.leaves((whole.inputs, whole.flights)),
        jax.tree.leaves((some.inputs, some.flights)),
        strict=True,
    ):
        np.testing.assert_array_equal(a[np.array([50, 3])], b)
    plain = flown(key, 64, None, TABLE)
    assert not np.array_equal(
        plain.inputs["vehicle.mass"], whole.inputs["vehicle.mass"]
    )


class Own(AbstractDistribution):
    def sample(self, key):
        return 950.0 + jax.random.normal(key)

    def moments(self):
        return jnp.full((), 950.0), jnp.ones(())

    def scaled(self, factor):
        return self


def test_what_a_sampler_cannot_is_refused(key):
    cube = LatinHypercube(64)
    with pytest.raises(ValueError, match="65 runs were asked for of a Latin hyp.* 64"):
        flown(key, 65, cube)
    with pytest.raises(
        ValueError, match="32 runs were asked for.*fixed number of runs"
    ):
        flown(key, 32, cube)
    with pytest.raises(ValueError, match="run 64 was asked for of a Latin hypercube"):
        flown(key, [3, 64], cube)
    with pytest.raises(ValueError, match="runs is 1: a Latin hypercube has 2 or more"):
        LatinHypercube(1)
    many = dict.fromkeys(map(str, range(21_200)), 1)
    check_sampler(Sobol(), many | {"one": 1}, 64)
    with pytest.raises(ValueError, match="21202 random numbers a run .* 21201 dimens"):
        check_sampler(Sobol(), many | {"two": 2}, 64)
    own = {"mass": Dispersion(lambda s: s.vehicle.mass, Own())}
    with pytest.raises(ValueError, match="Own has no quantile"):
        flown(key, 64, cube, own)
    given = {"vehicle.mass": np.array([900.0])}
    with pytest.raises(
        ValueError, match="a sampler draws dispersions: give it without"
    ):
        monte_carlo(cheap.scenario(), inputs=given, sampler=Sobol())


# In folders, and on the command line.


def test_a_description_says_of_plain_draws_what_it_always_has():
    def told(**options):
        return describe(
            cheap.scenario(), cheap.mass_only(), 0, cheap.SOLVER, None, **options
        )

    plain = told()
    assert set(plain) == {
        *("seed", "history_interval", "solver", "xla_options", "structure"),
        *("dispersions", "inputs", "scenario", "own_code", "versions"),
    }
    sobol, cube = told(sampler=Sobol()), told(sampler=LatinHypercube(8))
    assert sobol.pop("sampler")["method"] == "Sobol"
    entry = cube.pop("sampler")
    assert (entry["method"], entry["runs"]) == ("LatinHypercube", 8)
    assert sobol == cube == plain


def test_a_campaign_is_resumed_by_its_own_sampler_only(tmp_path):
    def fly(name, runs, sampler, seed=3):
        cheap.campaign(tmp_path / name, runs, seed, cheap.mass_only(), sampler=sampler)
        return open_campaign(tmp_path / name)

    fly("sobol", 3, Sobol())
    more = fly("sobol", 8, Sobol())
    xarray.testing.assert_equal(more, fly("at once", 8, Sobol()))
    cube = fly("cube", 8, LatinHypercube(8))
    xarray.testing.assert_identical(cube, fly("cube", 8, LatinHypercube(8)))
    for name, runs, sampler, message in (
        ("sobol", 8, None, "sampler is given only there"),
        ("cube", 8, None, "sampler is given only there"),
        ("cube", 8, Sobol(), "sampler.method is LatinHypercube there and Sobol now"),
        ("cube", 12, LatinHypercube(12), "sampler.runs is 8 there and 12 now"),
    ):
        with pytest.raises(CampaignError, match=message):
            fly(name, runs, sampler)
    with pytest.raises(ValueError, match="12 runs were asked for of a Latin hyper"):
        fly("cube", 12, LatinHypercube(8))
    with pytest.raises(ValueError, match="12 runs were asked for of a Latin hyper"):
        fly_part = {"part": (1, 3), "sampler": LatinHypercube(8)}
        cheap.campaign(tmp_path / "part", 12, 3, cheap.mass_only(), **fly_part)
    assert not (tmp_path / "part").exists()


@pytest.mark.parametrize("name", ["latin-hypercube", "sobol"])
def test_the_sampler_of_a_command(name, command, tmp_path):
    words = "--runs", 4, "--seed", 7, "--sampler", name
    out = tmp_path / "out"
    code, printed, _ = command_line(command, *words, "--out", out, "--no-figures")
    assert code == 0 and "unchanged, by plain draws" in printed
    sampler = {"latin-hypercube": LatinHypercube(4), "sobol": Sobol()}[name]
    cheap.campaign(tmp_path / "same", 4, sampler=sampler)
    xarray.testing.assert_equal(open_campaign(out), open_campaign(tmp_path / "same"))
    stored = json.loads((out / "campaign.json").read_text())
    assert stored["sampler"]["method"] == type(sampler).__name__
    refused = command_line(command, "--sampler", "halton", "--out", out)
    assert refused[0] != 0
