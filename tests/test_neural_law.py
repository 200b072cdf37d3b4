"""The neural law: what it reads, what it commands, its limits, and its derivatives."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from great_circles import by_trigonometry
from helpers import fly_compiled
from jax.flatten_util import ravel_pytree
from neural_laws import (
    ANGLES,
    PERIOD,
    SOLVER,
    gliding_scenario_of,
    law_of,
    network_of,
    scenario_of,
)
from winds_on_board import STATE, WINDS, air_velocity, sensed as sensed_in

from jentry.flight import misses
from jentry.flight.scenario_checks import check
from jentry.guidance import BankProfile, Sampled
from jentry.guidance.neural_law import (
    INPUTS,
    AngleOfAttackLimits,
    inputs_of,
)
from jentry.missions.mars.drag_tracking import entry
from jentry.onboard import (
    FlowSensors,
    Measurement,
    PolynomialProfile,
    RecurrentNetwork,
    measure,
)
from jentry.units import degree, km


def flown(law):
    """With its history, which some tests look at: one program for all of them."""
    return fly_compiled(scenario_of(law), SOLVER, PERIOD)


def aim_of(law):
    return scenario_of(law).law.aim


def sensed(state, lift_factor=1.0, drag_factor=1.0, law=None):
    model = (law or law_of()).model
    angle = model.vehicle.trim_angle_of_attack
    found = measure(model.planet, model.vehicle, state, angle)
    return Measurement(
        state, lift_factor * found.lift, drag_factor * found.drag, angle, angle, {}
    )


def state_at(**moved):
    return dataclasses.replace(
        entry().initial_state, **{n: jnp.asarray(x) for n, x in moved.items()}
    )


def read_at(state, bank=0.0, **factors):
    law = law_of()
    read = inputs_of(
        law.model, aim_of(law), sensed(state, **factors), jnp.asarray(bank)
    )
    return dict(zip(INPUTS, np.asarray(read), strict=True))


MIDDLE = {
    "altitude": 31.0 * km,
    "longitude": 7.3 * degree,
    "latitude": 0.4 * degree,
    "velocity": 3100.0,
    "flight_path_angle": -9.0 * degree,
    "heading": 88.0 * degree,
}


@pytest.mark.parametrize("wind", WINDS)
def test_the_drag_of_the_model_is_that_in_its_wind(wind):
    """In the wind of the model and of the air alike the drag is that of the model."""
    law, wind = law_of(), WINDS[wind]
    model = dataclasses.replace(
        law.model, planet=dataclasses.replace(law.model.planet, wind=wind)
    )
    aim = aim_of(law)
    law = dataclasses.replace(law, model=model)
    read = inputs_of(model, aim, sensed(STATE, law=law), jnp.asarray(0.0))
    read = dict(zip(INPUTS, np.asarray(read), strict=True))
    density = 0.0158 * np.exp(-float(STATE.altitude) / 9354.5)
    drag = 0.5 * density * np.sum(air_velocity(wind) ** 2) / 115.0
    unit = 6750.0**2 / (723.32 * km)
    expected = np.log(np.hypot(drag / unit, 1e-3))
    assert read["ln of the drag of the model"] == pytest.approx(expected, abs=1e-10)
    assert read["ln of the sensed drag, over that of the model"] == 0.0
    still = 0.5 * density * float(STATE.velocity) ** 2 / 115.0
    assert abs(drag / still - 1.0) > 1e-3


BLOWN = {"head": (-50.0, 0.0), "side": (0.0, -50.0)}
"""Wind along the heading and to its right, m/s"""


@pytest.mark.parametrize("wind", BLOWN)
def test_a_law_reads_the_wind_from_the_flow(wind):
    """Behind its other inputs, over a hundredth of the velocity of the origin."""
    law = law_of(reads_flow=True, angles=ANGLES)
    sensors = FlowSensors(least_dynamic_pressure=0.0)
    law = dataclasses.replace(law, aim=aim_of(law))
    read = law.reads(sensed_in(WINDS[wind], sensors), jnp.asarray(0.2))
    expected = [1.0, *(x / 67.5 for x in BLOWN[wind])]
    np.testing.assert_allclose(read[-3:], expected, atol=1e-12)
    plain = dataclasses.replace(law_of(angles=ANGLES), aim=law.aim)
    others = plain.reads(sensed_in(WINDS[wind]), jnp.asarray(0.2))
    np.testing.assert_array_equal(read[:-3], others)
    thin = FlowSensors(least_dynamic_pressure=1e9)
    unseen = law.reads(sensed_in(WINDS[wind], thin), jnp.asarray(0.2))
    np.testing.assert_array_equal(unseen[-3:], 0.0)


def test_a_law_that_reads_the_flow_needs_sensors_and_a_network_for_them():
    with pytest.raises(ValueError, match="give the scenario flow_sensors, such as"):
        flown(law_of(reads_flow=True))
    with pytest.raises(ValueError, match="it lacks 'whether the flow is sensed'"):
        law_of(network_of(), reads_flow=True)
    with pytest.raises(ValueError, match="the law has no 'whether the flow is sensed'"):
        law_of(network_of(flow=True))


@pytest.mark.slow
def test_the_flow_changes_the_flight_where_it_is_sensed():
    law = law_of(reads_flow=True, network=network_of(flow=True, size=20.0))
    ends = []
    for pressure in (850.0, 1e9):
        scenario = dataclasses.replace(
            scenario_of(law), flow_sensors=FlowSensors(least_dynamic_pressure=pressure)
        )
        flight = fly_compiled(scenario, SOLVER, None)
        assert np.isfinite(float(flight.state.longitude))
        ends.append(float(flight.state.longitude))
    assert abs(ends[0] - ends[1]) > 1e-5


ENTRY = {
    "altitude": 126.1 * km,
    "velocity": 6750.0,
    "flight_path_angle": -14.4 * degree,
}


def periapsis(altitude, velocity, flight_path_angle, **others):
    """By energy and angular momentum, in vectors: least radius of a Kepler orbit, m."""
    parameter = float(entry().planet.gravity.gravitational_parameter)
    radius = 3397.0 * km + altitude
    place = np.array([radius, 0.0])
    speed = velocity * np.array([np.sin(flight_path_angle), np.cos(flight_path_angle)])
    momentum = radius * speed[1]
    pull = place * (speed @ speed - parameter / radius) - speed * (place @ speed)
    eccentricity = np.hypot(np.linalg.norm(pull) / parameter, 1e-3)
    return momentum**2 / parameter / (1.0 + eccentricity)


def test_the_inputs_are_those_of_their_formulas():
    """Every input by numpy, of the state, the target and an exponential atmosphere."""
    read = read_at(state_at(**MIDDLE), bank=0.7, lift_factor=1.1, drag_factor=0.9)
    speed, length, radius = 6750.0, 723.32 * km, 3397.0 * km
    here = MIDDLE["longitude"], MIDDLE["latitude"], MIDDLE["heading"]
    ahead, left = by_trigonometry(radius, here, (length / radius, 0.0))
    density = 0.0158 * np.exp(-MIDDLE["altitude"] / 9354.5)
    drag = 0.5 * density * MIDDLE["velocity"] ** 2 / 115.0
    unit = speed**2 / length

    def ln(force):
        return np.log(np.hypot(force / unit, 1e-3))

    to_go = np.hypot(ahead / length, 0.003)
    square, end = (MIDDLE["velocity"] / speed) ** 2, (503.0 / speed) ** 2
    excess = 0.5 * (square - end + np.hypot(square - end, 0.1 * end))
    needed = np.log(0.5 * excess / to_go)
    expected = [
        MIDDLE["velocity"] / speed,
        np.log(MIDDLE["velocity"] / speed),
        (MIDDLE["altitude"] - 10.0 * km) / (126.1 * km),
        MIDDLE["flight_path_angle"],
        ahead / length,
        np.tanh(ahead / length / 0.03),
        -left / length / to_go,
        -left / length / 0.02,
        needed,
        needed - ln(drag),
        ln(drag),
        ln(0.9 * drag) - ln(drag),
        ln(1.1 * 0.18 * drag) - ln(0.18 * drag),
        np.sin(0.7),
        np.cos(0.7),
        np.tanh((periapsis(**MIDDLE) - periapsis(**ENTRY)) / (0.1 * 126.1 * km)),
        # The plane of origin and aim is the equator: its normal points to the north.
        -np.cos(MIDDLE["latitude"]) * np.cos(MIDDLE["heading"]),
    ]
    np.testing.assert_allclose(list(read.values()), expected, rtol=1e-10)


@pytest.mark.parametrize("more", [-0.3, 0.05, 0.2])
def test_a_shallow_entry_has_a_higher_periapsis(more):
    """By some degrees at the entry, in a Kepler orbit."""
    moved = ENTRY | {"flight_path_angle": ENTRY["flight_path_angle"] + more * degree}
    read = read_at(state_at(**moved))
    found = read["periapsis of a free flight, close to that of the aim's origin"]
    expected = np.tanh((periapsis(**moved) - periapsis(**ENTRY)) / (0.1 * 126.1 * km))
    assert found == pytest.approx(expected, rel=1e-9)
    assert 0.05 < abs(found) < 0.95 and np.sign(found) == np.sign(more)


@pytest.mark.parametrize(
    "moved",
    [
        {},
        {"altitude": 400.0 * km},
        {"velocity": 200.0, "altitude": 9.0 * km},
        {"longitude": 723.32 / 3397.0},
        {"longitude": 730.0 / 3397.0, "latitude": 0.0},
    ],
)
def test_inputs_and_their_derivatives_are_finite_everywhere(moved):
    """Above the air, slower than the aim, over the target and beyond it."""
    law = law_of()
    aim, state = aim_of(law), state_at(**{**MIDDLE, **moved})

    def read(state):
        return inputs_of(law.model, aim, sensed(state), jnp.asarray(0.1))

    value, slopes = read(state), jax.jacfwd(read)(state)
    assert np.all(np.isfinite(value))
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(slopes))


def test_a_place_to_the_right_is_a_positive_number():
    """The heading is east: south is to the right."""
    read = read_at(
        state_at(**{**MIDDLE, "latitude": 0.5 * degree, "heading": math.pi / 2})
    )
    assert read["range to the right"] > 0.0
    assert read[COURSE] == pytest.approx(0.0, abs=1e-12)
    south = read_at(
        state_at(**{**MIDDLE, "latitude": 0.5 * degree, "heading": 0.6 * math.pi})
    )
    assert south[COURSE] > 0.1
    assert read["range to the right, over the distance to go"] > 0.0


COURSE = "sine of the course to the right of the plane of origin and aim"

ORIGIN = {"longitude": 0.3, "latitude": -0.4, "heading": 0.9}


def direction(longitude, latitude):
    """Unit vector from the centre of the planet, and those to the east and the north."""
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    out = np.array([np.cos(longitude), np.sin(longitude), 0.0]) * np.cos(latitude)
    out[2] = np.sin(latitude)
    return out, east, np.cross(out, east)


def course(origin, angle, across, state):
    """Component of the level course along the normal of the plane of origin and aim, over
    the sine of the downrange, by vectors; the crossrange of the aim is to the left."""
    up, east, north = direction(origin["longitude"], origin["latitude"])
    ahead = np.sin(origin["heading"]) * east + np.cos(origin["heading"]) * north
    aim = np.cos(angle) * up + np.sin(angle) * ahead
    aim = np.cos(across) * aim + np.sin(across) * np.cross(up, ahead)
    _, east, north = direction(state["longitude"], state["latitude"])
    level = np.sin(state["heading"]) * east + np.cos(state["heading"]) * north
    return -np.cross(up, aim) @ level / np.sin(angle)


@jax.jit
def read_course(origin, angle, across, state):
    law, start = law_of(), entry().initial_state
    origin, state = (dataclasses.replace(start, **x) for x in (origin, state))
    aim = dataclasses.replace(
        aim_of(law),
        origin=origin,
        downrange=angle * law.model.planet.radius,
        crossrange=across * law.model.planet.radius,
    )
    read = inputs_of(law.model, aim, sensed(state), jnp.asarray(0.0))
    return read[INPUTS.index(COURSE)]


def as_arrays(numbers):
    return {name: jnp.asarray(x) for name, x in numbers.items()}


@pytest.mark.parametrize("angle, across", [(0.37, 8e-4), (1.2, -0.01), (2.9, 0.0)])
def test_the_course_is_that_from_the_plane_of_origin_and_aim(angle, across):
    state = {"longitude": 0.8, "latitude": 0.2, "heading": 2.1}
    found = read_course(
        as_arrays(ORIGIN), jnp.asarray(angle), jnp.asarray(across), as_arrays(state)
    )
    expected = course(ORIGIN, angle, across, state)
    assert float(found) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("moved", [{}, {"latitude": 0.0, "heading": math.pi / 2}])
@pytest.mark.slow
def test_the_course_is_regular_at_the_antipode_and_without_a_downrange(moved):
    """There it is that from the plane of the origin's course, also for an aim aside."""
    origin = ORIGIN | moved
    state = as_arrays({"longitude": 0.8, "latitude": 0.2, "heading": 2.1})
    expected = course(origin, 1.0, 0.0, state)  # no crossrange: the same at any angle
    slopes = jax.jit(jax.jacfwd(jax.jacrev(read_course, (0, 1, 2, 3)), (0, 1, 2, 3)))
    for angle in (0.0, math.pi):
        for across in (0.0, 8e-4):
            numbers = jnp.asarray(angle), jnp.asarray(across)
            found = read_course(as_arrays(origin), *numbers, state)
            there = math.cos(across) * expected
            assert float(found) == pytest.approx(there, abs=1e-12)
            if angle == 0.0:  # the other inputs are over the downrange
                continue
            second = slopes(as_arrays(origin), *numbers, state)
            assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(second))


def test_the_course_is_bounded_beside_the_antipode():
    """The plane turns by less than half a right angle for an aim that is aside."""
    state = as_arrays({"longitude": 0.8, "latitude": 0.2, "heading": 2.1})
    angles = math.pi + np.concatenate([-np.logspace(-9, -1), np.logspace(-9, -1)])
    many = jax.vmap(read_course, (None, 0, None, None))
    found = many(as_arrays(ORIGIN), jnp.asarray(angles), jnp.asarray(0.01), state)
    assert np.max(np.abs(found)) < math.sqrt(2.0)


def test_a_cycle_turns_as_fast_as_the_vehicle_can():
    law = law_of(turn_rate=2.0 * degree, largest_bank=1.2)
    most = 2.0 * degree * PERIOD
    for bank, output in ((0.0, 50.0), (0.5, -50.0), (-1.1, 50.0)):
        turned = float(law.turned(jnp.asarray(bank), jnp.asarray(output)))
        assert turned - bank == pytest.approx(math.copysign(most, output), rel=1e-6)
    close = float(law.turned(jnp.asarray(0.3), jnp.arctanh(jnp.asarray(0.301 / 1.2))))
    assert close == pytest.approx(0.301, abs=1e-6)


def test_the_bank_of_a_flight_keeps_its_limits():
    law = law_of(network_of(size=300.0), largest_bank=0.9, turn_rate=5.0 * degree)
    history = flown(law).history
    bank = np.asarray(history.decisions.bank)
    bank = bank[np.isfinite(np.asarray(history.time))]
    assert np.max(np.abs(bank)) <= 0.9
    assert np.max(np.abs(np.diff(bank))) <= 5.0 * degree * PERIOD + 1e-12
    assert np.ptp(bank) > 0.2


def test_the_first_bank_is_that_before_the_first_decision():
    """A slow vehicle still has most of it after the first one."""
    law = law_of(first_bank=1.0, turn_rate=0.1 * degree)
    held = flown(law).history.decisions.bank
    assert float(held[0]) == pytest.approx(1.0, abs=0.1 * degree * PERIOD + 1e-12)


def test_the_law_remembers():
    """The same network without what its memory adds flies elsewhere."""
    network = network_of(size=20.0)
    forgetful = eqx.tree_at(
        lambda n: n.layers[0].weight,
        network,
        replace_fn=lambda w: w.at[:, len(INPUTS) :].set(0.0),
    )
    a, b = (flown(law_of(n)).state.longitude for n in (network, forgetful))
    assert abs(float(a - b)) > 1e-5


def test_the_memory_goes_from_decision_to_decision():
    """A cell that reads nothing: its memory alone moves it, by the formula of the cell."""
    network = network_of()
    blind = eqx.tree_at(lambda n: n.cell.weight_ih, network, replace_fn=jnp.zeros_like)
    blind = eqx.tree_at(lambda n: n.cell.bias, blind, replace_fn=lambda b: 0.3 + b)
    memory = flown(law_of(blind)).history.decisions.memory[:5]
    expected = jnp.zeros(3)
    for found in memory:
        expected = blind.cell(jnp.zeros(len(INPUTS)), expected)
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert np.all(np.abs(np.diff(memory, axis=0)).max(axis=1) > 1e-4)


def test_decisions_beyond_the_training_are_a_caveat():
    network = network_of()
    assert float(flown(law_of(network)).caveats["decisions_beyond_training"]) == 0.0
    narrow = eqx.tree_at(
        lambda n: n.input_ranges, network, network.input_ranges.at[0].set([0.5, 2.0])
    )
    flight = flown(law_of(narrow))
    velocity = np.asarray(flight.history.states.velocity) / 6750.0
    velocity = velocity[np.isfinite(velocity)]
    share = float(flight.caveats["decisions_beyond_training"])
    assert share == pytest.approx(np.mean(velocity < 0.5), abs=2.0 / len(velocity))
    assert 0.1 < share < 0.9


def other_law():
    return Sampled(BankProfile(PolynomialProfile(jnp.array([0.6, 0.0001]))), PERIOD)


def same(a, b):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-9, equal_nan=False)


def test_a_network_of_zeros_corrects_nothing():
    zero = jax.tree.map(jnp.zeros_like, network_of().layers)
    network = eqx.tree_at(lambda n: n.layers, network_of(), zero)
    beside = law_of(network, beside=other_law(), corrects=True)
    same(flown(beside).state, flown(other_law()).state)


def test_a_correction_adds_to_the_bank():
    beside = law_of(network_of(size=20.0), beside=other_law(), corrects=True)
    history = flown(beside).history
    flying = np.isfinite(np.asarray(history.time))
    command = np.arctan2(history.controls.sin_bank, history.controls.cos_bank)[flying]
    correction = np.asarray(history.decisions.bank)[flying]
    held = history.decisions.beside.command
    other = np.arctan2(held.sin_bank, held.cos_bank)[flying]
    np.testing.assert_allclose(np.sin(command - other - correction), 0.0, atol=1e-12)
    assert np.max(np.abs(correction)) > 0.1


def test_beyond_the_training_the_law_beside_flies():
    network = network_of(size=20.0)
    never = eqx.tree_at(
        lambda n: n.input_ranges, network, jnp.full((len(INPUTS), 2), 1e3)
    )
    same(flown(law_of(never, beside=other_law())).state, flown(other_law()).state)
    same(
        flown(law_of(never, beside=other_law(), corrects=True)).state,
        flown(other_law()).state,
    )
    alone, beside = law_of(network), law_of(network, beside=other_law())
    same(flown(beside).state, flown(alone).state)


def test_the_law_beside_does_not_give_back_the_command():
    """Beyond only while the velocity is between two values: it flies to the end."""
    network = network_of(size=20.0)
    ranges = network.input_ranges.at[0].set([0.6, 2.0])
    slow = eqx.tree_at(lambda n: n.input_ranges, network, ranges)
    history = flown(law_of(slow, beside=other_law())).history
    flying = np.isfinite(np.asarray(history.time))
    beyond = np.asarray(history.decisions.beyond)[flying]
    velocity = np.asarray(history.states.velocity)[flying] / 6750.0
    np.testing.assert_array_equal(beyond, (velocity < 0.6).astype(float))
    # The other way about: fast at first, which is beyond, and slow later.
    ranges = network.input_ranges.at[0].set([-1.0, 0.99])
    fast = eqx.tree_at(lambda n: n.input_ranges, network, ranges)
    flight = flown(law_of(fast, beside=other_law()))
    same(flight.state, flown(other_law()).state)
    assert float(flight.caveats["decisions_beyond_training"]) < 0.9


@pytest.mark.parametrize("address", ["downrange", "origin.altitude"])
def test_an_aim_whose_numbers_cannot_be_units_is_refused(address):
    """All inputs would be over zero, and the flight not finite."""
    scenario = scenario_of(law_of())
    target = scenario.place
    origin = dataclasses.replace(
        target.origin or scenario.initial_state,
        **({"altitude": 0.0} if "." in address else {}),
    )
    changed = {"origin": origin} if "." in address else {"downrange": 0.0}
    wrong = dataclasses.replace(target, **changed)
    with pytest.raises(ValueError, match=f"^guidance, NeuralLaw: {address} of the aim"):
        check(dataclasses.replace(scenario, target=wrong))
    aim = dataclasses.replace(scenario.law.aim, **changed)
    with pytest.raises(ValueError, match=f"{address} of the aim is zero"):
        law_of(aim=aim)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="corrects is True and beside is None"):
        law_of(corrects=True)
    other = Sampled(BankProfile(PolynomialProfile(jnp.ones(1))), 2.0)
    with pytest.raises(ValueError, match="both must decide together"):
        law_of(beside=other)
    with pytest.raises((ValueError, TypeError), match="beside"):
        law_of(beside=BankProfile(PolynomialProfile(jnp.ones(1))))
    samples = {name: np.zeros(2) for name in ("a", "b")}
    wrong = RecurrentNetwork.untrained(samples, 2, (3,), 1, jax.random.key(0))
    with pytest.raises(
        ValueError, match="it lacks 'velocity'.*the law has no 'a', 'b';"
    ):
        law_of(wrong)
    two = RecurrentNetwork.untrained(
        dict.fromkeys(INPUTS, np.zeros(2)), 2, (3,), 2, jax.random.key(0)
    )
    with pytest.raises(
        ValueError, match="has 2 outputs, and this law 1: the bank. .* lacks none"
    ):
        law_of(two)
    with pytest.raises(ValueError, match="this law 2: bank and angle of attack"):
        law_of(network_of(), angles=ANGLES)
    for lowest, highest in ((14.0, 2.0), (5.0, 5.0)):
        with pytest.raises(
            ValueError, match=f"lowest is {lowest:g} degrees and highest"
        ):
            AngleOfAttackLimits(lowest * degree, highest * degree, 0.1)
    turned = eqx.tree_at(
        lambda s: s.guidance.angles.lowest,
        gliding_scenario_of(law_of(angles=ANGLES)),
        jnp.asarray(26.0 * degree),
    )
    with pytest.raises(ValueError, match="lowest is 26 degrees and highest 25 degrees"):
        check(turned)
    with pytest.raises(ValueError, match="a correction is of the bank alone"):
        law_of(angles=ANGLES, beside=other_law(), corrects=True)
    with pytest.raises(ValueError, match="turn_rate"):
        check(scenario_of(law_of(turn_rate=-1.0)))


@pytest.mark.parametrize("options", [{}, {"angles": ANGLES}], ids=["bank", "angle"])
@pytest.mark.slow
def test_the_derivatives_by_all_weights_are_those_of_differences(options):
    """Along a random direction, in forward and in reverse mode."""
    law = law_of(network_of(size=10.0, angle=bool(options)), **options)
    vector, put_back = ravel_pytree(law.network.trained)

    @jax.jit
    def missed(vector):
        network = eqx.tree_at(lambda n: n.trained, law.network, put_back(vector))
        scenario = gliding_scenario_of(dataclasses.replace(law, network=network))
        return misses(scenario, fly_compiled(scenario, SOLVER, None)).downrange

    along = np.random.default_rng(2).normal(0.0, 1.0, vector.shape)
    along = jnp.asarray(along / np.linalg.norm(along))
    _, forward = jax.jvp(missed, (vector,), (along,))
    backward = jax.grad(missed)(vector) @ along

    def difference(size):
        return (
            (missed(vector + size * along) - missed(vector - size * along)) / size / 2
        )

    # Richardson: the error of a central difference is of the second order.
    coarse, fine = difference(2e-4), difference(1e-4)
    expected = fine + (fine - coarse) / 3.0
    assert abs(float(expected)) > 1.0
    np.testing.assert_allclose(forward, expected, rtol=1e-6)
    np.testing.assert_allclose(backward, forward, rtol=1e-10)
