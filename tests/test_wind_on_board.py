"""Wind on board: models that know it, laws that refuse it, and laws that estimate it."""

import dataclasses

import cheap
import equinox as eqx
import helpers
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, mars_planet
from laws import all_laws, predictor_corrector
from pages import benchmark
from winds_on_board import STATE, TABLE, WINDS, air_velocity, one, sensed
from worlds import all_aerodynamics

from jentry.campaign import monte_carlo
from jentry.guidance import AbstractSampledLaw, Aim, BankProfile
from jentry.missions import find_mission
from jentry.onboard import (
    FlowSensors,
    OnboardModel,
    PolynomialProfile,
    WindEstimator,
    WindPrior,
    measure,
)
from jentry.units import degree, km
from jentry.world import ConstantWind, Planet, StillAir, Vehicle


# What the model makes of a wind


@pytest.mark.slow
@pytest.mark.parametrize("wind", WINDS)
def test_a_model_takes_its_coefficients_at_the_airspeed(wind):
    """Over Mach number and airspeed: a polynomial fit that has both of its tails."""
    wind = WINDS[wind]
    aerodynamics = all_aerodynamics["exponential"]()
    vehicle = Vehicle(900.0, 0.5, aerodynamics=aerodynamics)
    planet = mars_planet(wind=wind)
    airspeed = np.linalg.norm(air_velocity(wind))
    assert abs(airspeed / 700.0 - 1.0) > 1e-3
    mach = airspeed / float(planet.atmosphere.speed_of_sound(STATE.altitude))
    angle = one(8 * degree)
    lift, drag = map(float, aerodynamics.coefficients(angle, one(mach), one(airspeed)))

    @eqx.filter_jit
    def asked(model, state, wanted):
        low, high = one(-5 * degree), one(25 * degree)
        return (
            model.lift_to_drag(state, angle),
            model.ballistic_coefficient(state, angle),
            model.logarithm_of_drag(state, angle),
            model.coefficients_with_slopes(state, angle)[1][0],
            model.angle_of_attack_for(state, wanted, low, high),
        )

    density = float(planet.density(STATE.altitude))
    specific = 0.5 * density * airspeed**2 * 0.5 / 900.0
    found = asked(OnboardModel(planet, vehicle), STATE, one(specific * lift))
    expected = (
        lift / drag,
        900.0 / (0.5 * drag),
        np.log(density * airspeed**2 * drag),
        drag,
        8 * degree,
    )
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    # By the search as well, for aerodynamics that tell no angle of a lift.
    table = all_aerodynamics["table"]()
    model = OnboardModel(planet, Vehicle(900.0, 0.5, aerodynamics=table))
    lift, _ = table.coefficients(angle, one(mach), one(airspeed))
    found = asked(model, STATE, one(specific * float(lift)))[-1]
    assert float(found) == pytest.approx(8 * degree, rel=1e-10)


def in_space(blows=None, wind=None):
    """The predictor-corrector in three dimensions, in a wind that its model has."""
    law = predictor_corrector()
    if blows is not None:
        model = dataclasses.replace(law.model, planet=mars_planet(wind=blows))
        law = dataclasses.replace(law, model=model)
    # A target that it reaches within its bounds: half of what its bank can do.
    return dataclasses.replace(
        law,
        aim=Aim(STATE, 10.6 * km, 0.0, 10 * km, 503.0),
        wind=wind,
        in_space=True,
        corrections=1,
        steps=16,
    )


@eqx.filter_jit
def estimated(law, measurement):
    """The factors at a guidance cycle."""
    before = law.estimator.start(0.0 * measurement.drag)
    return law._estimate(measurement, before, measurement.drag > law.gate).factors


@eqx.filter_jit
def updated(law, measurement):
    _, held = law.init(measurement)
    return law.update(one(80.0), measurement, (), held)[1]


@pytest.mark.parametrize("wind", WINDS)
def test_factors_are_one_in_a_wind_that_is_known(wind):
    """And else the square of the airspeed over the velocity, which is taken for air."""
    wind = WINDS[wind]
    for law, factor in (
        (in_space(wind), 1.0),
        (in_space(), np.sum(air_velocity(wind) ** 2) / 700.0**2),
    ):
        factors = estimated(law, sensed(wind))
        found = float(factors.lift), float(factors.drag)
        # One by rounding: both are the same expression.
        np.testing.assert_allclose(found, factor, rtol=1e-13)
        assert (abs(factor - 1.0) > 1e-3) == (law.model.planet.wind != wind)


@pytest.mark.slow
def test_a_prediction_in_a_known_wind_is_flown():
    """In a table of the wind, to the end in steps of 1 s, against those of 0.1 s."""
    scenario = find_mission("mars-range-tracking").scenario("predictor-corrector")
    windy = dataclasses.replace(scenario.planet, wind=TABLE)
    law = dataclasses.replace(scenario.guidance, step=1.0, steps=400)

    @eqx.filter_jit
    def predicted(law, seen):
        zero = 0.0 * seen.drag
        factors = law.estimator.start(zero).ahead
        return law.predicted(zero, seen, factors, jnp.array([0.8]), 1.0, True)

    def end(planet):
        model = OnboardModel(planet, scenario.vehicle)
        believing = dataclasses.replace(law, model=model)
        start, angle = scenario.initial_state, scenario.vehicle.trim_angle_of_attack
        return predicted(believing, measure(planet, scenario.vehicle, start, angle))

    held = dataclasses.replace(
        scenario, planet=windy, guidance=BankProfile(PolynomialProfile([0.6]))
    )
    flown, known, still = fly_compiled(held), end(windy), end(scenario.planet)
    radius = float(scenario.planet.radius)
    assert float(known.time) == pytest.approx(float(flown.time), abs=1e-4)
    for name in ("longitude", "latitude"):
        there = float(getattr(flown.state, name))
        # Fourth order of steps of 1 and of 0.1 s.
        assert float(getattr(known.state, name)) == pytest.approx(
            there, abs=0.1 / radius
        )
    away = float(still.state.longitude - flown.state.longitude) * radius
    assert abs(away) > 1e3


# What cannot fly in a wind that is known says so


KNOWS_WIND = {"Shuttle composition", "stored gains", "aerocapture"} | {
    "neural",
    "neural beside another",
    "neural with an angle of attack",
    "recorded",
}
"""They ask their models for coefficients alone, or for the forces in their wind"""
NO_MODEL = {"bank profile", "control profiles", "sampled bank profile"}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(all_laws) - NO_MODEL))
def test_a_law_that_takes_the_air_to_be_still_refuses_a_wind(name, reference):
    law = helpers.mars_scenario(all_laws[name](reference)).law

    def is_planet(node):
        return isinstance(node, Planet)

    def blown(node):
        if is_planet(node):
            return dataclasses.replace(node, wind=ConstantWind(10.0, 0.0))
        return node

    windy = jax.tree.map(blown, law, is_leaf=is_planet)
    planets = [p for p in jax.tree.leaves(windy, is_leaf=is_planet) if is_planet(p)]
    assert planets, "no model: nothing to refuse"
    seen = sensed(StillAir())

    def flown(law):
        begun = law.init(seen)
        if not isinstance(law, AbstractSampledLaw):
            return law(one(80.0), seen, begun)
        memory, held = law.update(one(80.0), seen, *begun)
        return law(one(80.0), seen, memory, held)

    eqx.filter_eval_shape(flown, law)
    if name in KNOWS_WIND:
        eqx.filter_eval_shape(flown, windy)
        return
    with pytest.raises(
        ValueError, match="ConstantWind, and .* takes the air to be still"
    ):
        eqx.filter_eval_shape(flown, windy)


@pytest.mark.slow
def test_the_law_believes_what_it_has_seen():
    """One good sample of a head wind, so that little is left for the factors."""
    wind = WINDS["head"]
    estimator = WindEstimator(WindPrior(50.0, 1e9), 1e-6, 1e-6)
    sensors = FlowSensors(least_dynamic_pressure=0.0)
    seen = sensed(wind, sensors)
    law = in_space(wind=estimator)
    held = updated(law, seen)
    assert held.wind is not None
    factors = held.estimate.factors
    # The prior draws by a share of (7e-4 / 50)^2; the correlation length is endless.
    np.testing.assert_allclose([factors.lift, factors.drag], 1.0, rtol=1e-8)
    believed = estimator.wind(StillAir(), held.wind).velocity(STATE.altitude)
    np.testing.assert_allclose(
        believed[:2], wind.velocity(STATE.altitude)[:2], rtol=1e-6
    )
    unseen = updated(law, sensed(wind, FlowSensors(least_dynamic_pressure=1e9)))
    np.testing.assert_array_equal(unseen.wind.learnt.weights, np.zeros(2))
    assert abs(float(unseen.estimate.factors.drag) - 1.0) > 0.1
    # It steers as with the wind in its model, and not as without.
    known = updated(in_space(wind), seen).numbers[0]
    assert float(held.numbers[0]) == pytest.approx(float(known), abs=1e-6)
    assert 0.05 < float(known) < 0.95
    assert abs(float(unseen.numbers[0] - known)) > 1e-3


def test_bad_input_is_refused():
    estimator = WindEstimator(WindPrior(30.0, 8 * km), 0.01)
    with pytest.raises(ValueError, match="wind is estimated and in_space is False"):
        dataclasses.replace(predictor_corrector(), wind=estimator)
    law = in_space(wind=estimator)
    with pytest.raises(ValueError, match="no sensor measures the flow: give the scen"):
        eqx.filter_eval_shape(updated, law, sensed(StillAir()))
    noisy = dataclasses.replace(cheap.scenario(), flow_sensors=FlowSensors(noise=0.01))
    with pytest.raises(ValueError, match="flow_sensors.noise is 0.01, and all runs"):
        monte_carlo(noisy, cheap.mass_only(), jax.random.key(0), 2)


# What it is worth


wind = benchmark("wind")


def test_everything_is_saved_and_all_flights_have_an_end():
    saved = wind.saved()
    assert list(saved) == list(wind.ROWS)
    for values in saved.values():
        assert wind.table_of(values)[5] == 0.0
        assert values.shape == (len(wind.SEEDS), len(wind.COLUMNS))


@pytest.mark.slow
def test_a_set_that_learns_the_wind_is_what_is_saved():
    seed = wind.SEEDS[0]
    found = wind.flown(*wind.learnt(speed=True), seed)
    expected = wind.saved()["by its speed too"][0]
    # Another compiler's order of rounding is below this, as of the other populations.
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
