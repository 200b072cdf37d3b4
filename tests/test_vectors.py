"""Flights over a pole, through the vertical and through rest, integrated as vectors."""

import dataclasses

import cartesian
import jax
import jax.numpy as jnp
import numpy as np
import oblate
import pytest
from external_cases import NOWHERE, ballistic_vehicle
from helpers import (
    MARS_ROTATION,
    ConstantBank,
    fly_batch,
    fly_compiled,
    mars_planet,
)
from scipy.integrate import solve_ivp

from jentry.flight import (
    AltitudeBelow,
    FixedStep,
    Outcome,
    Scenario,
    Termination,
    fly,
)
from jentry.motion import (
    Controls,
    EntryDynamics,
    EntryState,
    VectorDynamics,
    VectorState,
    entry_dynamics,
)
from jentry.units import degree, km
from jentry.world import (
    ConstantWind,
    Ellipsoid,
    ExponentialAtmosphere,
    Planet,
    ZonalGravity,
)


RADIUS, MU = 3397.0e3, 4.28283e13
STEP = 0.1
"""s"""
DURATION = 200.0
"""s; flights that meet no ground end after it"""
BELOW = -1000 * km
"""Altitude of the ground where there is none"""


@dataclasses.dataclass
class Case:
    """One flight of a ballistic coefficient of 115 kg/m2 at a constant bank (rad)."""

    state: EntryState
    bank: float = 0.0
    lift_to_drag: float = 0.18
    rotation_rate: float = MARS_ROTATION
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Towards east, north and up, m/s"""
    density_scale: float = 1.0
    ground: float = BELOW
    """m"""

    def scenario(self, dynamics):
        planet = mars_planet(
            rotation_rate=self.rotation_rate,
            density_scale=self.density_scale,
            wind=ConstantWind(*self.wind),
        )
        ground = AltitudeBelow(self.ground, outcome=Outcome.CRASHED)
        return Scenario(
            planet,
            ballistic_vehicle(115.0, self.lift_to_drag),
            self.state,
            ConstantBank(self.bank),
            Termination({"ground": ground}, DURATION),
            NOWHERE,
            dynamics=dynamics,
        )

    def expected(self, time):
        """Position (m) and velocity (m/s) after a time (s), by Newton's law in numpy."""
        start = jax.tree.map(float, self.state)
        first = np.stack(cartesian.from_entry_state(RADIUS, start, np))

        def rate(_, y):
            position, velocity = y.reshape(2, 3)
            altitude = cartesian.norm(position) - RADIUS
            density = self.density_scale * 0.0158 * np.exp(-altitude / 9354.5)
            drag = lambda airspeed: 0.5 * density * airspeed**2 / 115.0
            change = cartesian.acceleration(
                position,
                velocity,
                gravitational_parameter=MU,
                rotation_rate=self.rotation_rate,
                wind=self.wind,
                drag=drag,
                lift=(lambda v: self.lift_to_drag * drag(v))
                if self.lift_to_drag
                else None,
                bank_angle=self.bank,
            )
            return np.concatenate([velocity, change])

        solved = solve_ivp(
            rate, (0.0, float(time)), first.ravel(), "DOP853", rtol=1e-12, atol=1e-8
        )
        return solved.y[:, -1].reshape(2, 3)


def fly_all(cases, dynamics):
    scenarios = [case.scenario(dynamics) for case in cases]
    return fly_batch(jax.tree.map(lambda *x: jnp.stack(x), *scenarios), FixedStep(STEP))


def lane_of(tree, lane):
    return jax.tree.map(lambda x: x[lane], tree)


ORDINARY = [
    Case(EntryState(*numbers), bank, wind=(30.0, -20.0, 5.0))
    for numbers, bank in (
        ((126e3, 3.1, 0.5, 6750.0, -0.25, 1.5), 0.9),  # over longitude 180 deg
        ((126e3, -3.9, 0.5, 6750.0, -0.25, 4.5), -0.9),
        ((90e3, 5.0, -0.9, 5000.0, -0.1, -3.0), 2.0),
        ((60e3, 0.1, 1.2, 3000.0, 0.3, 6.2), 0.3),  # heading over north
    )
]
SINGULAR = {
    "over a pole": Case(
        EntryState(60e3, 0.3, 85 * degree, 6000.0, -0.05, 0.0), 0.7, wind=(30.0, -20, 3)
    ),
    "over the other pole": Case(
        EntryState(60e3, 2.0, -85 * degree, 6000.0, -0.05, np.pi), -1.2
    ),
    "through a pole": Case(
        EntryState(60e3, 0.3, 85 * degree, 6000.0, -0.05, 0.0), 0.0, rotation_rate=0.0
    ),
    "a fall from rest": Case(
        EntryState(9144.0, 0.4, 0.3, 0.0, 0.2, 0.5), lift_to_drag=0.0, ground=0.0
    ),
    "from rest in wind": Case(
        EntryState(9144.0, 0.4, 0.3, 0.0, 0.0, 0.5),
        1.0,
        wind=(20.0, -10.0, 3.0),
        density_scale=40.0,
        ground=6000.0,
    ),
    "up and down": Case(
        EntryState(9144.0, 0.2, 0.4, 200.0, 90 * degree, 0.5),
        lift_to_drag=0.0,
        ground=0.0,
    ),
    # It comes through the vertical over the ground, and then flies backwards.
    "in a head wind": Case(
        EntryState(30e3, 0.2, 0.4, 700.0, -30 * degree, 90 * degree),
        1.0,
        wind=(-60.0, 10.0, 0.0),
        density_scale=60.0,
        ground=20e3,
    ),
    "in a head wind without lift": Case(
        EntryState(30e3, 0.2, 0.0, 700.0, -30 * degree, 90 * degree),
        lift_to_drag=0.0,
        wind=(-60.0, 0.0, 0.0),
        density_scale=60.0,
        ground=20e3,
    ),
}
VACUUM = Case(
    EntryState(9144.0, 0.2, 0.4, 200.0, 90 * degree, 0.5),
    rotation_rate=0.0,
    density_scale=1e-30,
    ground=9144.0 - 1e-6,
)
FROM_POLE = Case(
    EntryState(60e3, 0.7, 90 * degree, 3000.0, -0.1, 0.4), rotation_rate=0.0
)
FROM_EQUATOR = Case(
    EntryState(60e3, 0.0, 0.0, 3000.0, -0.1, 90 * degree), rotation_rate=0.0
)
FROM_VERTICAL = Case(
    EntryState(60e3, 0.2, 0.4, 3000.0, -90 * degree, 3.0),
    rotation_rate=0.0,
    ground=20e3,
)
CASES = [*SINGULAR.values(), *ORDINARY, VACUUM, FROM_POLE, FROM_EQUATOR, FROM_VERTICAL]


@pytest.fixture(scope="module")
def flights():
    """The flights of all cases, by one compiled program."""
    return fly_all(CASES, VectorDynamics())


@pytest.fixture(scope="module")
def angles():
    """The same flights with altitude and angles."""
    return fly_all(CASES, EntryDynamics())


def place_of(case):
    return next(i for i, other in enumerate(CASES) if other is case)


def of(flights, case):
    return lane_of(flights, place_of(case))


@pytest.mark.parametrize("name", SINGULAR)
def test_passes_agree_with_an_independent_integration(flights, name):
    case = SINGULAR[name]
    flight = of(flights, case)
    falls = case.ground > BELOW
    assert int(flight.outcome) == (Outcome.CRASHED if falls else Outcome.TIMED_OUT)
    position, velocity = case.expected(flight.time)
    found = cartesian.from_entry_state(RADIUS, jax.tree.map(float, flight.state), np)
    # RK4 with 0.1 s on changes within some 10 s: 1e-8 of the changes of 1e3 m and m/s.
    assert np.linalg.norm(found[0] - position) < 2e-5
    assert np.linalg.norm(found[1] - velocity) < 1e-6
    for leaf in jax.tree.leaves(flight):
        assert np.all(np.isfinite(leaf))


def test_the_cases_are_singular_with_angles(angles):
    """Those that come to a singular point itself, and none of the ordinary ones."""
    for name in ("through a pole", "up and down", "in a head wind without lift"):
        assert int(of(angles, SINGULAR[name]).outcome) == Outcome.SINGULAR
    assert not any(
        int(of(angles, case).outcome) == Outcome.SINGULAR for case in ORDINARY
    )


def test_ordinary_flights_are_those_of_entry_dynamics(flights, angles):
    """Longitude and heading count the same turns, and the peaks are equal."""
    for case in ORDINARY:
        found, expected = of(flights, case), of(angles, case)
        assert found.outcome == expected.outcome
        # Both err by 1e-9 of their changes, in steps of 0.1 s: 1e-6 m of 1e6 m.
        for name, close in (
            ("altitude", 1e-6),
            ("longitude", 1e-12),
            ("latitude", 1e-12),
            ("velocity", 1e-8),
            ("flight_path_angle", 1e-10),
            ("heading", 1e-10),
        ):
            pair = getattr(found.state, name), getattr(expected.state, name)
            np.testing.assert_allclose(*pair, rtol=0.0, atol=close, err_msg=name)
        for name, peak in found.peaks.items():
            np.testing.assert_allclose(peak, expected.peaks[name], rtol=1e-9)
    # Over the branch of the arc tangent.
    assert of(flights, ORDINARY[0]).state.longitude > np.pi
    assert of(flights, ORDINARY[1]).state.longitude < -np.pi


@pytest.mark.slow
def test_a_batch_is_the_flights_alone(flights):
    for case in (SINGULAR["over a pole"], SINGULAR["a fall from rest"]):
        alone = fly_all([case], VectorDynamics())
        together = of(flights, case)
        for one, other in zip(
            jax.tree.leaves(alone), jax.tree.leaves(together), strict=True
        ):
            # Another order of fusion: rounding, which 2000 steps add up.
            np.testing.assert_allclose(one[0], other, rtol=1e-11, atol=1e-9)


def test_a_throw_through_rest_keeps_time_and_energy(flights):
    """Kepler's equation of a straight orbit, up to the highest point and down again."""
    flight, start = of(flights, VACUUM), VACUUM.state
    first, speed = RADIUS + float(start.altitude), float(start.velocity)
    last = RADIUS + VACUUM.ground
    axis = 1.0 / (2.0 / first - speed**2 / MU)

    def since_rest(radius):
        anomaly = np.arccos(1.0 - radius / axis)
        return np.sqrt(axis**3 / MU) * (np.pi - anomaly + np.sin(anomaly))

    # Differences of arcs near pi, of which the rounding of 1e-16 counts for 1e-7 s.
    time = since_rest(first) + since_rest(last)
    np.testing.assert_allclose(flight.time, time, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(flight.state.velocity, speed, rtol=1e-8)
    np.testing.assert_allclose(flight.state.flight_path_angle, -90 * degree)
    for name in ("longitude", "latitude"):
        np.testing.assert_allclose(
            getattr(flight.state, name), getattr(start, name), rtol=1e-13
        )


def test_a_start_at_a_pole_is_one_at_the_equator(flights):
    """Over a sphere at rest all places are equal; the heading counts at the longitude."""
    pole, equator = of(flights, FROM_POLE).state, of(flights, FROM_EQUATOR).state
    for name in ("altitude", "velocity", "flight_path_angle"):
        np.testing.assert_allclose(
            getattr(pole, name), getattr(equator, name), rtol=1e-12
        )
    # North at the longitude 0.7 points over the pole, to the longitude 0.7 + pi.
    start = FROM_POLE.state
    turn = pole.longitude - (start.longitude + np.pi - start.heading)
    assert abs(np.sin(turn)) < 1e-12 < np.cos(turn)
    np.testing.assert_allclose(pole.latitude, np.pi / 2 - equator.longitude)
    np.testing.assert_allclose(np.cos(pole.heading), -1.0)


def flown_in_a_plane(case, time):
    """Altitude, arc, velocity and path angle, of a flight with its lift in the vertical
    plane over a sphere at rest."""

    def rate(_, y):
        altitude, _, velocity, path = y
        density = 0.0158 * np.exp(-altitude / 9354.5)
        drag = 0.5 * density * velocity**2 / 115.0
        radius = RADIUS + altitude
        gravity, level = MU / radius**2, velocity * np.cos(path)
        return (
            velocity * np.sin(path),
            level / radius,
            -drag - gravity * np.sin(path),
            (case.lift_to_drag * drag - gravity * np.cos(path)) / velocity
            + level / radius,
        )

    start = case.state
    first = start.altitude, 0.0, start.velocity, start.flight_path_angle
    span = 0.0, float(time)
    first = [float(x) for x in first]
    solved = solve_ivp(rate, span, first, "DOP853", rtol=1e-12, atol=1e-12)
    return solved.y[:, -1]


def test_a_start_in_the_vertical_takes_its_heading(flights):
    """The lift turns it towards the heading of the start."""
    flight, start = of(flights, FROM_VERTICAL), FROM_VERTICAL.state
    altitude, arc, velocity, path = flown_in_a_plane(FROM_VERTICAL, flight.time)
    np.testing.assert_allclose(altitude, FROM_VERTICAL.ground, atol=1e-5)
    np.testing.assert_allclose(flight.state.velocity, velocity, rtol=1e-9)
    np.testing.assert_allclose(flight.state.flight_path_angle, path, rtol=1e-9)
    first, last = (
        cartesian.from_entry_state(RADIUS, jax.tree.map(float, state), np)[0]
        for state in (start, flight.state)
    )
    east, north, _ = cartesian.local_axes(first)
    heading = float(start.heading)
    ahead = np.sin(heading) * east + np.cos(heading) * north
    assert arc > 1e-5
    # The horizontal speed at the start is 2e-13 m/s by rounding, in any direction.
    np.testing.assert_allclose(
        last @ ahead / cartesian.norm(last), np.sin(arc), rtol=1e-9
    )
    np.testing.assert_allclose(flight.state.heading, heading, atol=1e-4)


# The state of vectors.


POINTS = {
    "ordinary": (0.3, 0.4, 900.0, -0.5, 2.0),
    "other turns": (-4.0, -1.2, 900.0, 0.5, 6.2),
    "at the north pole": (0.3, 90 * degree, 900.0, -0.5, 2.0),
    "at the south pole": (4.0, -90 * degree, 900.0, -0.5, 2.0),
    "upwards": (0.3, 0.4, 900.0, 90 * degree, 2.0),
    "downwards": (0.3, 0.4, 900.0, -90 * degree, -5.0),
    "at rest": (0.3, 0.4, 0.0, 0.0, 2.0),
    "down at a pole": (0.3, 90 * degree, 900.0, -90 * degree, 2.0),
    "at rest at a pole": (0.3, 90 * degree, 0.0, 0.0, 2.0),
}


@jax.jit
def there_and_back(state):
    return VectorState.of(state).entry_state


@pytest.mark.parametrize("name", POINTS)
def test_vectors_have_the_angles_that_they_are_made_of(name):
    state = EntryState(50e3, *POINTS[name])
    for one, other in zip(
        jax.tree.leaves(there_and_back(state)), jax.tree.leaves(state), strict=True
    ):
        # Near a pole the latitude is that of a cosine of 6e-17.
        np.testing.assert_allclose(one, other, rtol=1e-14, atol=1e-14)


def test_single_precision_has_them_too():
    for numbers in POINTS.values():
        state = EntryState(50e3, *numbers)
        single = jax.tree.map(lambda x: x.astype(jnp.float32), state)
        for one, other in zip(
            jax.tree.leaves(there_and_back(single)),
            jax.tree.leaves(state),
            strict=True,
        ):
            np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-3)


@jax.jit
def rates(state, controls, gravity_harmonic):
    """By vectors and by angles, about an oblate planet in wind."""
    planet = dataclasses.replace(
        mars_planet(rotation_rate=MARS_ROTATION, wind=ConstantWind(30.0, -20.0, 5.0)),
        gravity=ZonalGravity(MU, RADIUS, {"j2": gravity_harmonic, "j3": 1e-4}),
        shape=Ellipsoid(RADIUS, 0.01),
    )
    vehicle = ballistic_vehicle(115.0, 0.18)
    return (
        VectorDynamics().rates(planet, vehicle, state, controls),
        entry_dynamics(planet, vehicle, state, controls),
    )


def test_rates_of_the_angles_are_those_of_entry_dynamics():
    draw = np.random.default_rng(20261129)
    for _ in range(20):
        low = [20e3, -7.0, -1.4, 300.0, -1.4, -7.0]
        high = [90e3, 7.0, 1.4, 7000.0, 1.4, 7.0]
        state = EntryState(*draw.uniform(low, high))
        bank = jnp.asarray(draw.uniform(-3, 3))
        controls = Controls.from_bank(bank, jnp.asarray(0.0))
        found, expected = rates(state, controls, jnp.asarray(2e-3))
        for one, other in zip(
            jax.tree.leaves(found), jax.tree.leaves(expected), strict=True
        ):
            # Rounding of terms that partly cancel, of 1e2 m/s2 and m/s.
            np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-13)


@jax.jit
def derivatives(numbers):
    """Of all rates of the vectors over the numbers of a state, first and second."""

    def flat(numbers):
        planet = mars_planet(
            rotation_rate=MARS_ROTATION, wind=ConstantWind(*jnp.zeros(3))
        )
        motion = VectorState.of(EntryState(*numbers))
        controls = Controls.from_bank(jnp.asarray(0.7), jnp.asarray(0.0))
        vehicle = ballistic_vehicle(115.0, 0.18)
        moved = VectorDynamics().motion_rates(planet, vehicle, motion, controls)
        seen = motion.entry_state
        return jnp.stack(jax.tree.leaves((moved.altitude, moved.velocity, seen)))

    forward, backward = jax.jacfwd(flat), jax.jacrev(flat)
    return forward(numbers), backward(numbers), jax.jacfwd(backward)(numbers)


@pytest.mark.parametrize("name", POINTS)
def test_derivatives_are_finite_everywhere(name):
    forward, backward, second = derivatives(jnp.asarray([50e3, *POINTS[name]]))
    np.testing.assert_allclose(forward, backward, rtol=1e-9, atol=1e-9)
    assert np.all(np.isfinite(second))


# Derivatives of whole flights, and about an oblate planet.


DIFFERENTIATED = (
    "over a pole",
    "a fall from rest",
    "up and down",
    "in a head wind without lift",
)


@pytest.mark.slow
def test_derivatives_of_flights_agree_with_differences():
    cases = [SINGULAR[name] for name in DIFFERENTIATED]
    # One structure, so that one program serves all.
    scenarios = jax.tree.map(
        lambda *x: jnp.stack(x), *(case.scenario(VectorDynamics()) for case in cases)
    )
    starts = jnp.stack([jnp.stack(jax.tree.leaves(case.state)) for case in cases])

    def end(scenario, numbers):
        scenario = dataclasses.replace(scenario, initial_state=EntryState(*numbers))
        flight = fly(scenario, FixedStep(STEP))
        state = flight.state
        outward = jnp.cos(state.latitude)
        return jnp.stack(
            [
                state.altitude / km,
                state.velocity / 100.0,
                flight.time,
                1e3 * state.latitude,
                1e3 * jnp.sin(state.longitude) * outward,
            ]
        )

    @jax.jit
    def both(numbers):
        forward = jax.vmap(jax.jacfwd(end, 1))(scenarios, numbers)
        return forward, jax.vmap(jax.jacrev(end, 1))(scenarios, numbers)

    forward, backward = both(starts)
    np.testing.assert_allclose(forward, backward, rtol=1e-8, atol=1e-8)
    flown = jax.jit(lambda numbers: jax.vmap(end)(scenarios, numbers))
    for place, step in enumerate((1.0, 1e-5, 1e-5, 1e-2, 1e-5, 1e-5)):
        away = np.tile(step * np.eye(6)[place], (len(cases), 1))
        slope = (flown(starts + away) - flown(starts - away)) / (2.0 * step)
        # Second order in the step, of numbers of about one; and rounding over it.
        np.testing.assert_allclose(
            np.asarray(forward)[..., place], slope, rtol=2e-5, atol=2e-5
        )
    assert np.all(np.any(np.asarray(forward) != 0.0, axis=(1, 2)))


@pytest.mark.slow
@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (30.0, -20.0, 4.0)])
def test_an_oblate_planet_from_one_side_of_its_pole_to_the_other(wind):
    """With J2 to J4, geodetic altitude of the air, wind, lift and rotation."""
    start = EntryState(110 * km, 0.3, 86 * degree, 7600.0, -3 * degree, 0.4 * degree)
    planet = Planet(
        6371 * km,
        gravity=ZonalGravity(
            oblate.EARTH.parameter,
            oblate.EARTH.reference_radius,
            {f"j{n}": value for n, value in oblate.EARTH.harmonics.items()},
        ),
        atmosphere=ExponentialAtmosphere(1.225, 7200.0),
        rotation_rate=oblate.EARTH.rotation_rate,
        shape=Ellipsoid(oblate.EARTH.equatorial_radius, oblate.EARTH.flattening),
        wind=ConstantWind(*wind),
    )
    bank = 60 * degree
    scenario = Scenario(
        planet,
        ballistic_vehicle(300.0, 0.3),
        start,
        ConstantBank(bank),
        Termination({}, 250.0),
        NOWHERE,
        dynamics=VectorDynamics(),
        constraints={},
    )
    flight = fly_compiled(scenario, FixedStep(0.05))

    def drag(altitude, speed):
        return 0.5 * 1.225 * np.exp(-altitude / 7200.0) * speed**2 / 300.0

    lift = lambda altitude, speed: 0.3 * drag(altitude, speed)
    begin = oblate.as_vectors(oblate.EARTH, 6371 * km, start, 0.0)
    expected = oblate.flown(oblate.EARTH, *begin, 250.0, drag, lift, bank, wind)
    position, velocity = oblate.as_vectors(oblate.EARTH, 6371 * km, flight.state, 250.0)
    assert flight.state.latitude < 86 * degree
    assert np.cos(flight.state.longitude - start.longitude) < 0.0
    # A wind of 30 m/s turns by half a turn within the two steps about the pole.
    close = 1e-4 if any(wind) else 1e-5
    assert np.linalg.norm(position - expected[0]) < close
    assert np.linalg.norm(velocity - expected[1]) < close
