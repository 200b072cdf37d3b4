"""The navigation filter: covariance, measurements, gates, and consistency."""

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
    NAMES,
    SENSING,
    TERRAIN,
    TURNING,
    WALKS,
    aided,
    drawn,
    filtering,
)
from helpers import ConstantBank, mars_planet, mars_scenario, mars_vehicle

from jentry import fly
from jentry.analysis.local_derivatives import fly_points
from jentry.campaign import Dispersion, Normal, monte_carlo
from jentry.campaign.results import OutputNamed, output_names
from jentry.flight import FixedStep
from jentry.flight.over_index import fly_over
from jentry.flight.scenario_checks import check
from jentry.motion import Controls, EntryState, TimeIndex
from jentry.onboard import (
    Actual,
    Altimeter,
    Believed,
    BodyAccelerometers,
    DragAltitude,
    FlowSensors,
    FlowVelocity,
    Gyroscopes,
    InertialNavigation,
    InertialNoise,
    KnowledgeError,
    NavigationFilter,
    OnboardModel,
    Sensed,
    TerrainPosition,
)
from jentry.onboard.inertial import difference, displaced
from jentry.onboard.navigation_filter import Estimate
from jentry.statistics import consistency
from jentry.units import km
from jentry.world import ConstantWind


# One update, without a flight.


def here(scenario, altitude=30 * km, **off):
    """Filter, and what it holds, senses and believes at a point of the flight."""
    state = dataclasses.replace(
        scenario.initial_state,
        altitude=jnp.asarray(altitude),
        velocity=jnp.asarray(3e3),
    )
    controls = Controls.from_bank(jnp.asarray(0.9), jnp.asarray(-0.2))
    actual = Actual(
        scenario.planet,
        scenario.vehicle,
        state,
        controls,
        scenario.accelerometers,
        scenario.flow_sensors,
    )
    navigation = scenario.navigation
    navigation = eqx.tree_at(lambda n: n.knowledge, navigation, KnowledgeError(**off))
    navigated = navigation.start(scenario.planet, state)
    aiding = navigation.begin(actual, navigated)
    return navigation, actual, navigated, aiding


def updated(scenario, at=1.0, altitude=30 * km, **off):
    navigation, actual, navigated, aiding = here(scenario, altitude, **off)
    given = navigated, aiding, jnp.asarray(at), jnp.asarray(True)
    return (navigated, aiding), navigation.update(lambda: actual, *given)


def test_a_measurement_is_weighed_as_by_the_information():
    """The inverse of the covariance grows by H' H / r^2: the other form of the filter."""
    quiet = Altimeter(1e-9, 60 * km, cycle=1.0, assumed=300.0)
    (_, _), (_, alone) = updated(aided({}, noise=False), up=500.0)
    (before, _), (after, held) = updated(aided({"a": quiet}, noise=False), up=500.0)
    before_it, after_it = matrix(alone), matrix(held)
    scale = np.sqrt(np.diag(before_it))
    units = scale * scale[:, None]
    information = np.linalg.inv(before_it / units)
    information[0, 0] += (scale[0] / 300.0) ** 2
    expected = np.linalg.inv(information) * units
    np.testing.assert_allclose(after_it / units, expected / units, rtol=0, atol=1e-9)
    # The altitude was believed 500 m too high.
    gain = expected[:, 0] / 300.0**2
    shift = np.array(
        [
            float(a - b)
            for a, b in zip(
                jax.tree.leaves(Estimate(after, held.accelerometers, held.gyroscopes)),
                jax.tree.leaves(Estimate(before, *zeros())),
                strict=True,
            )
        ]
    )
    np.testing.assert_allclose(shift / scale, -500.0 * gain / scale, atol=1e-6)
    assert abs(shift[0]) > 300.0


def matrix(aiding):
    """The covariance now."""
    return np.asarray(aiding.covariance.moved().matrix)


def zeros():
    return jax.tree.map(jnp.zeros_like, (SENSING, TURNING))


def in_local_axes(actual, navigated, covariance):
    """The covariance of position, velocity and attitude, east, north and up."""

    def local(numbers):
        state, tilt = EntryState(*numbers[:6]), tuple(numbers[6:])
        there = dataclasses.replace(navigated, state=state, tilt=tilt)
        return jnp.stack(
            jax.tree.leaves(difference(actual.planet, navigated.state, there))
        )

    turn = np.asarray(jax.jacfwd(local)(jnp.stack(jax.tree.leaves(navigated))))
    return turn @ np.asarray(covariance)[:9, :9] @ turn.T


def test_the_covariance_starts_as_stated():
    """Back in local axes it is the square of the standard deviations, and correlated."""
    alike = np.eye(9)
    alike[0, 3] = alike[3, 0] = 0.6
    scenario = aided({}, correlations=alike)
    _, actual, navigated, aiding = here(scenario)

    found = in_local_axes(actual, navigated, matrix(aiding))
    sizes = np.array(jax.tree.leaves(KNOWN))
    np.testing.assert_allclose(found / sizes / sizes[:, None], alike, atol=1e-9)
    instruments = np.array(jax.tree.leaves((SENSING, TURNING)))
    np.testing.assert_allclose(
        matrix(aiding)[9:, 9:], np.diag(instruments**2), atol=1e-30
    )


def test_deviations_along_and_across_the_track():
    """Of a filter with correlations: the covariance in local axes, by unit vectors.

    The change of the speed is the change of the velocity along it. Arcs on the ground are
    shorter than displacements at altitude.
    """
    alike = np.eye(9)
    for i, j, size in ((0, 1, 0.7), (3, 4, -0.5), (3, 5, 0.4)):
        alike[i, j] = alike[j, i] = size
    scenario = aided({}, correlations=alike)
    navigation, actual, navigated, aiding = here(scenario)
    planet, state = actual.planet, actual.state
    zero = jnp.asarray(0.0)
    known = navigation.knowledge_of(planet, state, navigated, aiding, zero)
    sizes = np.array([float(getattr(KNOWN, name)) for name in NAMES])
    spread = alike * sizes * sizes[:, None]
    heading, path = float(state.heading), float(state.flight_path_angle)
    ground = float(planet.radius / (planet.radius + state.altitude))
    east, north = np.sin(heading), np.cos(heading)
    for name, vector in (
        ("downrange", [ground * east, ground * north, *7 * [0.0]]),
        ("crossrange", [-ground * north, ground * east, *7 * [0.0]]),
        ("altitude", [0.0, 0.0, 1.0, *6 * [0.0]]),
        (
            "velocity",
            [*3 * [0.0], *np.cos(path) * np.array([east, north]), np.sin(path)],
        ),
    ):
        along = np.array([*vector, *9 * [0.0]][:9])
        found = float(getattr(known.track_deviation, name))
        assert found == pytest.approx(np.sqrt(along @ spread @ along), rel=1e-9), name


def test_deviations_along_the_track_are_those_of_the_local_axes():
    """Turned by the heading, and as arcs on the ground; without correlations."""
    scenario = aided({})
    navigation, actual, navigated, aiding = here(scenario)
    given = scenario.planet, actual.state, navigated, aiding, jnp.asarray(0.0)
    found = navigation.knowledge_of(*given).track_deviation
    ahead, climb = (
        float(x) for x in (actual.state.heading, actual.state.flight_path_angle)
    )
    radius = float(scenario.planet.radius)
    ground = radius / (radius + 30 * km)
    east, north = float(KNOWN.east) * ground, float(KNOWN.north) * ground
    level = np.cos(climb) * np.sin(ahead), np.cos(climb) * np.cos(ahead)
    velocities = KNOWN.velocity_east, KNOWN.velocity_north, KNOWN.velocity_up
    expected = [
        np.hypot(east * np.sin(ahead), north * np.cos(ahead)),
        np.hypot(east * np.cos(ahead), north * np.sin(ahead)),
        float(KNOWN.up),
        np.linalg.norm(np.array([*level, np.sin(climb)]) * np.array(velocities)),
    ]
    np.testing.assert_allclose(jax.tree.leaves(found), expected, rtol=1e-6)


def test_random_walks_grow_alike_in_all_directions():
    """In one second by their squares, in local axes."""
    scenario = aided({}, noise=False)
    walks = lambda s: (
        s.navigation.filter.velocity_random_walk,
        s.navigation.filter.angle_random_walk,
    )
    still = eqx.tree_at(walks, scenario, 2 * (jnp.zeros(()),))
    _, actual, navigated, _ = here(scenario)
    (_, with_them), (_, without) = (updated(s)[1] for s in (scenario, still))
    growth = matrix(with_them) - matrix(without)
    found = in_local_axes(actual, navigated, growth)
    expected = np.repeat([0.0, WALKS[0] ** 2, WALKS[1] ** 2], 3)
    sizes = np.repeat([1.0, *WALKS], 3)
    np.testing.assert_allclose(
        found / sizes / sizes[:, None], np.diag(expected / sizes**2), atol=1e-3
    )


def test_the_axes_of_the_vehicle():
    """Right-handed, forward above the velocity by the angle of attack, and right below the
    horizon by the bank; gyroscopes drift about them."""
    _, actual, _, _ = here(aided({}))
    sensed, angle, bank = Sensed.of(actual), -0.2, 0.9
    zero, one = jnp.asarray(0.0), jnp.asarray(1.0)
    forward, right, down = axes = np.array(sensed.body_axes())
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(np.cross(forward, right), down, atol=1e-14)
    velocity = np.array(
        sensed.place.to_planet(*sensed.velocity.to_local(one, zero, zero))
    )
    assert forward @ velocity == pytest.approx(np.cos(angle))
    assert down @ velocity == pytest.approx(np.sin(angle))
    up = np.array(sensed.place.to_planet(zero, zero, one))
    level = float(np.cos(actual.state.flight_path_angle))
    assert right @ up == pytest.approx(-np.sin(bank) * level)
    drift = np.array(sensed.axes.to_planet(*sensed.sensed_drift(TURNING)))
    expected = np.array(jax.tree.leaves(TURNING)) @ axes
    np.testing.assert_allclose(drift, expected, rtol=1e-12)


def test_errors_that_have_been_found_move_nothing():
    """What remains is of their square: less than a hundredth of what they do."""
    scenario = aided({})
    _, actual, navigated, aiding = here(scenario)
    sensing = actual._replace(accelerometers=SENSING)
    known = dataclasses.replace(
        aiding, accelerometers=SENSING, gyroscopes=Gyroscopes(*jax.tree.leaves(TURNING))
    )
    drifting = dataclasses.replace(scenario.navigation, gyroscopes=TURNING)
    rates = [
        np.array(jax.tree.leaves(navigation.rate(flight, navigated, held)))
        for navigation, flight, held in (
            (scenario.navigation, actual, aiding),
            (drifting, sensing, aiding),
            (drifting, sensing, known),
        )
    ]
    off, left = np.abs(rates[1] - rates[0]), np.abs(rates[2] - rates[0])
    moved = off > 1e-12
    assert moved.sum() == 6  # velocity and its two angles, and the tilt
    assert np.all(left[moved] < 1e-2 * off[moved])


def test_what_is_not_due_changes_nothing():
    navigation, actual, navigated, aiding = here(aided({"a": ALTIMETER}), up=500.0)
    given = navigated, aiding, jnp.asarray(1.0), jnp.asarray(False)
    after = navigation.update(lambda: actual, *given)
    before = jax.tree.leaves((navigated, aiding))
    for a, b in zip(before, jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_difference_is_the_inverse_of_the_displacement():
    """Also where the longitude passes half a turn."""
    planet = mars_planet()
    state = EntryState(30 * km, np.pi - 1e-6, 0.5, 3e3, -0.1, 1.2)
    believed = displaced(planet, state, KNOWN)
    lens = lambda n: n.state.longitude
    for turns in (0.0, 2.0 * np.pi):
        there = eqx.tree_at(lens, believed, believed.state.longitude - turns)
        found = difference(planet, state, there)
        np.testing.assert_allclose(
            jax.tree.leaves(found), jax.tree.leaves(KNOWN), rtol=1e-6
        )


def test_errors_of_sensors_have_their_sizes():
    """Over the ground in metres, and of the altitude."""
    _, actual, _, _ = here(aided({}))
    sensed, zero = Sensed.of(actual), jnp.asarray(0.0)
    state, radius = actual.state, float(actual.planet.radius)
    camera = TerrainPosition(30.0, 60 * km, 100.0, -200.0, cycle=1.0)
    east, north = camera.measured(sensed, lambda axis: 1.0 + axis, zero)
    circle = radius * np.cos(float(state.latitude))
    assert (float(east) - float(state.longitude)) * circle == pytest.approx(130.0)
    assert (float(north) - float(state.latitude)) * radius == pytest.approx(-140.0)
    doppler = dataclasses.replace(DOPPLER, noise=2.0, scale_error=0.01)
    exact = dataclasses.replace(DOPPLER, noise=0.0, assumed=1.0)
    noisy, alone = (
        np.array(s.measured(sensed, lambda axis: 1.0, zero)) for s in (doppler, exact)
    )
    np.testing.assert_allclose(noisy, 1.01 * alone + 2.0, rtol=1e-12)
    assert np.linalg.norm(alone) == pytest.approx(3e3)
    believed = Believed(actual.planet, state, sensed.body_axes(), SENSING, zero)
    assert float(exact.deviations(believed)[0]) == 1.0
    wide, high = camera.deviations(believed)
    assert [float(wide) * circle, float(high) * radius] == pytest.approx([30.0, 30.0])
    assert float(DRAG.deviations(believed)[0]) == 0.05


SENSORS = {
    "altimeter": (ALTIMETER, 1),
    "terrain": (TERRAIN, 2),
    "doppler": (dataclasses.replace(DOPPLER, noise=1e-9, assumed=0.1), 3),
    "drag": (DRAG, 1),
    "flow": (FlowVelocity(1.0, cycle=1.0), 3),
}


@pytest.mark.parametrize("name", SENSORS)
def test_a_sensor_expects_what_it_measures(name):
    """With exact knowledge and no noise: over still air, and to rounding."""
    sensor, count = SENSORS[name]
    if hasattr(sensor, "noise"):
        assumed = sensor.noise if sensor.assumed is None else sensor.assumed
        sensor = dataclasses.replace(sensor, noise=0.0, assumed=assumed)
    scenario = dataclasses.replace(
        aided({name: sensor}), flow_sensors=FlowSensors(largest_mach=1e3)
    )
    trim = scenario.vehicle.trim_angle_of_attack
    _, actual, navigated, _ = here(scenario)
    sensed = Sensed.of(actual)
    values = sensor.measured(sensed, lambda axis: 1.0, jnp.asarray(1.0))
    exact = Believed(
        scenario.planet,
        navigated.state,
        sensed.body_axes(),
        BodyAccelerometers(),
        trim,
    )
    expected = sensor.expected(exact)
    assert len(values) == len(expected) == len(sensor.deviations(exact)) == count
    np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-9)


def test_the_vehicle_knows_the_angle_of_attack_that_it_measures():
    """Its drag is expected at the measured angle, as a law has it."""

    class Angle(Altimeter):
        angle: float = 0.0

        def measured(self, sensed, drawn, at):
            return (0.0 * at + self.angle,)

        def expected(self, believed):
            return (believed.angle_of_attack + 0.0 * believed.state.altitude,)

    def rejected(angle):
        sensor = Angle(1e-3, 60 * km, angle=angle, cycle=1.0)
        navigation, actual, navigated, aiding = here(aided({"a": sensor}))
        actual = actual._replace(angle_of_attack_error=jnp.asarray(0.03))
        given = navigated, aiding, jnp.asarray(1.0), jnp.asarray(True)
        return float(navigation.update(lambda: actual, *given)[1].rejected["a"])

    assert [rejected(-0.17), rejected(-0.2)] == [0.0, 1.0]


def test_an_outlier_is_rejected_and_counted():
    """A measurement 100 km off changes nothing; its share of rejected values is one."""
    lying = dataclasses.replace(ALTIMETER, bias=100 * km)
    (_, _), (alone, _) = updated(aided({}))
    (_, _), (after, held) = updated(aided({"altimeter": lying}))
    for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(after), strict=True):
        assert float(a) == float(b)
    scenario = aided({"altimeter": lying})
    assert scenario.navigation.caveats(held) == {"altimeter_rejected": 1.0}
    (_, _), (_, held) = updated(aided({"altimeter": ALTIMETER}))
    assert scenario.navigation.caveats(held) == {"altimeter_rejected": 0.0}
    assert float(held.measured["altimeter"]) == 1.0


def test_rejected_values_are_counted_for_their_sensor():
    far = 100 * km
    for off, rejected in (
        ({"altimeter": dataclasses.replace(ALTIMETER, bias=far)}, (1.0, 0.0)),
        ({"terrain": dataclasses.replace(TERRAIN, bias_east=far)}, (0.0, 1.0)),
        ({"terrain": dataclasses.replace(TERRAIN, bias_north=far)}, (0.0, 1.0)),
    ):
        sensors = {"altimeter": ALTIMETER, "terrain": TERRAIN} | off
        _, (_, held) = updated(aided(sensors), 2.0)
        assert (held.rejected["altimeter"], held.rejected["terrain"]) == rejected, off


def test_sensors_that_are_alike_have_noise_of_their_own():
    """The filter takes the mean of two measurements that it knows to be good."""
    alike = Altimeter(200.0, 60 * km, cycle=1.0, assumed=0.1, gate=1e9)
    for at in range(1, 6):
        known = []
        for sensors in ({"a": alike}, {"a": alike, "b": alike}):
            _, (after, _) = updated(aided(sensors), float(at))
            known.append(float(after.state.altitude))
        assert abs(known[1] - known[0]) > 1.0, at


def test_a_sensor_measures_at_its_own_times_and_places():
    for at, altitude, count in ((1.0, 30.0, 0), (2.0, 30.0, 2), (2.0, 61.0, 0)):
        _, (_, held) = updated(aided({"terrain": TERRAIN}), at, altitude * km)
        assert float(held.measured["terrain"]) == count, (at, altitude)


# Flights.


@pytest.fixture(scope="module")
def flown():
    """Compiled flights of 16 draws, of one structure."""
    return eqx.filter_jit(
        lambda scenario, keys: jax.vmap(
            lambda key: fly(drawn(scenario, key), FixedStep(0.5))
        )(keys)
    )


def test_the_filter_corrects_a_flight(flown):
    """Errors of kilometres become as small as the sensors are accurate, and the covariance
    says so: of 16 flights, normalised errors within a bound of one in a million."""
    flights = flown(
        aided({"altimeter": ALTIMETER, "doppler": DOPPLER, "terrain": TERRAIN}),
        jax.random.split(jax.random.key(0), 16),
    )
    error, sizes = flights.knowledge.error, flights.knowledge.deviation
    for name, least, most in (
        ("up", 0.5, 10.0),
        ("east", 1.0, 30.0),
        ("velocity_north", 0.01, 0.3),
    ):
        size = np.asarray(getattr(sizes, name))
        assert np.all((size > least) & (size < most)), (name, size)
        assert np.all(np.abs(np.asarray(getattr(error, name))) < 6.0 * size), name
    found = flights.knowledge.normalised_error_squared
    assert consistency(found, confidence=1.0 - 1e-6).holds
    off = flights.navigated.altitude - flights.state.altitude
    np.testing.assert_allclose(error.up, off, rtol=0, atol=1e-9)
    assert set(flights.caveats) == {
        "altimeter_rejected",
        "doppler_rejected",
        "terrain_rejected",
    }
    made, rejected = flights.knowledge.measured, flights.knowledge.rejected
    for name, values, cycle in (("altimeter", 1, 1.0), ("terrain", 2, 2.0)):
        # Both measure below 60 km, to the end.
        most = values * np.floor(np.asarray(flights.time) / cycle)
        assert np.all((made[name] > 0.3 * most) & (made[name] < most)), name
        share = rejected[name] / made[name]
        np.testing.assert_array_equal(share, flights.caveats[f"{name}_rejected"])


# Refusals.


def test_what_is_no_filter_is_refused():
    with pytest.raises(ValueError, match=r"cycle of the Altimeter is nan s"):
        Altimeter(10.0, 60 * km)
    with pytest.raises(ValueError, match=r"sensors\.a\.cycle is 0\.5 s.*multiple"):
        filtering({"a": dataclasses.replace(ALTIMETER, cycle=0.5)})
    with pytest.raises(ValueError, match=r"knowledge\.up of the filter is 0"):
        NavigationFilter(KnowledgeError(*2 * [1.0]), {})
    with pytest.raises(ValueError, match=r"noise of sensors\.a is 0"):
        filtering({"a": dataclasses.replace(ALTIMETER, noise=0.0)})
    bad = np.eye(9)
    bad[0, 1] = bad[1, 0] = 1.2
    with pytest.raises(ValueError, match=r"positive eigenvalues: the least is -0\.2"):
        filtering({}, correlations=bad)
    with pytest.raises(ValueError, match=r"shape \(3, 3\)"):
        filtering({}, correlations=np.eye(3))
    with pytest.raises(
        ValueError, match=r"noise is 2\.0 s and that of the filter 1\.0"
    ):
        InertialNavigation(noise=InertialNoise(*WALKS, cycle=2.0), filter=filtering({}))
    with pytest.raises(ValueError, match=r"negative"):
        NavigationFilter(KNOWN, {}, gyroscopes=Gyroscopes(-1.0))
    with pytest.raises(ValueError, match=r"has the name 'a b'"):
        filtering({"a b": ALTIMETER})
    scenario = eqx.tree_at(
        lambda s: s.navigation.filter.knowledge.up, aided({}), jnp.asarray(-1.0)
    )
    with pytest.raises(ValueError, match=r"knowledge\.up of the filter is -1"):
        check(scenario)
    with pytest.raises(ValueError, match=r"give it flow_sensors=FlowSensors"):
        fly(aided({"flow": FlowVelocity(1.0, cycle=1.0)}))
    windy = dataclasses.replace(mars_planet(), wind=ConstantWind(10.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="air to be still"):
        DragAltitude(OnboardModel(windy, mars_vehicle()), 0.1, 1.0, cycle=1.0)


def test_noise_of_sensors_differs_from_run_to_run():
    """One seed for all runs is refused."""
    dispersions = {
        "v": Dispersion(lambda s: s.initial_state.velocity, Normal(5500.0, 1.0))
    }
    scenario = aided({"altimeter": ALTIMETER}, noise=False)
    with pytest.raises(ValueError, match=r"navigation\.seed by Uniform"):
        monte_carlo(scenario, dispersions, key=jax.random.key(0), runs=2)


def test_results_have_the_normalised_error(flown):
    scenario = aided({"altimeter": ALTIMETER, "doppler": DOPPLER, "terrain": TERRAIN})
    flights = flown(scenario, jax.random.split(jax.random.key(0), 16))
    first = jax.tree.map(lambda x: x[0], flights)
    name = "end_normalised_error_squared"
    assert name in output_names(scenario)
    found = OutputNamed(name)(scenario, first)
    assert float(found) == float(flights.knowledge.normalised_error_squared[0])
    assert name not in output_names(mars_scenario(ConstantBank(0.9)))


def test_what_does_not_know_of_updates_refuses_them():
    scenario = aided({})
    with pytest.raises(ValueError, match=r"has a filter"):
        fly_points(scenario, TimeIndex(), 3, FixedStep(0.5))
    with pytest.raises(ValueError, match=r"updated every 1\.0 s"):
        fly_over(scenario, TimeIndex(), 10.0, 10)
