"""The covariance of the navigation filter against derivatives and populations."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filter_flights import (
    ALTIMETER,
    DOPPLER,
    DRAG,
    KNOWN,
    SENSING,
    TERRAIN,
    TURNING,
    aided,
    drawn,
    errors_of,
)

from jentry import fly
from jentry.flight import FixedStep
from jentry.statistics import consistency


@pytest.mark.slow
def test_the_covariance_is_that_of_the_derivatives_of_the_flight():
    """Without sensors and noise: J C J', with J from exact derivatives of a whole flight
    with respect to its 20 errors. The filter steps by one second to the second order."""
    scenario = eqx.tree_at(
        lambda s: (
            s.navigation.filter.velocity_random_walk,
            s.navigation.filter.angle_random_walk,
        ),
        aided({}, noise=False),
        (jnp.asarray(0.0), jnp.asarray(0.0)),
    )
    sizes, structure = jax.tree.flatten((KNOWN, SENSING, TURNING))

    def end(values):
        errors = jax.tree.unflatten(structure, list(values))
        known = fly(eqx.tree_at(errors_of, scenario, errors), FixedStep(0.5)).knowledge
        assert known is not None
        return jnp.stack(jax.tree.leaves(known.error)), known.deviation

    slopes, found = jax.jit(jax.jacfwd(end, has_aux=True))(jnp.zeros(20))
    expected = np.sqrt(np.sum(np.square(np.asarray(slopes) * np.array(sizes)), axis=1))
    np.testing.assert_allclose(jax.tree.leaves(found), expected, rtol=2e-3)


SETS = {
    "inertial": (),
    "altimeter": ("altimeter",),
    "terrain": ("terrain",),
    "Doppler": ("doppler",),
    "drag": ("drag",),
    "all": ("altimeter", "doppler", "terrain", "drag"),
}


@pytest.fixture(scope="module")
def normalised():
    """Normalised errors squared of many flights, by the sensors that measure.

    The others are switched off by their limits, so that all sets share one program.
    """
    sensors = {
        "altimeter": ALTIMETER,
        "terrain": TERRAIN,
        "doppler": DOPPLER,
        "drag": DRAG,
    }
    never = {name: "largest_altitude" for name in sensors} | {"drag": "least_drag"}

    @eqx.filter_jit
    def fly_many(scenario, keys):
        flights = jax.vmap(lambda key: fly(drawn(scenario, key), FixedStep(1.0)))(keys)
        return flights.knowledge.normalised_error_squared

    def find(measuring, blocks, change=lambda scenario: scenario):
        mine = {
            name: sensor
            if name in measuring
            else dataclasses.replace(
                sensor, **{never[name]: 1e9 if name == "drag" else -1e9}
            )
            for name, sensor in sensors.items()
        }
        scenario, values = change(aided(mine)), []
        for block in range(blocks):
            keys = jax.random.split(jax.random.key(28 + block), 100)
            values.append(np.asarray(fly_many(scenario, keys)))
        return consistency(np.concatenate(values))

    return find


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_the_filter_is_consistent(normalised, name):
    """500 flights with errors as assumed: the average normalised error squared is within
    its 99 % bounds. The seeds count from the day of the month: none was chosen. With
    blocks=20, which are 2000 flights, it holds as well."""
    test = normalised(SETS[name], blocks=5)
    assert test.runs == 500
    assert test.holds, test


@pytest.mark.slow
def test_a_wrong_density_makes_the_drag_a_liar(normalised):
    """A density 10 % above the model, and 5 % assumed as if independent: the filter
    believes too much of itself."""

    def denser(scenario):
        lens = lambda s: s.planet.density_scale
        return eqx.tree_at(lens, scenario, jnp.asarray(1.1, float))

    test = normalised(SETS["drag"], 1, denser)
    assert test.average > 2.0 * test.upper


def test_bounds_are_those_of_chi_square():
    """2000 flights of nine errors: 9 within 2.7 % by the normal limit of chi-square."""
    test = consistency(np.full(2000, 9.0))
    width = 2.576 * np.sqrt(2.0 * 9.0 / 2000.0)
    assert test.lower == pytest.approx(9.0 - width, abs=0.01)
    assert test.upper == pytest.approx(9.0 + width, abs=0.01)
    assert test.holds and not consistency(np.full(2000, 9.4)).holds
    for wrong in ([], [np.nan], [-1.0]):
        with pytest.raises(ValueError, match="flights|finite"):
            consistency(np.array(wrong))
    with pytest.raises(ValueError, match="confidence is 1"):
        consistency(np.ones(3), confidence=1.0)
