"""The estimate of the wind from the measured velocity over the air."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from winds_on_board import STATE, TABLE, one

from jentry.motion import EntryState
from jentry.onboard import AirVelocity, WindEstimator, WindPrior
from jentry.units import degree, km
from jentry.world import ConstantWind, StillAir


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
