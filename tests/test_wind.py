"""Winds: what blows where, and how a table of it is joined."""

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, over
from scipy.interpolate import PchipInterpolator
from worlds import (
    EAST_WIND as EAST,
    NORTH_WIND as NORTH,
    WIND_ALTITUDES as ALTITUDES,
    all_winds,
)

from jentry.addresses import replace_leaves
from jentry.campaign import Dispersion, Uniform, monte_carlo, multiply
from jentry.world import ConstantWind, ScaledWind, StillAir, TabulatedWind


@pytest.fixture(params=all_winds)
def wind(request):
    return all_winds[request.param]()


def test_gradient_matches_finite_differences(wind):
    velocity = jax.jit(lambda z: jnp.stack(wind.velocity(z)))
    slope = jax.jit(jax.jacfwd(velocity))
    for z in jnp.asarray([-50.0, 320.0, 4999.0, 5001.0, 12.5e3, 44e3, 70e3]):
        numeric = (velocity(z + 0.1) - velocity(z - 0.1)) / 0.2
        # Rounding of 50 m/s over a step of 0.1 m, and the curvature of a cubic.
        np.testing.assert_allclose(slope(z), numeric, rtol=1e-6, atol=1e-12)


def test_vmap_equals_loop(wind):
    z = jnp.linspace(-1e3, 80e3, 23)
    velocity = jax.jit(lambda z: jnp.stack(wind.velocity(z)))
    loop = [velocity(altitude) for altitude in z]
    batch = over(velocity)(z)
    # The same operations in another order of fusion: rounding of 50 m/s.
    np.testing.assert_allclose(batch, loop, rtol=1e-13, atol=1e-12)


def test_table_agrees_with_the_monotone_cubic_of_scipy():
    z = jnp.linspace(0.0, 60e3, 601)
    east, north, up = over(TabulatedWind(ALTITUDES, EAST, NORTH).velocity)(z)
    # Two implementations of one formula: rounding of 50 m/s.
    np.testing.assert_allclose(east, PchipInterpolator(ALTITUDES, EAST)(z), atol=1e-12)
    np.testing.assert_allclose(
        north, PchipInterpolator(ALTITUDES, NORTH)(z), atol=1e-12
    )
    np.testing.assert_array_equal(up, 0.0)


def test_table_is_held_beyond_its_ends():
    wind = TabulatedWind(ALTITUDES, EAST, NORTH)
    assert wind.velocity(jnp.asarray(-500.0)) == (2.0, 0.0, 0.0)
    assert wind.velocity(jnp.asarray(200e3)) == (-30.0, 5.0, 0.0)


@pytest.mark.parametrize(
    "values", [EAST, NORTH, 0.0 * EAST], ids=["east", "north", "0"]
)
def test_table_is_differentiable_in_its_values(values):
    """Also where two values are equal, and where all of them are zero."""

    def east(values):
        return TabulatedWind(ALTITUDES, values, NORTH).velocity(jnp.asarray(9e3))[0]

    slopes = jax.grad(east)(values)
    assert np.all(np.isfinite(slopes))
    # A cubic through equal values is that value.
    assert float(jnp.sum(slopes)) == pytest.approx(1.0, rel=1e-12)


def test_two_altitudes_are_joined_by_a_straight_line():
    wind = TabulatedWind([0.0, 10e3], [0.0, 20.0], [5.0, 5.0])
    east, north, _ = wind.velocity(jnp.asarray(2.5e3))
    assert (float(east), float(north)) == (5.0, 5.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0, 1.0], [1.0], [1.0, 2.0]), r"east has shape \(1,\): .* \(2,\)"),
        (([0.0, 1.0], [1.0, 2.0], [1.0]), r"north has shape \(1,\): .* \(2,\)"),
        (([1.0, 0.0], [1.0, 2.0], [1.0, 2.0]), "altitudes must increase"),
    ],
)
def test_table_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        TabulatedWind(*arguments)


def test_csv_is_read(tmp_path):
    path = tmp_path / "sounding.csv"
    path.write_text("altitude_m,east_m_s,north_m_s\n0,1,2\n1000,3,4\n")
    wind = TabulatedWind.from_csv(path)
    np.testing.assert_array_equal(wind.altitudes, [0.0, 1000.0])
    np.testing.assert_array_equal(wind.east, [1.0, 3.0])
    np.testing.assert_array_equal(wind.north, [2.0, 4.0])


def test_csv_errors_name_file_line_and_expectation(tmp_path):
    path = tmp_path / "sounding.csv"
    path.write_text("altitude_m,east_m_s,north_m_s\n0,1,2\n-5,3,4\n")
    with pytest.raises(
        ValueError, match="sounding.csv, line 3: altitude_m is -5 after"
    ):
        TabulatedWind.from_csv(path)


def in_wind(wind):
    scenario = cheap.scenario()
    return eqx.tree_at(
        lambda s: s.planet.wind,
        scenario,
        wind,
        is_leaf=lambda x: isinstance(x, StillAir),
    )


def test_a_scale_of_one_is_the_wind_itself():
    wind = TabulatedWind(ALTITUDES, EAST, NORTH)
    scaled = ScaledWind(wind)
    for z in jnp.asarray([-5.0, 3e3, 12.5e3, 90e3]):
        assert scaled.velocity(z) == wind.velocity(z)
        doubled = ScaledWind(wind, 2.0).velocity(z)
        assert doubled == tuple(2.0 * x for x in wind.velocity(z))


@pytest.mark.slow
def test_a_flight_in_a_scaled_wind_is_that_in_the_wind_that_it_is():
    """Bit by bit at 1, and at another scale as in a wind of so many times the speed."""
    windy = ConstantWind(40.0, -25.0, 1.0)
    flights = {
        scale: fly_compiled(in_wind(ScaledWind(windy, scale)), cheap.SOLVER)
        for scale in (1.0, 2.0)
    }
    same = fly_compiled(in_wind(windy), cheap.SOLVER)
    assert all(map(np.array_equal, *map(jax.tree.leaves, (flights[1.0], same))))
    double = fly_compiled(in_wind(ConstantWind(80.0, -50.0, 2.0)), cheap.SOLVER)
    assert all(map(np.array_equal, *map(jax.tree.leaves, (flights[2.0], double))))
    assert flights[1.0].state.longitude != flights[2.0].state.longitude


TABLE = {
    "wind": Dispersion(lambda s: s.planet.wind.scale, Uniform(-2.0, 2.0), multiply)
}


@pytest.mark.slow
def test_a_scale_is_dispersed_by_its_address(key):
    scenario = in_wind(ScaledWind(ConstantWind(40.0, -25.0, 1.0)))
    campaign = monte_carlo(scenario, TABLE, key, 3, solver=cheap.SOLVER)
    scales = campaign.inputs["planet.wind.scale"]
    assert np.all(np.abs(scales) <= 2.0) and len(np.unique(scales)) == 3
    for scale, longitude in zip(scales, campaign.flights.state.longitude, strict=True):
        one = replace_leaves(scenario, {"planet.wind.scale": scale})
        # One flight alone and side by side: rounding, over some thousand steps.
        expected = fly_compiled(one, cheap.SOLVER).state.longitude
        assert longitude == pytest.approx(float(expected), rel=1e-10)


def test_still_air_is_not_scaled():
    with pytest.raises(ValueError, match="StillAir is scaled, and a factor on no wind"):
        ScaledWind(StillAir(), 2.0)
