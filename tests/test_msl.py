"""Mars Science Laboratory: its numbers, its motion by scipy, laws and dispersions."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from entry_vectors import axes, velocity_of
from first_sets import small_batches
from helpers import ConstantBank, fly_compiled, truths, with_leaf
from scipy.integrate import solve_ivp

from jentry._computed_once import computed_once
from jentry.addresses import leaves_by_address
from jentry.campaign import disperse, draw, monte_carlo
from jentry.campaign.dispersions import addresses_of_dispersion, dispersed_inputs
from jentry.flight import FixedStep, Outcome, misses
from jentry.missions import find_mission
from jentry.missions.msl import laws
from jentry.missions.npcg_toolbox import mars_density_and_temperature
from jentry.units import degree, km


MISSION = find_mission("msl")
TOOLBOX = truths("msl.csv")
PUBLISHED = TOOLBOX["published"]
GRAVITY, DENSITY, SCALE = 4.28283e13, 0.0158, 9354.5
"""Of `mars-drag-tracking`"""


@computed_once
def scenario():
    return MISSION.scenario()


@functools.cache
def nominal(world=None):
    return fly_compiled(MISSION.scenario(world=world), FixedStep(), 1.0)


def spin():
    return np.array([0.0, 0.0, TOOLBOX["mars"]["rotation_rate_rad_s"]])


def start():
    """Place and velocity of the entry, relative to Mars, by vectors."""
    entry = TOOLBOX["entry"]
    frame = axes(entry["longitude_deg"] * degree, entry["latitude_deg"] * degree)
    place = entry["radius_m"] * frame[0]
    inertial = velocity_of(
        frame,
        entry["velocity_m_s"],
        entry["flight_path_angle_deg"] * degree,
        entry["heading_deg"] * degree,
    )
    return place, inertial - np.cross(spin(), place)


def by_vectors(state):
    """Place and velocity of a state, relative to Mars."""
    frame = axes(float(state.longitude), float(state.latitude))
    place = (float(state.altitude) + TOOLBOX["mars"]["radius_m"]) * frame[0]
    angles = float(state.flight_path_angle), float(state.heading)
    return place, velocity_of(frame, float(state.velocity), *angles)


# The numbers of the sources.


def test_the_numbers_are_those_of_the_toolbox():
    flown, mars, capsule = scenario(), TOOLBOX["mars"], TOOLBOX["capsule"]
    vehicle, limits = flown.vehicle, TOOLBOX["limits"]
    end = flown.termination.conditions["velocity"].velocity
    for ours, theirs in (
        (flown.planet.radius, mars["radius_m"]),
        (flown.planet.rotation_rate, mars["rotation_rate_rad_s"]),
        (vehicle.mass, capsule["mass_kg"]),
        (vehicle.reference_area, capsule["reference_area_m2"]),
        (vehicle.aerodynamics.lift_coefficient, capsule["lift_coefficient"]),
        (vehicle.aerodynamics.drag_coefficient, capsule["drag_coefficient"]),
        (end, TOOLBOX["target"]["velocity_m_s"]),
        (flown.target.velocity, TOOLBOX["target"]["velocity_m_s"]),
        (flown.constraints["load_factor"].limit, limits["load_factor"]),
        (
            flown.constraints["dynamic_pressure"].limit,
            1e3 * limits["dynamic_pressure_kPa"],
        ),
        (flown.constraints["heat_rate"].limit, 1e3 * limits["heat_rate_kW_m2"]),
    ):
        assert float(ours) == pytest.approx(theirs, rel=1e-14)


def test_the_entry_is_relative_to_the_rotating_planet():
    place, velocity = start()
    found = by_vectors(scenario().initial_state)
    assert found[0] == pytest.approx(place, abs=1e-6)
    assert found[1] == pytest.approx(velocity, abs=1e-8)
    # Of two sources: the toolbox has the inertial velocity, and the paper the relative one.
    relative = PUBLISHED["relative_velocity_m_s"]
    assert np.linalg.norm(velocity) == pytest.approx(relative, abs=1.0)


def test_the_target_is_its_point():
    flown, printed = scenario(), TOOLBOX["target"]
    radius, (place, velocity) = TOOLBOX["mars"]["radius_m"], start()
    up = place / np.linalg.norm(place)
    level = velocity - (velocity @ up) * up
    ahead = level / np.linalg.norm(level)
    to, *_ = axes(*(printed[f"{n}_deg"] * degree for n in ("longitude", "latitude")))
    along = radius * np.arctan2(to @ ahead, to @ up)
    across = radius * np.arcsin(to @ np.cross(up, ahead))  # positive to the left
    assert float(flown.target.downrange) == pytest.approx(along, rel=1e-12)
    assert float(flown.target.crossrange) == pytest.approx(across, rel=1e-9)


@pytest.mark.parametrize("altitude", [-3.3e3, 6.4e3, 24.7e3, 60.2e3, 124.5e3])
def test_the_fitted_air_is_that_of_the_toolbox(altitude):
    air = TOOLBOX["air"]
    temperature = np.polyval(
        [
            air["temperature_cubic_K_m3"],
            air["temperature_curvature_K_m2"],
            air["temperature_slope_K_m"],
            air["temperature_K"],
        ],
        altitude,
    )
    density = air["pressure_Pa"] / (air["gas_constant_J_kg_K"] * temperature)
    density *= np.exp(-air["inverse_scale_height_1_m"] * altitude)
    assert mars_density_and_temperature(altitude) == pytest.approx(
        (density, temperature)
    )
    planet = MISSION.scenario(world="fitted-air").planet
    found = float(planet.density(jnp.asarray(altitude)))
    assert found == pytest.approx(density, rel=1e-6)


# The motion.

BANK = 50.0 * degree


def by_hand(bank):
    """To the velocity of the parachute at a bank to the right, by vectors."""
    capsule = TOOLBOX["capsule"]
    area = capsule["reference_area_m2"] / capsule["mass_kg"]

    def slope(_, y):
        place, velocity = y[:3], y[3:]
        radius, speed = np.linalg.norm(place), np.linalg.norm(velocity)
        height = radius - TOOLBOX["mars"]["radius_m"]
        pressure = 0.5 * DENSITY * np.exp(-height / SCALE) * speed**2 * area
        along, up = velocity / speed, place / radius
        right = np.cross(along, up)
        right /= np.linalg.norm(right)
        lift = np.cos(bank) * np.cross(right, along) + np.sin(bank) * right
        air = pressure * (
            capsule["lift_coefficient"] * lift - capsule["drag_coefficient"] * along
        )
        turning = -2.0 * np.cross(spin(), velocity)
        turning -= np.cross(spin(), np.cross(spin(), place))
        return np.concatenate([velocity, air - GRAVITY / radius**2 * up + turning])

    def slow(_, y):
        return np.linalg.norm(y[3:]) - TOOLBOX["target"]["velocity_m_s"]

    slow.terminal = True
    solved = solve_ivp(
        slope,
        (0.0, 600.0),
        np.concatenate(start()),
        method="DOP853",
        rtol=1e-11,
        atol=1e-6,
        events=slow,
    )
    assert solved.status == 1
    return solved.t[-1], solved.y[:3, -1], solved.y[3:, -1]


@pytest.mark.parametrize("bank", [BANK, -BANK])
def test_the_motion_is_that_of_newtons_law(bank):
    flown = with_leaf(scenario(), lambda s: s.guidance, ConstantBank(bank))
    flight = fly_compiled(flown)
    time, place, velocity = by_hand(bank)
    assert int(flight.outcome) == Outcome.REACHED
    # Steps of 0.1 s, of fourth order.
    assert float(flight.time) == pytest.approx(time, abs=1e-6)
    found = by_vectors(flight.state)
    assert found[0] == pytest.approx(place, abs=1e-3)
    assert found[1] == pytest.approx(velocity, abs=1e-5)


# The undispersed flight.


def test_the_flight_is_like_the_one_that_was_flown():
    flight = nominal()
    load = float(flight.peaks["load_factor"])
    assert PUBLISHED["load_factor_low"] < load < PUBLISHED["load_factor_high"]
    # An example case "about 240 s", of another target.
    assert float(flight.time) == pytest.approx(
        PUBLISHED["time_to_parachute_s"], rel=0.1
    )
    missed = misses(scenario(), flight)
    # The corridor and the heading alignment leave some hundred metres.
    assert abs(float(missed.downrange)) < 300.0
    assert abs(float(missed.crossrange)) < 500.0
    assert abs(float(missed.altitude)) < 100.0
    assert float(flight.state.velocity) == pytest.approx(406.0)


def test_the_planned_bank_has_the_range_of_the_target():
    """Along the equator, by scipy in the plane, with its rotation."""
    cosine = float(laws.plan().cos_bank)
    assert 45.0 < np.degrees(np.arccos(cosine)) < 60.0
    flown, omega = scenario(), spin()[2]
    entry, radius = flown.initial_state, TOOLBOX["mars"]["radius_m"]
    capsule = TOOLBOX["capsule"]
    loading = capsule["mass_kg"] / capsule["reference_area_m2"]

    def slope(_, y, up):
        h, v, gamma, _ = y
        pressure = 0.5 * DENSITY * np.exp(-h / SCALE) * v * v / loading
        r = radius + h
        g = GRAVITY / r**2 - omega**2 * r
        lift = capsule["lift_coefficient"] * up * pressure / v
        turn = lift + (v / r - g / v) * np.cos(gamma) + 2.0 * omega
        drag = capsule["drag_coefficient"] * pressure
        s, c = np.sin(gamma), np.cos(gamma)
        return [v * s, -drag - g * s, turn, radius / r * v * c]

    names = "altitude", "velocity", "flight_path_angle"
    point = [*(float(getattr(entry, name)) for name in names), 0.0]
    for up, last in ((cosine, laws.ALIGNS_BELOW), (1.0, 406.0)):
        slow = lambda _, y, up, last=last: y[1] - last
        slow.terminal, slow.direction = True, -1
        solved = solve_ivp(
            slope, (0.0, 600.0), point, events=slow, rtol=1e-11, atol=1e-9, args=(up,)
        )
        assert solved.status == 1
        point = solved.y[:, -1]
    # The step of 0.1 s in which the bank jumps.
    assert point[3] == pytest.approx(float(flown.target.downrange), abs=5.0)


def test_the_bank_has_the_three_phases():
    flight = nominal()
    history = flight.history
    count = int(np.isfinite(history.time).sum())
    sine, cosine = (
        np.asarray(getattr(history.controls, f"{name}_bank"))[:count]
        for name in ("sin", "cos")
    )
    velocity = np.asarray(history.states.velocity)[:count]
    altitude = np.asarray(history.states.altitude)[:count]
    capsule = TOOLBOX["capsule"]
    drag = 0.5 * DENSITY * np.exp(-altitude / SCALE) * velocity**2
    drag *= capsule["drag_coefficient"] * capsule["reference_area_m2"]
    drag /= capsule["mass_kg"]
    # Commands are held for a second.
    before = (drag < 0.9 * 0.2 * 9.80665) & (velocity > 5000.0)
    assert before.sum() > 30
    assert cosine[before] == pytest.approx(float(laws.plan().cos_bank))
    assert (sine[before] > 0.0).all()
    reversals = np.diff(np.sign(sine[velocity > 1100.0])) != 0.0
    assert reversals.sum() == 3
    aligned = velocity < 1100.0 - 20.0
    assert (cosine[aligned] > np.cos(30.0 * degree) - 1e-9).all()
    assert np.abs(cosine[~aligned & ~before] - np.cos(30.0 * degree)).max() > 0.1


@pytest.mark.filterwarnings("ignore:.*decisions without prediction")
def test_the_predictor_corrector_comes_nearer():
    comparison = MISSION.scenario("predictor-corrector")
    missed = misses(comparison, fly_compiled(comparison))
    # A reversal late in the flight.
    assert np.hypot(float(missed.downrange), float(missed.crossrange)) < 100.0


# The worlds.


def test_wind_and_waves_have_no_size_until_dispersed():
    calm, world = nominal().state, nominal("wind-and-waves").state
    for name in ("altitude", "longitude", "latitude", "velocity"):
        expected = float(getattr(calm, name))
        assert float(getattr(world, name)) == pytest.approx(expected, rel=1e-11)


def test_the_waves_stay_in_the_fitted_air():
    together = [
        MISSION.scenario(world=worlds).planet.atmosphere
        for worlds in (
            ("fitted-air", "wind-and-waves"),
            ("wind-and-waves", "fitted-air"),
        )
    ]
    assert jax.tree.structure(together[0]) == jax.tree.structure(together[1])
    assert len(together[0].waves) == 2


@pytest.mark.parametrize(
    "worlds", [("range-trigger", "inertial"), ("inertial", "range-trigger")]
)
def test_the_range_trigger_is_judged_by_what_the_vehicle_believes(worlds):
    conditions = MISSION.scenario(world=worlds).termination.conditions
    decided = {name for name, each in conditions.items() if each.by == "navigation"}
    assert decided == {"velocity", "range"}


def test_the_range_trigger_opens_at_its_range():
    flight = nominal("range-trigger")
    to, *_ = axes(
        *(TOOLBOX["target"][f"{n}_deg"] * degree for n in ("longitude", "latitude"))
    )
    here, _ = by_vectors(flight.state)
    sine = np.linalg.norm(np.cross(here / np.linalg.norm(here), to))
    away = TOOLBOX["mars"]["radius_m"] * np.arcsin(sine)
    assert away == pytest.approx(2.0 * km, abs=1e-3)
    assert float(flight.state.velocity) > 406.0


# The dispersions.

SIZES = {
    "initial_state.flight_path_angle": PUBLISHED["flight_path_angle_deg"] * degree,
    "initial_state.velocity": 2.0,
    "initial_state.longitude": 0.1 * degree,
    "initial_state.latitude": 0.1 * degree,
    "initial_state.heading": 0.1 * degree,
    "planet.density_scale": 0.3,
    "vehicle.lift_scale": 0.1,
    "vehicle.drag_scale": 0.1,
    "vehicle.mass": 0.01 * TOOLBOX["capsule"]["mass_kg"],
}
"""Three standard deviations"""


def test_dispersions_move_their_leaves_by_their_sizes(key):
    flown, table = scenario(), MISSION.dispersion_table()
    runs = jax.vmap(lambda i: disperse(flown, table, draw(table, key, i)))(
        jnp.arange(4000)
    )
    assert set(runs) == set(SIZES)
    leaves = leaves_by_address(flown)
    for address, size in SIZES.items():
        drawn = np.asarray(runs[address])
        # The standard errors of 4000 draws are 1.1 % and 1.6 %.
        assert 3.0 * np.std(drawn) == pytest.approx(size, rel=0.05), address
        off = np.mean(drawn) - float(leaves[address])
        assert abs(3.0 * off) < 0.1 * size, address


def test_the_knowledge_is_that_which_was_required():
    table = MISSION.dispersion_table("knowledge")
    for words, size in (
        ("position", PUBLISHED["position_knowledge_km"] * km),
        ("velocity", PUBLISHED["velocity_knowledge_m_s"]),
    ):
        for axis in ("east", "north", "up"):
            _, deviation = table[f"{words} {axis}"].distribution.moments()
            assert 3.0 * float(deviation) == pytest.approx(size)


PAIRS = {
    "longitude": "east",
    "latitude": "north",
    "flight_path_angle": "velocity_up",
    "heading": "velocity_north",
}
"""Knowledge error of the same kind, by the component of the state that is delivered"""


def metres_a_radian():
    """How far each delivery error moves the vehicle, m or m/s along its axis."""
    state, step, found = vars(scenario().initial_state), 1e-6, {}

    def placed(altitude, longitude, latitude, velocity, flight_path_angle, heading):
        frame = axes(longitude, latitude)
        there = (3397.0 * km + altitude) * frame[0]
        return there, velocity_of(frame, velocity, flight_path_angle, heading)

    state = {name: float(x) for name, x in state.items()}
    names, frame = ("up", "east", "north"), axes(state["longitude"], state["latitude"])
    for component, knowledge in PAIRS.items():
        which = knowledge.startswith("velocity")
        axis = frame[names.index(knowledge.removeprefix("velocity_"))]
        sides = (
            placed(**state | {component: state[component] + h}) for h in (step, -step)
        )
        ahead, behind = (side[which] @ axis for side in sides)
        found[component] = (ahead - behind) / (2.0 * step)
    return found


@pytest.mark.parametrize("name", ["estimated-knowledge", "knowledge"])
def test_an_estimate_is_uncorrelated_with_its_error(name, key):
    """What the vehicle believes then varies by the difference of the variances of delivery
    and knowledge; by their sum if its knowledge comes from no estimate."""
    flown, runs = MISSION.scenario(world="inertial"), 20_000
    wanted = {f"initial_state.{c}" for c in PAIRS}
    wanted |= {f"navigation.knowledge.{k}" for k in PAIRS.values()}
    table = {
        name: each
        for name, each in MISSION.dispersion_table(f"everything-and-{name}").items()
        if wanted.issuperset(addresses_of_dispersion(flown, name, each))
    }
    inputs = dispersed_inputs(flown, table, key, jnp.arange(runs))
    drawn = {address: np.asarray(x) for address, x in inputs.items()}
    error = 5.0 / np.sqrt(runs)  # five standard errors, of a correlation too
    required = {"": PUBLISHED["position_knowledge_km"] * km, "velocity_": 2.0}
    for component, per_unit in metres_a_radian().items():
        address, knowledge = f"initial_state.{component}", PAIRS[component]
        off = per_unit * (
            drawn[address] - float(getattr(flown.initial_state, component))
        )
        unknown = drawn[f"navigation.knowledge.{knowledge}"]
        start = "velocity_" if knowledge.startswith("velocity_") else ""
        sizes = abs(per_unit) * SIZES[address] / 3.0, required[start] / 3.0
        assert np.std(off) == pytest.approx(sizes[0], rel=error), component
        assert np.std(unknown) == pytest.approx(sizes[1], rel=error), component
        estimated = name == "estimated-knowledge"
        expected = -sizes[1] / sizes[0] if estimated else 0.0
        found = np.corrcoef(off, unknown)[0, 1]
        if estimated:
            of_unknown = next(
                each
                for name, each in table.items()
                if addresses_of_dispersion(flown, name, each)
                == [f"navigation.knowledge.{knowledge}"]
            )
            expected *= np.sign(per_unit)
            stated = float(of_unknown.distribution.weights[0])
            assert stated == pytest.approx(expected, rel=1e-6), component
            expected *= np.sign(per_unit)
        assert found == pytest.approx(expected, abs=error), component
        believed, sign = off + unknown, -1.0 if estimated else 1.0
        spread = np.sqrt(sizes[0] ** 2 + sign * sizes[1] ** 2)
        assert np.std(believed) == pytest.approx(spread, rel=error), component


def test_few_flights_with_everything_reach_the_target(key):
    with small_batches():
        campaign = monte_carlo(scenario(), MISSION.dispersion_table(), key, 8)
    assert (np.asarray(campaign.flights.outcome) == Outcome.REACHED).all()
    errors = campaign.misses.downrange, campaign.misses.crossrange
    assert np.hypot(*map(np.asarray, errors)).max() < 3.0 * km
