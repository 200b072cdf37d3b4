"""No number from beyond a table without a word: shares, distances, refusals."""

import dataclasses

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, free_scenario

from jentry.campaign import monte_carlo
from jentry.campaign.results import dataset
from jentry.cli.campaign_report import print_campaign
from jentry.cli.mission_report import print_flight
from jentry.flight import Adaptive, Outcome, fly, has_end
from jentry.flight.closed_loop import caveat_names
from jentry.flight.scenario_checks import checked
from jentry.statistics.acceptance import Requirement, require_outputs
from jentry.statistics.summary import summarize
from jentry.units import degree, km
from jentry.world import (
    EnsembleAtmosphere,
    EnsembleWind,
    PerturbedAtmosphere,
    ScaledWind,
    SmoothedAtmosphere,
    TabulatedAerodynamics,
    TabulatedAtmosphere,
    TabulatedWind,
    smoothed,
    without_zero_perturbations,
)
from jentry.world.tabulated import beyond_edges, tables_in


HIGH, LOW = 60 * km, 30 * km
"""Of the tables of air and wind; the flight begins above and ends below"""
MACHS = 2.0, 20.0
STEP = 1.0

AIR = "time_beyond_altitudes_of_planet_atmosphere"
WIND = "time_beyond_altitudes_of_planet_wind_wind"
MACH = "time_beyond_mach_numbers_of_vehicle_aerodynamics"
ANGLE = "time_beyond_angles_of_attack_of_vehicle_aerodynamics"


def air(refuse=False, low=LOW, high=HIGH):
    """Exponential between the ends of the table, and so beyond them too."""
    known = free_scenario().planet.atmosphere
    altitudes = jnp.linspace(low, high, 31)
    densities = jax.vmap(known.density)(altitudes)
    return TabulatedAtmosphere(altitudes, densities, refuse_beyond=refuse)


def wind():
    altitudes = jnp.linspace(LOW, HIGH, 4)
    return ScaledWind(TabulatedWind(altitudes, 5.0 + 0 * altitudes, 0 * altitudes))


def coefficients(refuse=False, machs=MACHS, angles=(-0.2, 0.2)):
    given = free_scenario().vehicle
    lift, drag = given.coefficients(jnp.array(0.0), jnp.array(5.0), jnp.array(1e3))
    ones = jnp.ones((2, 2))
    angles, machs = jnp.array(angles), jnp.array(machs)
    return TabulatedAerodynamics(
        angles, machs, lift * ones, drag * ones, refuse_beyond=refuse
    )


def tabulated(**models):
    """The free flight, in air, wind and with coefficients from tables."""
    chosen = {"air": air(), "wind": wind(), "aerodynamics": coefficients()} | models
    given = free_scenario(40 * degree)
    planet = dataclasses.replace(
        given.planet, atmosphere=chosen["air"], wind=chosen["wind"]
    )
    vehicle = dataclasses.replace(given.vehicle, aerodynamics=chosen["aerodynamics"])
    return dataclasses.replace(given, planet=planet, vehicle=vehicle)


@pytest.fixture(scope="module")
def flight():
    return fly_compiled(tabulated(), cheap.SOLVER, STEP)


def shares_by_hand(outside, time):
    """The share of whole steps that end outside, and of the last, shorter one."""
    ends = np.append(np.diff(time), 0.0)
    assert np.all(ends >= 0.0)
    return np.sum(np.where(outside[1:], ends[:-1], 0.0)) / time[-1]


def path(flight):
    """Time, altitude and Mach number after each step, the end among them."""
    history = flight.history
    n = int(np.sum(np.isfinite(np.asarray(history.time))))
    time = np.append(np.asarray(history.time)[:n], float(flight.time))
    altitude = np.append(
        np.asarray(history.states.altitude)[:n], float(flight.state.altitude)
    )
    velocity = np.append(
        np.asarray(history.states.velocity)[:n], float(flight.state.velocity)
    )
    return time, altitude, velocity


def test_share_and_distance_are_those_of_the_flight(flight):
    """From the altitudes that the flight had, in numpy."""
    time, altitude, _ = path(flight)
    assert altitude[0] > HIGH + km and altitude[-1] < LOW
    for name in (AIR, WIND):
        outside = (altitude > HIGH) | (altitude < LOW)
        share = shares_by_hand(outside, time)
        assert 0.2 < share < 0.9
        assert float(flight.caveats[name]) == pytest.approx(share, rel=1e-9)
        farthest = max(altitude.max() - HIGH, LOW - altitude.min())
        assert float(flight.beyond_tables[name]) == pytest.approx(farthest, rel=1e-9)


def test_mach_numbers_are_those_over_the_air(flight):
    """With the wind, and at the speed of sound of the table."""
    time, _, velocity = path(flight)
    sound = np.sqrt(1.4 * 287.05287 * 246.0)
    distance = float(flight.beyond_tables[MACH])
    # The wind is 5 m/s, and nearly along or against the flight: 0.016 of a Mach number.
    largest = velocity.max() / sound - MACHS[1], MACHS[0] - velocity.min() / sound
    assert distance == pytest.approx(max(largest), abs=5.0 / sound)
    assert distance > 0.1
    outside = (velocity / sound > MACHS[1]) | (velocity / sound < MACHS[0])
    share = shares_by_hand(outside, time)
    assert float(flight.caveats[MACH]) == pytest.approx(share, abs=3.0 / time[-1])


def test_what_is_within_says_nothing(flight):
    assert float(flight.caveats[ANGLE]) == 0.0
    assert float(flight.beyond_tables[ANGLE]) == 0.0


def test_names_are_known_before_the_flight(flight):
    names = caveat_names(tabulated())
    assert set(names) == set(flight.caveats) == {AIR, WIND, MACH, ANGLE}
    requirement = Requirement.of(f"{AIR} < 0.5, 90 % at 90 %")
    require_outputs([requirement], tabulated(), [])
    with pytest.raises(ValueError, match=AIR):
        require_outputs([requirement], free_scenario(), [])


def test_nothing_is_carried_where_nothing_is_tabulated():
    shapes = eqx.filter_eval_shape(fly, free_scenario(), cheap.SOLVER)
    assert shapes.caveats == {} and shapes.beyond_tables == {}


@pytest.mark.parametrize(
    "angle, beyond",
    [
        (0.3, 0.0),
        (0.1 + 0.2, 0.0),  # by rounding larger than the edge
        (-40 * degree, 40 * degree - 0.1),
        (0.31, 0.01),
    ],
)
def test_an_edge_belongs_to_the_table(angle, beyond):
    table = coefficients(angles=(-0.1, 0.3))
    values = {"mach_numbers": jnp.array(3.0), "angles_of_attack": jnp.array(angle)}
    found, refused = beyond_edges({"vehicle.aerodynamics": table}, **values)
    if beyond == 0.0:
        assert float(found[ANGLE]) == 0.0
    else:
        assert float(found[ANGLE]) == pytest.approx(beyond, abs=1e-12)
    assert float(found[MACH]) == 0.0 and not bool(refused)


@pytest.mark.parametrize("mach, beyond", [(60.0, 40.0), (1.5, 0.5), (20.0, 0.0)])
def test_mach_numbers_beyond_either_edge(mach, beyond):
    values = {"mach_numbers": jnp.array(mach), "angles_of_attack": jnp.array(0.0)}
    for refuses in (False, True):
        table = {"vehicle.aerodynamics": coefficients(refuses)}
        found, refused = beyond_edges(table, **values)
        assert float(found[MACH]) == beyond
        assert bool(refused) == (refuses and beyond > 0.0)


def test_a_refusing_table_ends_the_flight_before_its_edge(flight):
    """At the last step within it; what is flown up to there is as without."""
    within = coefficients(machs=(2.0, 40.0))
    table = air(refuse=True, high=200 * km)
    ended = fly_compiled(tabulated(air=table, aerodynamics=within), cheap.SOLVER, STEP)
    assert Outcome(int(ended.outcome)) is Outcome.BEYOND_TABLE
    assert not has_end(ended.outcome)
    altitude = float(ended.state.altitude)
    assert LOW < altitude < LOW + 2.0 * km
    assert float(ended.caveats[AIR]) == 0.0
    on = fly_compiled(
        tabulated(air=air(high=200 * km), aerodynamics=within), cheap.SOLVER, STEP
    )
    place = round(float(ended.time) / STEP)
    assert altitude == pytest.approx(float(on.history.states.altitude[place]), rel=1e-9)
    assert float(on.history.states.altitude[place + 1]) < LOW
    assert "refuse_beyond" in Outcome.BEYOND_TABLE.message


@pytest.mark.slow
def test_the_adaptive_solver_ends_before_an_edge():
    within = coefficients(machs=(0.5, 60.0))
    table = air(refuse=True, high=200 * km)
    given = tabulated(air=table, aerodynamics=within)
    ended = fly_compiled(given, Adaptive(1e-8), STEP)
    assert Outcome(int(ended.outcome)) is Outcome.BEYOND_TABLE
    assert LOW < float(ended.state.altitude) < LOW + 2.0 * km


def test_angles_are_told_in_degrees(capsys):
    wide = coefficients(machs=(0.5, 60.0), angles=(0.1, 0.3))
    calm, thick = free_scenario().planet.wind, air(low=0.0, high=200 * km)
    given = tabulated(air=thick, wind=calm, aerodynamics=wide)
    with pytest.warns(UserWarning, match="time beyond angles of attack"):
        flight = fly(given, cheap.SOLVER)
    far = float(flight.beyond_tables[ANGLE])
    assert far == pytest.approx(0.1)  # at an angle of attack of zero
    print_flight(cheap.MISSION, given, flight)
    printed = " ".join(capsys.readouterr().out.split())
    assert f"100% in one flight, and by up to {far / degree:.3g} deg" in printed


@pytest.mark.parametrize(
    "solver", [cheap.SOLVER, pytest.param(Adaptive(1e-8), marks=pytest.mark.slow)]
)
def test_a_flight_that_begins_beyond_does_not_fly(solver):
    flight = fly_compiled(tabulated(air=air(refuse=True)), solver, STEP)
    assert Outcome(int(flight.outcome)) is Outcome.BEYOND_TABLE
    assert float(flight.time) == 0.0
    assert float(flight.caveats[AIR]) == 1.0
    start = float(free_scenario().initial_state.altitude)
    assert float(flight.beyond_tables[AIR]) == pytest.approx(start - HIGH)


@pytest.mark.slow
def test_the_adaptive_solver_counts_at_its_cycles(flight):
    adaptive = fly_compiled(tabulated(), Adaptive(1e-8), STEP)
    for name in (AIR, MACH):
        share = float(flight.caveats[name])
        assert float(adaptive.caveats[name]) == pytest.approx(share, abs=0.02)


@pytest.mark.slow
def test_what_is_counted_has_no_derivative_and_leaves_those_of_the_flight():
    """The gradient in a table is that of the exponential that it stands for."""

    given = tabulated(aerodynamics=coefficients(machs=(0.5, 60.0)))

    @jax.jit
    @jax.jacrev
    def gradients(mass):
        scenario = eqx.tree_at(lambda s: s.vehicle.mass, given, mass)
        flight = fly(scenario, cheap.SOLVER)
        altitude = flight.state.altitude
        return jnp.stack([altitude, altitude + 1e6 * flight.caveats[AIR]])

    plain, with_share = gradients(given.vehicle.mass)
    assert abs(float(plain)) > 1e-3
    np.testing.assert_allclose(with_share, plain, rtol=1e-12)


def test_tables_are_found_within_other_models():
    many = EnsembleAtmosphere(jnp.array([LOW, HIGH]), jnp.array([[2.0, 1.0]]))
    gusts = EnsembleWind(jnp.array([LOW, HIGH]), jnp.ones((1, 2)), jnp.ones((1, 2)))
    planet = dataclasses.replace(
        free_scenario().planet, atmosphere=PerturbedAtmosphere(many), wind=gusts
    )
    found = tables_in(planet=planet, vehicle=free_scenario().vehicle)
    assert set(found) == {"planet.atmosphere.undisturbed", "planet.wind"}
    for table in found.values():
        first, last = table.edges()["altitudes"]
        assert (float(first), float(last)) == (LOW, HIGH)


@pytest.mark.parametrize("trend", [0.0, 0.1])
def test_a_name_does_not_depend_on_whether_air_departs(trend):
    """Departures that are zero are not flown, and the results have what was required."""
    departs = PerturbedAtmosphere(air(), trend=trend, share_low=0.1, share_high=0.1)
    calm = free_scenario().planet.wind
    given = tabulated(air=departs, wind=calm)
    shapes = eqx.filter_eval_shape(
        fly, without_zero_perturbations(checked(given)), cheap.SOLVER
    )
    assert list(shapes.caveats) == caveat_names(given)
    assert AIR in shapes.caveats


def test_edges_of_a_smoothed_atmosphere_are_those_that_were_asked_for():
    known = free_scenario().planet.atmosphere
    air = smoothed(known, lowest=2 * km, highest=90 * km)
    assert isinstance(air, SmoothedAtmosphere)
    first, last = air.edges()["altitudes"]
    assert float(first) == pytest.approx(2 * km)
    assert float(last) == pytest.approx(90 * km)


def test_csv_tables_can_refuse(tmp_path):
    rows = "angle_of_attack_deg,mach,lift_coefficient,drag_coefficient\n"
    rows += "".join(f"{a},{m},0.1,1.0\n" for a in (0, 40) for m in (2, 20))
    (tmp_path / "coefficients.csv").write_text(rows)
    (tmp_path / "air.csv").write_text("altitude_m,density_kg_m3\n0,1.0\n1000,0.9\n")
    (tmp_path / "wind.csv").write_text("altitude_m,east_m_s,north_m_s\n0,1,2\n9,1,2\n")
    for kind, name in (
        (TabulatedAerodynamics, "coefficients"),
        (TabulatedAtmosphere, "air"),
        (TabulatedWind, "wind"),
    ):
        path = tmp_path / f"{name}.csv"
        assert not kind.from_csv(path).refuse_beyond
        assert kind.from_csv(path, refuse_beyond=True).refuse_beyond


def test_a_campaign_tells_how_many_how_long_and_how_far(capsys):
    """By a warning, in the results, the summary, and the lines of the command."""
    wide = coefficients(machs=(0.5, 60.0))
    high = air(low=55 * km, high=200 * km)
    wind = free_scenario().planet.wind
    given = tabulated(air=high, wind=wind, aerodynamics=wide)
    key = jax.random.key(0)
    words = r"20 of 20 flights have time beyond altitudes"
    with pytest.warns(UserWarning, match=words) as warned:
        campaign = monte_carlo(given, cheap.dispersions(), key, 20, solver=cheap.SOLVER)
    most = float(np.max(campaign.flights.beyond_tables[AIR])) / km
    assert f"and by up to {most:.3g} km" in str(warned[0].message)
    assert most > float(np.min(campaign.flights.beyond_tables[AIR])) / km + 0.01
    results = dataset(given, campaign)
    distance = results["distance_beyond_altitudes_of_planet_atmosphere"]
    assert distance.attrs["units"] == "m"
    np.testing.assert_array_equal(distance, campaign.flights.beyond_tables[AIR])
    np.testing.assert_array_equal(results[AIR], campaign.flights.caveats[AIR])
    assert len(np.unique(results[AIR])) > 1
    told = summarize(results).caveats[AIR]
    assert told.flights == 20 and told.unit == "m"
    assert told.largest_share == pytest.approx(float(results[AIR].max()))
    assert told.largest_distance == pytest.approx(float(distance.max()))
    print_campaign(cheap.MISSION, results, as_published=False)
    printed = " ".join(capsys.readouterr().out.split())
    share, far = float(results[AIR].max()), float(distance.max()) / km
    assert (
        "caveat: 20 of 20 flights have time beyond altitudes of planet atmosphere, up to "
        f"{share:.0%} in one flight, and by up to {far:.3g} km"
    ) in printed
    assert "numbers of vehicle" not in printed


def test_one_flight_tells(flight, capsys):
    print_flight(cheap.MISSION, tabulated(), flight)
    printed = " ".join(capsys.readouterr().out.split())
    far = float(flight.beyond_tables[MACH])
    share = float(flight.caveats[MACH])
    assert (
        "caveat: 1 of 1 flights have time beyond mach numbers of vehicle aerodynamics, up "
        f"to {share:.0%} in one flight, and by up to {far:.3g}"
    ) in printed
