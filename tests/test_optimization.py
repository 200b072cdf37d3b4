"""Optimising through a flight: against closed forms, and against differences of optima."""

import dataclasses
import functools

import cheap
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ConstantBank, mars_planet, mars_vehicle, with_leaf

from jentry._computed_once import computed_once
from jentry.addresses import replace_leaves
from jentry.flight import (
    AltitudeBelow,
    Crossing,
    FixedStep,
    Outcome,
    Scenario,
    Target,
    Termination,
    fly,
)
from jentry.motion.constraints import Drag, LoadFactor
from jentry.motion.quantities import ground_track
from jentry.motion.state import EntryState
from jentry.parameters.maps import Bounds, Scale
from jentry.planning.flight_constraints import AlongPath, Constraint, within_limits
from jentry.planning.optimization import optimize
from jentry.units import degree, km


ALTITUDE = 150 * km
SPEED = 1500.0


@computed_once
def thrown() -> Scenario:
    """A throw in hardly any air, from and to one altitude: a Kepler arc."""
    planet = with_leaf(mars_planet(), lambda p: p.density_scale, 1e-30)
    start = EntryState(ALTITUDE, 0.0, 0.0, SPEED, 20 * degree, 90 * degree)
    ends = {"back": Crossing(AltitudeBelow(ALTITUDE - 1.0))}
    return Scenario(
        planet,
        mars_vehicle(),
        start,
        ConstantBank(30 * degree),
        Termination(ends, 3000.0),
        Target(ALTITUDE, SPEED, 0.0),
        constraints={"drag": Drag()},
        step=5.0,
    )


def elevation(scenario):
    return scenario.initial_state.flight_path_angle


def way(scenario, flight):
    return ground_track(scenario.planet, scenario.initial_state, flight.state)[0]


def shorter(scenario, flight):
    return -way(scenario, flight) / km


def top(scenario, flight):
    """Altitude of the highest point of the arc, from energy and angular momentum."""
    planet, state = scenario.planet, scenario.initial_state
    radius = planet.radius + state.altitude
    mu = planet.gravity.gravitational_parameter
    along = radius * state.velocity * jnp.cos(state.flight_path_angle)
    size = mu / (2.0 * mu / radius - state.velocity**2)
    return size * (1.0 + jnp.sqrt(1.0 - along**2 / (mu * size))) - planet.radius


def by_hand(angle):
    """Range over the surface of an arc back to its own altitude, m; Q of the textbooks."""
    planet = thrown().planet
    radius = float(planet.radius) + ALTITUDE
    q = SPEED**2 * radius / float(planet.gravity.gravitational_parameter)
    half = np.arctan2(q * np.sin(angle) * np.cos(angle), 1.0 - q * np.cos(angle) ** 2)
    return 2.0 * half * float(planet.radius), q


@functools.cache
def farthest():
    return optimize(thrown(), elevation, shorter)


def test_farthest_throw():
    """sin(half the range) = Q / (2 - Q), thrown at 45 degrees less a quarter of it."""
    best = farthest()
    _, q = by_hand(0.0)
    half = np.arcsin(q / (2.0 - q))
    angle = 45 * degree - 0.5 * half
    found = float(best.scenario.initial_state.flight_path_angle)
    # A maximum: its place is known to the root of the tolerance.
    assert found == pytest.approx(angle, abs=1e-4)
    # The metre by which the end is lower is gone down at some 40 degrees.
    farthest_range = 2.0 * half * float(thrown().planet.radius)
    assert -best.objective == pytest.approx(farthest_range / km, abs=2e-3)
    assert best.slope_left < 1e-3
    assert best.values == {"initial_state.flight_path_angle": found}
    assert best.multipliers == {} and best.active == {} and best.remarks == ()


def lob(limit):
    constraint = Constraint(top, at_most=limit)
    return optimize(thrown(), elevation, shorter, {"top": constraint})


def test_a_limit_and_its_price():
    """The arc may not go as high as the farthest: as high as it may, at a price."""
    free = float(top(farthest().scenario, farthest().flight))
    limit = ALTITUDE + 0.7 * (free - ALTITUDE)
    best = lob(limit)
    assert best.constraints["top"] == pytest.approx(limit, rel=1e-9)
    assert best.active == {"top": [0]}
    range_, _ = by_hand(float(best.scenario.initial_state.flight_path_angle))
    assert -best.objective == pytest.approx(range_ / km, abs=2e-3)
    step = 1 * km
    slope = (lob(limit + step).objective - lob(limit - step).objective) / (2 * step)
    assert best.multipliers["top"] == pytest.approx(slope, rel=1e-4)
    above = lob(free + 50 * km)
    assert above.multipliers["top"] == 0.0
    assert above.objective == pytest.approx(farthest().objective, rel=1e-9)


def test_a_bound_and_its_price():
    address = "initial_state.flight_path_angle"

    def at(most):
        ranges = {address: Bounds(10 * degree, most)}
        return optimize(thrown(), elevation, shorter, ranges=ranges)

    best, step = at(30 * degree), 0.1 * degree
    assert best.values[address] == pytest.approx(30 * degree, rel=1e-12)
    assert best.active == {address: [0]}
    slope = -(by_hand(30 * degree + step)[0] - by_hand(30 * degree - step)[0]) / km
    assert best.bound_multipliers[address] == pytest.approx(
        slope / (2 * step), rel=1e-4
    )


@pytest.mark.slow
def test_every_number_goes_to_its_own_leaf():
    """Leaves whose addresses sort otherwise than the lens has them, of several sizes."""
    start = {"z": jnp.array([1.0, 2.0]), "a": jnp.array(3.0), "m": jnp.ones((2, 1))}

    def build(x):
        total = jnp.sum(x["z"]) + x["a"] + jnp.sum(x["m"])
        state = dataclasses.replace(
            thrown().initial_state, flight_path_angle=total * degree
        )
        return dataclasses.replace(thrown(), initial_state=state)

    def read(scenario, flight):
        return scenario.initial_state.flight_path_angle

    lens = lambda x: (x["z"], x["m"], x["a"])
    # Each has another price: only the dearest moves, to the bound that it has.
    ranges = {"z": Bounds(0.0, 8.0), "a": Bounds(0.0, 4.0), "m": Bounds(0.5, 2.0)}
    best = optimize(
        start,
        lens,
        lambda s, f: -way(s, f) / km,
        {"angle": Constraint(read, at_most=21 * degree)},
        build=build,
        ranges=ranges,
    )
    values = best.values
    assert values["z"].shape == (2,) and values["m"].shape == (2, 1)
    flown = fly(build(best.parameters))
    assert -best.objective == pytest.approx(float(way(thrown(), flown)) / km, rel=1e-12)
    total = np.sum(values["z"]) + values["a"] + np.sum(values["m"])
    assert total == pytest.approx(21.0, rel=1e-9)
    assert 0.0 <= values["a"] <= 4.0 and np.all(values["m"] >= 0.5)


def limited(limit):
    constraints = {"drag": Drag(limit), "load_factor": LoadFactor()}
    return dataclasses.replace(cheap.scenario(), constraints=constraints)


def bank(scenario):
    return scenario.guidance.bank_angle


def low(scenario, flight):
    return flight.state.altitude / km


def peak_drag(scenario):
    return float(fly(scenario, cheap.SOLVER).peaks.drag)


@pytest.mark.slow
def test_limits_along_the_path():
    """As low an end as the drag allows: the peak at an entry is at the limit."""
    start = limited(None)
    scenario = limited(0.99 * peak_drag(start))
    kept = within_limits(scenario)
    assert list(kept) == ["drag"] and kept["drag"].quantity == AlongPath("drag")
    # Of an entry after the end the root has no derivative, which is nobody's concern.
    root = lambda s, f: jnp.sqrt(f.history.constraints["drag"])
    best = optimize(
        scenario,
        bank,
        low,
        {**kept, "root": Constraint(root, at_most=1e3)},
        ranges={"guidance.bank_angle": Bounds(0.0, 80 * degree)},
        solver=cheap.SOLVER,
        history=1.0,
    )
    limit = float(scenario.constraints["drag"].limit)
    values = best.constraints["drag"]
    flown = np.isfinite(np.asarray(best.flight.history.time))
    # What is after the end is no value of the flight, and binds nothing.
    assert np.array_equal(np.isfinite(values), flown) and not np.all(flown)
    assert np.nanmax(values) == pytest.approx(limit, rel=1e-7)
    assert best.active == {"drag": [int(np.nanargmax(values))]}
    # Every second is looked at, and each step is a second.
    assert float(best.flight.peaks.drag) == pytest.approx(limit, rel=1e-7)


@pytest.mark.slow
def test_a_limit_that_is_exceeded_between_the_entries():
    scenario = limited(0.99 * peak_drag(limited(None)))
    with pytest.warns(match="drag peaks at .* between the entries of the history"):
        best = optimize(
            scenario,
            bank,
            low,
            within_limits(scenario),
            ranges={"guidance.bank_angle": Bounds(0.0, 80 * degree)},
            solver=cheap.SOLVER,
            history=25.0,
        )
    peak = float(best.flight.peaks.drag)
    assert peak > 1.001 * float(scenario.constraints["drag"].limit)
    assert any(f"drag peaks at {peak:.6g}" in said for said in best.remarks)


REFUSED = {
    "nothing to keep": (lambda: Constraint(low), "a constraint has no value"),
    "two ways": (lambda: Constraint(low, equals=1.0, at_most=2.0), "must equal 1.0"),
    "turned round": (lambda: Constraint(low, at_least=2.0, at_most=1.0), "the smaller"),
    "not finite": (lambda: Constraint(low, at_most=np.nan), "at_most is nan"),
    "zero": (lambda: Constraint(low, equals=0.0), "has the value 0"),
    "scale": (lambda: Constraint(low, equals=1.0, scale=-1.0), "scale is -1.0"),
    "no limit": (lambda: within_limits(cheap.scenario()), "has a limit"),
    "no history": (
        lambda: optimize(limited(30.0), bank, low, within_limits(limited(30.0))),
        "give an interval, such as history=5.0",
    ),
    "several numbers": (
        lambda: optimize(thrown(), elevation, lambda s, f: jnp.ones(2)),
        "the objective has shape (2,)",
    ),
    "beyond its bounds": (
        lambda: optimize(
            thrown(),
            elevation,
            shorter,
            ranges={"initial_state.flight_path_angle": Bounds(0.0, 0.1)},
        ),
        "on both sides of its value",
    ),
    "unknown range": (
        lambda: optimize(thrown(), elevation, shorter, ranges={"mass": Scale(1.0)}),
        "mass has a Scale and is not tuned",
    ),
    "no leaf": (lambda: optimize(thrown(), lambda s: s.gone, shorter), "the lens"),
    "infinite objective": (
        lambda: optimize(thrown(), elevation, lambda s, f: jnp.log(-f.time)),
        "the objective, or its derivative, is not finite at the start",
    ),
    "infinite constraint": (
        lambda: optimize(
            thrown(),
            elevation,
            shorter,
            {"odd": Constraint(lambda s, f: jnp.log(-f.time), at_most=1.0)},
        ),
        "the constraint odd, or its derivative, is not finite at the start",
    ),
    "still": (
        lambda: optimize(
            thrown(),
            elevation,
            shorter,
            {"end": Constraint(lambda s, f: f.state.altitude, equals=ALTITUDE)},
        ),
        "end must equal a value, but does not depend",
    ),
    "not to be met": (
        lambda: optimize(
            thrown(),
            elevation,
            shorter,
            {"top": Constraint(top, at_most=ALTITUDE - 20 * km)},
        ),
        "not met there: top by ",
    ),
}


@pytest.mark.parametrize(("call", "said"), REFUSED.values(), ids=REFUSED)
def test_refused(call, said):
    with pytest.raises(ValueError) as refused:
        call()
    assert said in str(refused.value)


def test_a_start_without_an_end_is_refused():
    down = replace_leaves(thrown(), {"initial_state.flight_path_angle": -10 * degree})
    ends = {"back": AltitudeBelow(ALTITUDE + 1.0)}
    down = dataclasses.replace(down, termination=Termination(ends, 3000.0))
    with pytest.raises(ValueError, match="began where an end condition was met"):
        optimize(down, elevation, shorter)


def test_an_end_that_is_none_is_said():
    """The longest flight runs into the time limit, which is no end to plan for."""
    short = Termination({"back": Crossing(AltitudeBelow(ALTITUDE - 1.0))}, 200.0)
    scenario = dataclasses.replace(thrown(), termination=short)
    with pytest.warns(match="ends by time_limit, was still flying"):
        best = optimize(
            scenario,
            elevation,
            lambda s, f: -f.state.altitude / km,
            ranges={
                "initial_state.flight_path_angle": Bounds(15 * degree, 40 * degree)
            },
        )
    assert int(best.flight.outcome) == Outcome.TIMED_OUT
    assert len(best.remarks) >= 1


def test_the_solver_arrives():
    best = optimize(thrown(), elevation, shorter, solver=FixedStep(20.0), history=40.0)
    assert best.flight.history.time.shape == (75,)
    assert best.objective != farthest().objective
    assert best.objective == pytest.approx(farthest().objective, rel=1e-4)
