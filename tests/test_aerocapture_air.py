"""The random air over Mars: its correlation, its size, and what is dispersed in it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry._computed_once import computed_once
from jentry.addresses import replace_leaves
from jentry.campaign.campaign import drawn_inputs
from jentry.missions import find_mission
from jentry.missions.mars_aerocapture.air_with_waves import wavelengths_and_shares
from jentry.units import degree, km


MISSION = find_mission("mars-aerocapture")
DRAWS = 2000
LENGTH = 120.0 * 4500.0


@computed_once
def factors():
    """Density over the undisturbed one for each draw (rows) at places along the equator
    that are 0, 0.5, 1 and 2 correlation lengths from the entry."""
    scenario = MISSION.scenario_of("predictor-corrector world random-air")
    table = MISSION.dispersion_table("random-air")
    inputs = drawn_inputs(scenario, table, jax.random.key(3), np.arange(DRAWS))
    waves = {k: jnp.asarray(x) for k, x in inputs.items() if "ground_waves" in k}
    assert len(waves) == 16

    high = jnp.asarray(50 * km)

    def along(drawn):
        air = replace_leaves(scenario, drawn).planet.atmosphere
        places = jnp.array([0.0, 0.5, 1.0, 2.0]) * LENGTH / scenario.planet.radius
        return jax.vmap(lambda x: air.column(x, 0.0 * x).factor(high))(places)

    return np.asarray(jax.jit(jax.vmap(along))(waves))


def test_the_waves_have_the_correlation_of_the_process():
    lengths, shares = np.array(wavelengths_and_shares()).T
    distance = np.linspace(0.0, 2.0 * LENGTH, 101)
    ours = np.sum(shares * np.cos(2.0 * np.pi * distance[:, None] / lengths), axis=1)
    # The terms of the series that are left out are 5 % of the variance; the shares of the
    # others are larger by as much.
    assert np.max(np.abs(ours - np.exp(-distance / LENGTH))) < 0.07
    assert np.sum(shares) == pytest.approx(1.0, rel=1e-12)


def test_drawn_air_varies_by_five_percent_with_that_correlation():
    off = factors() - 1.0
    # Five times the standard error of a mean, of a deviation and of a correlation.
    error = 5.0 / np.sqrt(DRAWS)
    assert np.all(np.abs(np.mean(off, axis=0)) < 0.05 * error)
    spread = np.sqrt(np.mean(off**2, axis=0))
    assert spread == pytest.approx(np.full(4, 0.05), rel=error / np.sqrt(2.0))
    found = np.corrcoef(off.T)[0]
    assert found == pytest.approx(np.exp([0.0, -0.5, -1.0, -2.0]), abs=error + 0.07)


def test_dispersions_are_those_of_the_source():
    """Its `medium` level: standard deviations, or halves of a uniform range."""
    table = MISSION.dispersion_table("random-air")
    spreads = {n: float(d.distribution.moments()[1]) for n, d in table.items()}
    normal = {"altitude": 100.0, "velocity": 1.0}
    angles = {"longitude": 0.1, "latitude": 0.05, "flight_path_angle": 0.1}
    angles |= {"heading": 0.05}
    uniform = {"density": 0.5, "drag": 0.05, "lift": 0.1, "mass": 0.01, "area": 0.02}
    expected = normal | {name: x * degree for name, x in angles.items()}
    expected |= {name: x / np.sqrt(3.0) for name, x in uniform.items()}
    assert {k: x for k, x in spreads.items() if " " not in k} == pytest.approx(expected)


def test_the_onboard_model_does_not_know_the_waves():
    usual = MISSION.scenario()
    random = MISSION.scenario_of("predictor-corrector world random-air")
    assert type(random.planet.atmosphere) is not type(usual.planet.atmosphere)
    same = dataclasses.replace(random, planet=usual.planet)
    assert jax.tree.structure(same) == jax.tree.structure(usual)
