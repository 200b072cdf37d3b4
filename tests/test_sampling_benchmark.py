"""What samplers save, as a benchmark has saved it, campaign by campaign."""

import jax
import numpy as np
import pytest
from pages import benchmark

from jentry.campaign import monte_carlo
from jentry.missions import find_mission


sampling = benchmark("sampling")

SAVED = sampling.saved()


def test_everything_is_saved():
    tables = [sampling.table_of(mission, SAVED) for mission in sampling.READINGS]
    assert [len(table) for table in tables] == [4, 4]
    assert {len(values) for values in SAVED.values()} == {sampling.CAMPAIGNS}


@pytest.mark.parametrize("sampler", ["latin-hypercube", "sobol"])
def test_means_are_those_of_plain_draws(sampler):
    """Spreading the draws changes the luck, not what is expected."""
    for *row, name in SAVED:
        if name == "plain" and row[-1] == "mean":
            plain, spread = SAVED[*row, name], SAVED[*row, sampler]
            error = np.sqrt((plain.var() + spread.var()) / sampling.CAMPAIGNS)
            assert abs(plain.mean() - spread.mean()) < 5.0 * error


def test_a_variance_has_its_standard_error():
    """Of normal values, by the closed form; the ratio of two by both."""
    rng = np.random.default_rng(0)
    sets = rng.normal(0.0, 3.0, size=(400, 256))
    found, errors = np.transpose([sampling.variance(values) for values in sets])
    assert np.mean(found) == pytest.approx(9.0, rel=0.02)
    # A fourth moment of 256 values is biased and varies: a few per cent.
    assert np.mean(errors) == pytest.approx(np.sqrt(2.0 / 255), rel=0.05)
    assert np.std(found) / 9.0 == pytest.approx(np.sqrt(2.0 / 255), rel=0.2)
    times, error = sampling.saving(2.0 * sets[0], sets[1])
    assert times == pytest.approx(4.0 * sets[0].var() / sets[1].var())
    assert error / times == pytest.approx(np.hypot(*errors[:2]))


@pytest.mark.parametrize(
    ("given", "printed"),
    [((3.094, 0.431), "3.09 ± 0.43"), ((684_700.0, 311_000.0), "680 000 ± 310 000")]
    + [((0.8312, 0.0601), "0.831 ± 0.060"), ((110.4, 20.3), "110 ± 20")],
    ids=str,
)
def test_numbers_are_printed_to_the_second_digit_of_their_error(given, printed):
    assert sampling.with_error(*given) == printed


@pytest.mark.optimized
@pytest.mark.slow
@pytest.mark.parametrize("sampler", sampling.SAMPLERS)
def test_a_campaign_is_the_first_that_is_saved(sampler):
    mission = find_mission("mars-drag-tracking")
    scenario = mission.scenario()
    table = mission.dispersion_table(sampling.READINGS[mission.name])
    seed = list(sampling.SAMPLERS).index(sampler) * sampling.CAMPAIGNS
    campaign = monte_carlo(
        scenario,
        table,
        jax.random.key(seed),
        sampling.RUNS,
        sampler=sampling.SAMPLERS[sampler],
    )
    results = campaign.to_xarray(scenario)
    for output in sampling.OUTPUTS:
        values = np.abs(results[output.variable].values)[None] / output.size
        for heading, statistic in sampling.STATISTICS.items():
            saved = SAVED[mission.name, output.heading, heading, sampler]
            # Rounding of another compiler, see `first_sets`.
            assert statistic(values)[0] == pytest.approx(saved[0], rel=1e-6)
