"""Wind on board: a model that knows it, laws that cannot, and an estimate of it.

Airspeeds and directions are computed here from the angles of the state, by numpy.
"""

import dataclasses

import cheap
import equinox as eqx
import helpers
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from first_sets import benchmark
from helpers import fly_compiled, mars_planet, mars_vehicle
from readme import assert_prints, rows

from jentry.campaign import monte_carlo
from jentry.guidance import AbstractSampledLaw, Aim, BankProfile
from jentry.missions import find_mission
from jentry.motion import EntryState
from jentry.onboard import (
    AirVelocity,
    FlowSensors,
    OnboardModel,
    PolynomialProfile,
    WindEstimator,
    WindPrior,
    measure,
)
from jentry.units import degree, km
from jentry.world import ConstantWind, Planet, StillAir, TabulatedWind, Vehicle


STATE = EntryState(
    *map(jnp.asarray, (14 * km, 0.1, 0.2, 700.0, -18 * degree, 65 * degree))
)
TABLE = TabulatedWind(helpers.WIND_ALTITUDES, helpers.EAST_WIND, helpers.NORTH_WIND)
WINDS = {
    # Against the heading, and to the left of it.
    "head": ConstantWind(-50 * np.sin(65 * degree), -50 * np.cos(65 * degree)),
    "side": ConstantWind(-50 * np.cos(65 * degree), 50 * np.sin(65 * degree), 3.0),
    "table": TABLE,
}


def one(x):
    return jnp.asarray(x, dtype=float)


def ground_velocity(state):
    path, heading = float(state.flight_path_angle), float(state.heading)
    level = float(state.velocity) * np.cos(path)
    up = float(state.velocity) * np.sin(path)
    return np.array([level * np.sin(heading), level * np.cos(heading), up])


def air_velocity(wind, state=STATE):
    return ground_velocity(state) - np.array(wind.velocity(state.altitude), float)


# What the model makes of a wind


@pytest.mark.slow
@pytest.mark.parametrize("wind", WINDS)
def test_a_model_takes_its_coefficients_at_the_airspeed(wind):
    """Over Mach number and airspeed: a polynomial fit that has both of its tails."""
    wind = WINDS[wind]
    aerodynamics = helpers.all_aerodynamics["exponential"]()
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
    table = helpers.all_aerodynamics["table"]()
    model = OnboardModel(planet, Vehicle(900.0, 0.5, aerodynamics=table))
    lift, _ = table.coefficients(angle, one(mach), one(airspeed))
    found = asked(model, STATE, one(specific * float(lift)))[-1]
    assert float(found) == pytest.approx(8 * degree, rel=1e-10)


def in_space(blows=None, wind=None):
    """The predictor-corrector in three dimensions, in a wind that its model has."""
    law = helpers.predictor_corrector()
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


def sensed(wind, sensors=None):
    planet, vehicle = mars_planet(wind=wind), mars_vehicle()
    angle = vehicle.trim_angle_of_attack
    return measure(
        planet, vehicle, STATE, angle, sampled_at=one(80.0), flow_sensors=sensors
    )


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


KNOWS_WIND = {"Shuttle composition", "stored gains"}
"""They ask their models for coefficients alone"""
NO_MODEL = {"bank profile", "control profiles", "sampled bank profile"}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(helpers.all_laws) - NO_MODEL))
def test_a_law_that_takes_the_air_to_be_still_refuses_a_wind(name, reference):
    law = helpers.mars_scenario(helpers.all_laws[name](reference)).law

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


# What is sensed of the flow


ERRORS = 0.02, 0.6 * degree, -0.4 * degree


def numbers(air):
    return np.array([air.east, air.north, air.up], float)


def test_flow_sensors_turn_and_stretch_the_velocity_over_the_air():
    actual = air_velocity(TABLE)
    found = numbers(sensed(TABLE, FlowSensors(least_dynamic_pressure=0.0)).air_velocity)
    np.testing.assert_allclose(found, actual, rtol=1e-13)
    speed = np.linalg.norm(actual)
    heading = np.arctan2(actual[0], actual[1])
    right = np.array([np.cos(heading), -np.sin(heading), 0.0])
    above = np.cross(right, actual / speed)
    assert above[2] > 0.0
    sensors = FlowSensors(*ERRORS, least_dynamic_pressure=0.0)
    off = (numbers(sensed(TABLE, sensors).air_velocity) - actual) / speed
    scale, side, rise = ERRORS
    expected = scale * actual / speed + side * right + rise * above
    np.testing.assert_allclose(off, expected, rtol=0.0, atol=1e-14)


def test_flow_is_sensed_between_two_limits_and_at_samples_alone():
    still = sensed(StillAir(), FlowSensors())
    planet = mars_planet()
    mach = 700.0 / float(planet.atmosphere.speed_of_sound(STATE.altitude))
    pressure = 0.5 * float(planet.density(STATE.altitude)) * 700.0**2
    for share, senses in ((0.99, True), (1.01, False)):
        for limit in (
            {"least_dynamic_pressure": share * pressure},
            {"largest_mach": mach / share, "least_dynamic_pressure": 0.0},
        ):
            read = sensed(StillAir(), FlowSensors(**limit)).air_velocity
            assert bool(read.is_sensed) == senses
    assert still.air_velocity is not None
    angle = mars_vehicle().trim_angle_of_attack
    between = measure(planet, mars_vehicle(), STATE, angle, flow_sensors=FlowSensors())
    assert between.air_velocity is None and sensed(StillAir()).air_velocity is None


def test_noise_of_the_flow_is_of_samples():
    actual, times = air_velocity(TABLE), jnp.arange(2000) * 0.1

    @jax.jit
    def read(times):
        sensors = FlowSensors(noise=5e-3, noise_seed=0.3, least_dynamic_pressure=0.0)
        planet, vehicle = mars_planet(wind=TABLE), mars_vehicle()
        angle = vehicle.trim_angle_of_attack

        def at(time):
            return measure(
                planet, vehicle, STATE, angle, sampled_at=time, flow_sensors=sensors
            ).air_velocity

        return jax.vmap(at)(times)

    air = read(times)
    off = np.stack([air.east, air.north, air.up], axis=1) - actual
    off = off / np.linalg.norm(actual)
    # In any frame, as it is of the same size along each axis: four standard errors.
    np.testing.assert_allclose(np.std(off, axis=0), 5e-3, rtol=4 / np.sqrt(4000))
    assert np.all(np.abs(np.mean(off, axis=0)) < 4 * 5e-3 / np.sqrt(2000))
    assert np.all(np.abs(np.corrcoef(off.T) - np.eye(3)) < 4 / np.sqrt(2000))


# What is learnt of the wind


COUNT = 40


def states(paths, velocities, altitudes):
    rng = np.random.default_rng(4)
    nothing = np.zeros(COUNT)
    heading = rng.uniform(0.0, 2.0 * np.pi, COUNT)
    return EntryState(
        *map(jnp.asarray, (altitudes, nothing, nothing, velocities, paths, heading))
    )


@eqx.filter_jit
def learnt(estimator, mean, states, air):
    def update(before, sample):
        state, east, north, up, is_sensed = sample
        sensed = AirVelocity(east, north, up, is_sensed)
        return estimator.update(before, mean, state, sensed), None

    samples = states, air[0], air[1], air[2], air[3] > 0.0
    return jax.lax.scan(update, estimator.start(one(0.0)), samples)[0]


@eqx.filter_jit
def over(wind, altitudes):
    return jax.vmap(lambda h: (wind.velocity(h), wind.deviations(h)))(altitudes)


@eqx.filter_jit
def over_altitudes(wind, altitudes):
    return jax.vmap(wind.velocity)(altitudes)


def velocity_of(states):
    level = states.velocity * np.cos(states.flight_path_angle)
    return np.stack(
        [
            level * np.sin(states.heading),
            level * np.cos(states.heading),
            states.velocity * np.sin(states.flight_path_angle),
        ]
    )


def axes(air):
    """Along, to the right and above, of rows (3, n)."""
    along = air / np.linalg.norm(air, axis=0)
    right = np.stack([air[1], -air[0], 0.0 * air[0]])
    right = right / np.linalg.norm(right, axis=0)
    return along, right, np.cross(right, along, axis=0)


def likeness(a, b, length):
    """Correlation of a Gauss-Markov process between altitudes."""
    return np.exp(-np.abs(np.subtract.outer(a, b)) / length)


@pytest.mark.parametrize("speed_deviation", [0.01, None])
def test_the_estimate_is_the_regression_of_a_gauss_markov_process(speed_deviation):
    """On the way down, of all samples at once, about a wind of the model.

    By normal equations of the whole process, of which a filter knows nothing. Some samples
    are not sensed.
    """
    rng = np.random.default_rng(1)
    size, length = 18.0, 7 * km
    some = states(
        rng.uniform(-0.9, 0.1, COUNT),
        rng.uniform(200.0, 900.0, COUNT),
        np.sort(rng.uniform(5 * km, 40 * km, COUNT))[::-1],
    )
    mean = ConstantWind(7.0, -3.0, 1.5)
    over_air = velocity_of(some) - np.array([[7.0], [-3.0], [1.5]])
    air = over_air + rng.normal(0.0, 15.0, (3, COUNT))
    is_sensed = rng.uniform(size=COUNT) > 0.3
    prior = WindPrior(size, length)
    estimator = WindEstimator(prior, 0.5 * degree, speed_deviation)
    found = learnt(estimator, mean, some, jnp.stack([*air, is_sensed]))

    h = np.asarray(some.altitude)[is_sensed]
    assert float(found.altitude) == h[-1]
    speed = np.linalg.norm(air, axis=0)
    along, right, above = axes(air)
    shares = [(right, 0.5 * degree), (above, 0.5 * degree)]
    if speed_deviation is not None:
        shares.append((along, speed_deviation))
    rows, values, variances = [], [], []
    for axis, share in shares:
        east, north = axis[0][is_sensed], axis[1][is_sensed]
        rows.append(np.hstack([np.diag(east), np.diag(north)]))
        values.append(np.sum(axis * (over_air - air), axis=0)[is_sensed])
        variances.append(((share * speed) ** 2)[is_sensed])
    rows, values, variances = map(np.concatenate, (rows, values, variances))

    heights = np.linspace(0.0, h[-1], 5)
    both = np.kron(np.eye(2), size**2 * likeness(h, h, length))
    there = np.kron(np.eye(2), size**2 * likeness(heights, h, length))
    gain = there @ rows.T @ np.linalg.inv(rows @ both @ rows.T + np.diag(variances))
    departed = (gain @ values).reshape(2, -1)
    left = size**2 - np.sum(gain * (there @ rows.T), axis=1).reshape(2, -1)
    (east, north, up), deviations = over(
        estimator.wind(mean, found), jnp.asarray(heights)
    )
    # The equations of the whole process have a condition of 1e3 or so.
    np.testing.assert_allclose(east, 7.0 + departed[0], rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(north, -3.0 + departed[1], rtol=1e-10, atol=1e-9)
    np.testing.assert_array_equal(up, 1.5)
    np.testing.assert_allclose(deviations, np.sqrt(left), rtol=1e-9)


@pytest.mark.parametrize("path", [0.0, -15 * degree, -60 * degree])
def test_direction_alone_sees_a_head_wind_where_the_vehicle_descends(path):
    """To the east at a path angle, by a constant wind that is not known.

    A wind along the track turns the flow by w sin(gamma) / V in the vertical plane, and one
    across by w / V: of n samples each the deviation is that of so much information.
    """
    size, angle, velocity = 30.0, 0.5 * degree, 900.0
    flown = states(
        np.full(COUNT, path), np.full(COUNT, velocity), np.full(COUNT, 20 * km)
    )
    flown = dataclasses.replace(flown, heading=jnp.full(COUNT, 0.5 * np.pi))
    over_air = velocity_of(flown)
    air = jnp.stack([*over_air, np.ones(COUNT)])

    def deviations(speed_deviation):
        estimator = WindEstimator(WindPrior(size, 5 * km), angle, speed_deviation)
        found = estimator.wind(StillAir(), learnt(estimator, StillAir(), flown, air))
        _, (east, north) = over(found, jnp.asarray([20 * km]))
        return float(east[0]), float(north[0])

    sample = COUNT / (angle * velocity) ** 2
    along, across = deviations(None)
    assert across == pytest.approx((size**-2 + sample) ** -0.5, rel=1e-10)
    seen = size**-2 + sample * np.sin(path) ** 2
    assert along == pytest.approx(seen**-0.5, rel=1e-10)
    if path == 0.0:
        assert along == pytest.approx(size, rel=1e-12)
    # The speed of the flow tells what is missing.
    by_speed = COUNT / (0.01 * velocity) ** 2 * np.cos(path) ** 2
    along, _ = deviations(0.01)
    assert along == pytest.approx((seen + by_speed) ** -0.5, rel=1e-10)


def test_the_estimate_comes_to_the_wind():
    """Of a table, by sensors without errors: where the vehicle is, it is the wind."""
    flown = states(
        np.full(COUNT, -0.4),
        np.linspace(900.0, 300.0, COUNT),
        np.linspace(45 * km, 8 * km, COUNT),
    )
    wind = np.stack(over_altitudes(TABLE, flown.altitude))
    air = jnp.stack([*(velocity_of(flown) - wind), np.ones(COUNT)])
    estimator = WindEstimator(WindPrior(30.0, 10 * km), 1e-6, 1e-6)
    found = estimator.wind(StillAir(), learnt(estimator, StillAir(), flown, air))
    heights = jnp.asarray([8 * km, 3 * km])
    (east, north, _), deviations = over(found, heights)
    # The prior draws by the variance of a sample, 1e-6 of 300 m/s, to that of the prior.
    np.testing.assert_allclose([east[0], north[0]], wind[:2, -1], rtol=1e-6)
    # A share of the airspeed along each of three axes is one in all directions.
    airspeed = np.linalg.norm(velocity_of(flown) - wind, axis=0)[-1]
    np.testing.assert_allclose([d[0] for d in deviations], 1e-6 * airspeed, rtol=1e-6)
    # Half a correlation length below, it has come nearer to its mean.
    share = np.exp(-0.5)
    np.testing.assert_allclose([east[1], north[1]], share * wind[:2, -1], rtol=1e-6)
    grown = 30.0 * np.sqrt(1.0 - share**2)
    np.testing.assert_allclose([d[1] for d in deviations], grown, rtol=1e-6)


@pytest.mark.slow
def test_a_flow_without_sides_tells_nothing():
    """Straight down: which way is right is not defined, and nothing becomes NaN of it."""
    estimator = WindEstimator(WindPrior(30.0, 8 * km), 0.01, 0.01)
    before = estimator.start(one(0.0))
    straight = AirVelocity(one(0.0), one(0.0), one(-300.0), jnp.asarray(True))
    after = estimator.update(before, StillAir(), STATE, straight)
    for kept, known in zip(
        jax.tree.leaves(after), jax.tree.leaves(before), strict=True
    ):
        np.testing.assert_array_equal(kept, known)


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
        dataclasses.replace(helpers.predictor_corrector(), wind=estimator)
    law = in_space(wind=estimator)
    with pytest.raises(ValueError, match="nothing tells it of the flow: give the scen"):
        eqx.filter_eval_shape(updated, law, sensed(StillAir()))
    noisy = dataclasses.replace(cheap.scenario(), flow_sensors=FlowSensors(noise=0.01))
    with pytest.raises(ValueError, match="flow_sensors.noise is 0.01, and all runs"):
        monte_carlo(noisy, cheap.mass_only(), jax.random.key(0), 2)


# What it is worth


wind = benchmark("wind")


def test_the_readme_prints_what_is_saved():
    printed, saved = rows("| wind, as the law has it"), wind.saved()
    assert [name for name, *_ in printed] == list(saved) == list(wind.ROWS)
    for name, misses, downrange in printed:
        values = wind.table_of(saved[name])
        assert_prints(misses, *values[:3])
        assert_prints(downrange, values[3])
        # All flights have an end.
        assert values[5] == 0.0
        assert saved[name].shape == (len(wind.SEEDS), len(wind.COLUMNS))


@pytest.mark.slow
def test_a_set_that_learns_the_wind_is_what_is_saved():
    seed = wind.SEEDS[0]
    found = wind.flown(*wind.learnt(speed=True), seed)
    expected = wind.saved()["by its speed too"][0]
    # Another compiler's order of rounding is below this, as of the other populations.
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
