"""The RLV mission: both laws, nominal and dispersed."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from first_sets import populations

from jentry import find_mission, fly, linearize, monte_carlo
from jentry.addresses import leaves_by_address
from jentry.campaign.campaign import drawn_inputs
from jentry.campaign.dispersions import check_dispersions
from jentry.cli.overrides import apply_values, in_si, read_overrides
from jentry.cli.tuning_options import parse_scales
from jentry.flight import Outcome
from jentry.units import degree, standard_gravity


MISSION = find_mission("rlv")


def test_readings_and_variants():
    assert set(MISSION.dispersions) == {
        "table-1",
        "table-1-noise",
        "table-1-estimated-angle",
        "atmosphere",
        "knowledge",
        "table-1-and-knowledge",
    }
    noise = set(MISSION.dispersion_table("table-1-noise"))
    assert noise - set(MISSION.dispersion_table("table-1")) == {"noise seed"}
    sensed = MISSION.scenario_of(
        "lag-inverted world attitude-3 world noise"
    ).accelerometers
    assert float(sensed.noise) == pytest.approx(2e-4 * standard_gravity)
    flown = MISSION.scenario("shuttle-as-flown").guidance.angle_of_attack
    assert float(flown.cycle.period) == 1.92
    assert float(flown.law.dead_band) == pytest.approx(0.15 * 0.3048)
    assert float(flown.law.limit) == pytest.approx(2.0 * degree)
    table = MISSION.dispersion_table("table-1-estimated-angle")
    scenario = MISSION.scenario("shuttle")
    deviations = {name: d.distribution.moments()[1] for name, d in table.items()}
    expected = {
        "flight-path angle": 0.1 * degree / 3.0,
        "lift": 0.10 / 3.0,
        "drag": 0.15 / 3.0,
        "density trend": 1.0 / 3.0,
        "long wave": 0.05 / 3.0,
        "short wave": 0.02 / 3.0,
        "ground wave": 0.02 / 3.0,
    }
    for name, deviation in expected.items():
        assert float(deviations[name]) == pytest.approx(deviation), name
    air = scenario.planet.atmosphere
    for altitude, share in ((20e3, 0.10), (30e3, 0.10), (80e3, 0.25), (150e3, 0.35)):
        trend = dataclasses.replace(air, trend=jnp.asarray(1.0))
        factor = float(trend.factor(jnp.asarray(altitude)))
        assert factor == pytest.approx(1.0 + share)


def test_noise_is_another_in_each_flight():
    scenario = MISSION.scenario_of("lag-inverted world attitude-3 world noise")
    check_dispersions(scenario, MISSION.dispersion_table("table-1-noise"))
    with pytest.raises(ValueError, match="all runs would have the same: disperse"):
        check_dispersions(scenario, MISSION.dispersion_table("table-1"))


def test_tuning_is_of_the_deviations_and_not_of_the_range():
    scaled = parse_scales(
        MISSION.tuned_for, MISSION.scenario_of("lag-inverted world attitude-3")
    )
    names = {"drag_deviation", "angle_of_attack_deviation"}
    assert MISSION.modes_faster_than == 0.2  # rad/s: the phugoid is slower
    assert {name for name, _ in scaled.scales} == names
    missed = {
        "drag_deviation": jnp.array([8e-4]),
        "angle_of_attack_deviation": jnp.array([5.0 * degree]),
    }
    assert [float(x[0]) for x in scaled(missed)] == pytest.approx([2.0, 0.5])


def test_the_published_bound_is_of_the_worst_run():
    (published,) = MISSION.published
    assert (published.value, MISSION.published_runs) == (2e-3, 500)
    runs = {"peak_drag_deviation": np.array([1e-3, 3e-3, 2e-3])}
    assert published.statistic(runs) == 3e-3


RUNS = 500
"""Of the first of the three sets that the README speaks of"""


def drawn_and_nominal(scenario, reading, seed, runs=RUNS):
    """What is drawn for each run, by address; the nominal values last."""
    table = MISSION.dispersion_table(reading)
    drawn = drawn_inputs(scenario, table, jax.random.key(seed), np.arange(runs))
    known = leaves_by_address(scenario)
    return {
        address: np.append(values, float(known[address]))
        for address, values in drawn.items()
    }


def peaks(scenario, inputs):
    """Largest error of the drag below 7000 m/s of each run (1e-3 g), and largest deviation
    of the angle of attack (deg)."""
    found = monte_carlo(scenario, inputs=inputs)
    assert np.all(np.asarray(found.flights.outcome) == Outcome.REACHED)
    known = found.flights.peaks
    return 1e3 * known["drag_deviation"], known["angle_of_attack_deviation"] / degree


def drag_errors(variant, reading, seed):
    scenario = MISSION.scenario_of(variant)
    return peaks(scenario, drawn_and_nominal(scenario, reading, seed))[0]


SLOW = [pytest.mark.slow, pytest.mark.optimized]

BARS = [
    # nominal and median, a percentile and its bound, 1e-3 g, as the README has them
    pytest.param(
        "modulation", "table-1", 2.0, 2.0, 99.7, 2.6, marks=SLOW, id="modulated"
    ),
    pytest.param(
        "shuttle",
        "table-1-estimated-angle",
        8.5,
        17.8,
        100.0,
        20.0,
        marks=SLOW,
        id="Shuttle",
    ),
    pytest.param(
        "shuttle-quarter",
        "table-1-estimated-angle",
        2.2,
        4.6,
        100.0,
        5.5,
        marks=SLOW,
        id="Shuttle, a quarter",
    ),
]


@pytest.mark.parametrize(
    ("variant", "reading", "nominal", "median", "share", "most"), BARS
)
def test_both_laws_track_the_drag_as_well_as_an_independent_program_does(
    variant, reading, nominal, median, share, most
):
    """The notes have nominal errors of 2.0 and 8.0, medians of 2.0 and 17 and bounds of 2.6
    and 20."""
    *errors, alone = drag_errors(variant, reading, seed=0)
    assert alone == pytest.approx(nominal, abs=0.05)
    assert np.median(errors) == pytest.approx(median, abs=0.05)
    assert np.percentile(errors, share) <= most


@pytest.mark.slow
@pytest.mark.optimized
def test_a_fast_attitude_keeps_the_error_of_the_paper():
    """Below 2e-3 g in all runs."""
    errors = drag_errors("modulation-fast-observer world attitude-8", "table-1", seed=0)
    assert np.max(errors) < 2.0
    assert errors[-1] == pytest.approx(1.3, abs=0.05)


def tuned(variant):
    given = read_overrides(populations.SAVED.with_name("tuned-rlv.toml"))
    start = MISSION.scenario_of(variant)
    return apply_values(start, in_si(given, start).values)


@pytest.mark.slow
@pytest.mark.optimized
def test_tuned_gains_of_a_slow_attitude():
    """Without noise and with it, as the README has it.

    Asked for are 0.4 nominally, 0.5 in all runs and 7 degrees of the angle of attack, which
    the nominal flight keeps; and 0.7 with noise, which is missed: see below.
    """
    scenario = tuned("lag-inverted world attitude-3 world noise")
    # That of the tuning is 0.
    inputs = drawn_and_nominal(scenario, "table-1-noise", seed=1)
    inputs = {address: np.tile(values, 2) for address, values in inputs.items()}
    noise = float(scenario.accelerometers.noise)
    inputs["accelerometers.noise"] = np.repeat([0.0, noise], RUNS + 1)
    flown = zip(*(np.split(x, 2) for x in peaks(scenario, inputs)), strict=True)
    expected = (0.26, 0.265, 0.48), (0.645, 0.63, 0.95)
    for (errors, angles), (nominal, median, most) in zip(flown, expected, strict=True):
        assert errors[-1] == pytest.approx(nominal, abs=0.01)
        assert np.median(errors) == pytest.approx(median, abs=0.01)
        assert np.max(errors) < most
        assert angles[-1] == pytest.approx(6.77, abs=0.01)
        assert np.median(angles) == pytest.approx(6.7, abs=0.1)
        assert np.max(angles) < 11.5


@pytest.mark.slow
@pytest.mark.optimized
def test_more_samples_keep_the_noise_out():
    """In cycles of 0.05 s; asked for is 0.7 in all runs."""
    scenario = MISSION.scenario_of("lag-inverted-fast world attitude-3 world noise")
    inputs = drawn_and_nominal(scenario, "table-1-noise", seed=1)
    errors, angles = peaks(scenario, inputs)
    assert errors[-1] == pytest.approx(0.39, abs=0.01)
    assert np.median(errors) == pytest.approx(0.34, abs=0.01)
    assert np.max(errors) < 0.55
    assert angles[-1] == pytest.approx(6.76, abs=0.01)


@pytest.mark.slow
def test_the_bank_feedback_brings_the_angle_of_attack_back():
    """Nominal, with and without k1 and k2, as the README has it; the Shuttle as flown."""
    gains = "guidance.angle_of_attack.gains"
    inputs = {f"{gains}.bank_deviation": [4.0, 0.0], f"{gains}.bank_rate": [-0.15, 0.0]}
    inputs = {name: np.array(values) for name, values in inputs.items()}
    found = monte_carlo(MISSION.scenario_of("modulation"), inputs=inputs).flights.peaks
    angles = found["angle_of_attack_deviation"] / degree
    assert angles == pytest.approx([8.9, 16.9], abs=0.1)
    flight = eqx.filter_jit(fly)(MISSION.scenario("shuttle-as-flown"))
    assert 1e3 * float(flight.peaks["drag_deviation"]) == pytest.approx(34.6, abs=0.1)


def least_damping(scenario):
    return linearize(scenario, points=120).least_damping_of(0.2).value


@pytest.mark.slow
def test_least_damping_with_tuned_gains():
    """As the README has it; asked for is 0.2."""
    assert least_damping(tuned("lag-inverted world attitude-3")) == pytest.approx(
        0.63, abs=0.02
    )
