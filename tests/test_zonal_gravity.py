"""Gravity with zonal harmonics, against closed forms and vectors."""

import dataclasses

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import oblate
import pytest
from helpers import mars_planet, mars_scenario, mars_vehicle
from override_files import read, write_overrides
from scipy.special import eval_legendre
from worlds import WGS_84

from jentry.addresses import leaves_by_address
from jentry.campaign import Dispersion, Uniform, monte_carlo
from jentry.cli.overrides import apply_values
from jentry.motion import Controls, entry_dynamics, equatorial_dynamics
from jentry.world import ZonalGravity


# EGM96 without normalisation: J_n = -sqrt(2 n + 1) times the normalised coefficients.
J2, J3, J4 = 1.08262668e-3, -2.53266e-6, -1.61962e-6
MU, RADIUS = 3.986004418e14, 6378137.0


def gravity(**harmonics):
    return ZonalGravity(MU, RADIUS, harmonics or {"j2": J2})


def scalars(*numbers):
    return [jnp.asarray(float(x)) for x in numbers]


@pytest.mark.parametrize("latitude", [-1.5, -0.4, 0.0, 0.9, np.pi / 2])
def test_j2_is_that_of_the_textbooks(latitude):
    r, s = 6.6e6, np.sin(latitude)
    down, north = gravity().components(*scalars(r, latitude))
    share = 1.5 * J2 * (RADIUS / r) ** 2
    expected = MU / r**2 * (1.0 - share * (3.0 * s**2 - 1.0))
    assert float(down) == pytest.approx(expected, rel=1e-15)
    aside = -2.0 * MU / r**2 * share * s * np.cos(latitude)
    assert float(north) == pytest.approx(aside, rel=1e-12, abs=1e-17)


def test_the_potential_has_the_polynomials_of_scipy():
    names = {f"j{n}": 1e-3 / n for n in (2, 5, 3, 11, 8)}
    r, latitude = 7e6, -0.7
    found = gravity(**names).potential_at(*scalars(r, latitude))
    total = 1.0 - sum(
        x * (RADIUS / r) ** int(n[1:]) * eval_legendre(int(n[1:]), np.sin(latitude))
        for n, x in names.items()
    )
    assert float(found) == pytest.approx(-MU / r * total, rel=1e-15)


@pytest.mark.parametrize("latitude", [-1.2, 0.0, 0.4, 1.5])
def test_components_are_minus_the_gradient_of_a_potential_in_vectors(latitude):
    body = oblate.Body(MU, RADIUS, {2: J2, 3: J3, 4: J4}, 0.0, RADIUS, 0.0)
    r, c, s = 6.5e6, np.cos(latitude), np.sin(latitude)
    expected = body.gravity(r * np.array([c, 0.0, s]))
    there = scalars(r, latitude)
    down, north = gravity(j2=J2, j3=J3, j4=J4).components(*there)
    assert float(down) == pytest.approx(-expected @ [c, 0.0, s], rel=1e-14)
    # Rounding of the parts of 10 m/s2 that cancel.
    assert float(north) == pytest.approx(expected @ [-s, 0.0, c], abs=1e-14)


def test_derivatives_of_any_order_agree_in_both_modes_at_a_pole():
    potential = gravity(j2=J2, j3=J3).potential_at
    pole = scalars(6.5e6, np.pi / 2)
    slope = lambda *x: jax.grad(potential, 1)(*x)
    forward = jax.jacfwd(slope, (0, 1))(*pole)
    reverse = jax.jacrev(slope, (0, 1))(*pole)
    np.testing.assert_allclose(forward, reverse, rtol=1e-13, atol=1e-13)
    assert np.all(np.isfinite(forward))


@pytest.mark.parametrize(
    ("harmonics", "message"),
    [
        ({}, "is empty"),
        ({"j1": 0.0}, "name 'j1'"),
        ({"J2": 1e-3}, "expected j2, j3"),
        ([1e-3], r"zonal_harmonics is \[0.001\]: give the coefficients by their names"),
        (1e-3, "is 0.001: give"),
    ],
)
def test_harmonics_with_other_names_are_refused(harmonics, message):
    with pytest.raises(ValueError, match=message):
        ZonalGravity(MU, RADIUS, harmonics)


@pytest.mark.parametrize("name", ["acceleration", "potential"])
def test_a_gravity_of_the_radius_alone_is_refused(name):
    with pytest.raises(ValueError, match="depends on the latitude.*InverseSquare"):
        getattr(gravity(), name)(jnp.asarray(7e6))


def on_the_equator(**harmonics):
    planet = mars_planet(rotation_rate=7e-5)
    return dataclasses.replace(
        planet,
        gravity=ZonalGravity(4.28283e13, 3396e3, harmonics),
        shape=dataclasses.replace(WGS_84, equatorial_radius=jnp.asarray(3396e3)),
    )


def test_flight_along_the_equator_has_harmonics_of_even_degree():
    planet, state = on_the_equator(j2=2e-3, j4=-1e-5), mars_scenario().initial_state
    state = dataclasses.replace(state, altitude=jnp.asarray(40e3))
    upright = Controls(*scalars(0.0, 1.0, 0.0))
    plane = equatorial_dynamics(planet, mars_vehicle(), state, upright)
    space = entry_dynamics(planet, mars_vehicle(), state, upright)
    for a, b in zip(jax.tree.leaves(plane), jax.tree.leaves(space), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


def test_flight_along_the_equator_refuses_harmonics_of_odd_degree():
    planet = on_the_equator(j2=2e-3, j3=1e-5)
    state = mars_scenario().initial_state
    with pytest.raises(ValueError, match="harmonics j3, which pull out of the plane"):
        equatorial_dynamics(planet, mars_vehicle(), state, Controls(*scalars(0, 1, 0)))


def oblate_scenario():
    scenario = cheap.scenario()
    start = dataclasses.replace(scenario.initial_state, latitude=jnp.asarray(0.6))
    radius = scenario.planet.radius
    planet = dataclasses.replace(
        scenario.planet,
        gravity=ZonalGravity(4.28283e13, 3396e3, {"j2": 1.9566e-3, "j3": 3.1e-5}),
        shape=dataclasses.replace(WGS_84, equatorial_radius=radius),
    )
    return dataclasses.replace(scenario, planet=planet, initial_state=start)


MOVES = {
    "planet.gravity.gravitational_parameter": 1.001,
    "planet.gravity.reference_radius": 1.01,
    "planet.gravity.zonal_harmonics.j2": 1.01,
    "planet.gravity.zonal_harmonics.j3": 2.0,
    "planet.shape.equatorial_radius": 1.0001,
    "planet.shape.flattening": 1.01,
}


def test_every_number_of_an_oblate_planet_changes_the_flight():
    scenario = oblate_scenario()
    leaves = leaves_by_address(scenario)
    rows = [dict.fromkeys(MOVES, 1.0), *({a: x} for a, x in MOVES.items())]
    inputs = {a: [float(leaves[a]) * row.get(a, 1.0) for row in rows] for a in MOVES}
    ends = monte_carlo(scenario, inputs=inputs, solver=cheap.SOLVER).flights.state
    moved = np.abs(np.asarray(ends.longitude)[1:] - float(ends.longitude[0]))
    # A metre over the ground is 3e-7 rad; rounding is 1e-15.
    assert np.all(moved > 1e-10), dict(zip(MOVES, moved, strict=True))


def test_the_numbers_of_an_oblate_planet_are_drawn():
    table = {
        "j2": Dispersion(
            lambda s: s.planet.gravity.zonal_harmonics["j2"], Uniform(1e-3, 3e-3)
        ),
        "flattening": Dispersion(
            lambda s: s.planet.shape.flattening, Uniform(0.0, 0.01)
        ),
    }
    campaign = monte_carlo(oblate_scenario(), table, 0, runs=4, solver=cheap.SOLVER)
    drawn = campaign.inputs["planet.gravity.zonal_harmonics.j2"]
    assert np.all((drawn > 1e-3) & (drawn < 3e-3)) and len(np.unique(drawn)) == 4
    assert "planet.shape.flattening" in campaign.inputs


def test_the_numbers_of_an_oblate_planet_are_written_and_set(tmp_path):
    """To a TOML file and from it, and from an assignment of the command line."""
    scenario, path = oblate_scenario(), tmp_path / "moved.toml"
    leaves = leaves_by_address(scenario)
    moved = {address: 1.1 * float(leaves[address]) for address in MOVES}
    write_overrides(path, "", "right", moved, "all")
    j3 = "planet.gravity.zonal_harmonics.j3"
    values = read(path, [f"{j3}=4e-5"], scenario=scenario).values
    assert values == moved | {j3: 4e-5}
    found = leaves_by_address(apply_values(scenario, values))
    assert {address: float(found[address]) for address in MOVES} == values


def test_a_scenario_with_an_oblate_planet_is_printed():
    text = str(oblate_scenario().planet)
    assert "zonal harmonics" in text and "flattening" in text
