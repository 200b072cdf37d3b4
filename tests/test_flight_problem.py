"""The best flight of a vehicle and the landing footprint, on a cheap entry."""

import dataclasses
import functools
import math

import cheap
import jax
import numpy as np
import pytest
from helpers import fly_compiled, mars_scenario
from scipy.spatial import ConvexHull

from jentry._computed_once import computed_once
from jentry.addresses import replace_leaves
from jentry.flight import FixedStep, Scenario, Termination, VelocityBelow, fly
from jentry.motion.constraints import LoadFactor
from jentry.motion.quantities import energy, ground_track
from jentry.planning.control_splines import control_coefficients
from jentry.planning.flight_constraints import Constraint
from jentry.planning.flight_problem import (
    AtEnd,
    FlightProblem,
    FreeControl,
    Peak,
    best_flight,
)
from jentry.planning.landing_footprint import Aim, footprint
from jentry.plots.footprint import draw_footprint
from jentry.plots.one_flight import draw_flight
from jentry.units import degree, km


SOLVER = FixedStep(2.0)
FREE = FreeControl(50 * degree, -90 * degree, 90 * degree)
PROBLEM = FlightProblem(AtEnd("downrange"), FREE, nodes=5, history=2.0)


@computed_once
def entry() -> Scenario:
    """That ends at a velocity, wherever that is."""
    termination = Termination({"velocity": VelocityBelow(velocity=503.0)}, 1500.0)
    return dataclasses.replace(cheap.at_trim(), termination=termination)


def limited(limit):
    constraints = {**entry().constraints, "load_factor": LoadFactor(limit)}
    return dataclasses.replace(entry(), constraints=constraints)


@functools.cache
def best(objective, largest, limit=None):
    scenario = entry() if limit is None else limited(limit)
    problem = dataclasses.replace(PROBLEM, objective=objective, largest=largest)
    return best_flight(scenario, problem, SOLVER)


def test_quantities_at_the_end():
    scenario = cheap.at_trim()
    flight = fly_compiled(scenario, cheap.SOLVER)
    along, across = ground_track(scenario.planet, scenario.initial_state, flight.state)
    expected = {
        "time": flight.time,
        "energy": energy(scenario.planet, flight.state),
        "downrange": along,
        "crossrange": across,
        "latitude": flight.state.latitude,
        "velocity": flight.state.velocity,
    }
    for name, value in expected.items():
        assert float(AtEnd(name)(scenario, flight)) == float(value)
    assert Peak("drag")(scenario, flight) == flight.peaks.drag
    assert (AtEnd("latitude").unit, AtEnd("time").unit) == ("rad", "s")


def test_the_downrange_goes_on_past_half_of_the_way_around():
    scenario = cheap.at_trim()
    flight = fly_compiled(scenario, cheap.SOLVER)
    around = 2.0 * math.pi * float(scenario.planet.radius)
    for share in (0.2, 0.45, 0.55, 0.7):
        there = dataclasses.replace(
            flight.state,
            latitude=0.0 * flight.state.latitude,
            longitude=0.0 * flight.state.longitude + 2.0 * math.pi * share,
        )
        start = dataclasses.replace(
            scenario.initial_state,
            latitude=0.0 * flight.state.latitude,
            longitude=0.0 * flight.state.longitude,
            heading=0.0 * flight.state.heading + 0.5 * math.pi,
        )
        moved = dataclasses.replace(scenario, initial_state=start)
        ended = dataclasses.replace(flight, state=there)
        assert float(AtEnd("downrange")(moved, ended)) == pytest.approx(share * around)


@pytest.mark.slow
def test_large_and_small():
    """The farthest flight is full lift up here, and no bank is better than the bounds."""
    far, near = best(AtEnd("downrange"), True), best(AtEnd("downrange"), False)
    begun = fly_compiled(entry(), SOLVER)
    start = float(AtEnd("downrange")(entry(), begun))
    ends = [float(AtEnd("downrange")(b.scenario, b.flight)) for b in (near, far)]
    assert ends[0] < start < ends[1]
    assert far.objective == pytest.approx(-ends[1], rel=1e-12)
    assert near.objective == pytest.approx(ends[0], rel=1e-12)
    for each in (far, near):
        for values in each.values.values():
            assert np.all(np.abs(values) <= FREE.most * (1.0 + 1e-12))


def tight():
    """A load factor that the shortest flight has to keep."""
    return 0.8 * float(best(AtEnd("downrange"), False).flight.peaks.load_factor)


@pytest.mark.slow
def test_limits_are_kept_unless_it_is_asked_not_to():
    far = best(AtEnd("downrange"), False)
    limit = tight()
    kept = best(AtEnd("downrange"), False, limit)
    assert np.nanmax(kept.constraints["load_factor"]) <= limit * (1.0 + 1e-9)
    assert kept.objective > far.objective
    problem = dataclasses.replace(PROBLEM, largest=False, keeps_limits=False)
    free = best_flight(kept.scenario, problem, SOLVER)
    assert free.constraints == {}
    assert free.objective == pytest.approx(far.objective, rel=1e-6)


@pytest.mark.slow
def test_begins_where_it_is_told():
    far = best(AtEnd("downrange"), True)
    again = best_flight(entry(), PROBLEM, SOLVER, begin=far.scenario.guidance)
    assert again.at_start == pytest.approx(far.objective, rel=1e-12)
    assert again.iterations < far.iterations


@pytest.mark.slow
def test_large_and_small_are_one_program():
    traced = []

    def late(scenario, flight):
        traced.append(flight)
        return flight.time

    most = best(late, True)
    assert len(traced) == 1
    assert -most.objective > best(late, False).objective
    assert len(traced) == 1


@functools.cache
def outline():
    done, traced = [], []
    asked = Aim.__call__

    def noted(aim, scenario, flight):
        traced.append(aim)
        return asked(aim, scenario, flight)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Aim, "__call__", noted)
        found = footprint(entry(), PROBLEM, 6, SOLVER, done.append)
    return found, done, traced


@pytest.mark.slow
def test_footprint():
    """Symmetric, since the planet and the start are; its extremes are the first four."""
    found, done, traced = outline()
    assert done == list(range(1, 11)) and found.failed == ()
    assert len(traced) == 1  # of ten flights
    assert len(found.flights) == 10
    far = best(AtEnd("downrange"), True)
    assert np.max(found.downrange) == pytest.approx(-far.objective, rel=1e-6)
    left, right = np.max(found.crossrange), np.min(found.crossrange)
    assert left == pytest.approx(-right, rel=1e-6)
    for number, each in enumerate(found.flights):
        along, across = (
            AtEnd(name)(each.scenario, each.flight)
            for name in ("downrange", "crossrange")
        )
        assert float(along) == found.downrange[number]
        assert float(across) == found.crossrange[number]
    # Around it once, to the left.
    middle = (
        0.5 * (np.max(found.downrange) + np.min(found.downrange)),
        0.5 * (left + right),
    )
    angles = np.arctan2(found.crossrange - middle[1], found.downrange - middle[0])
    assert np.sum(np.diff(np.append(angles, angles[0])) < 0.0) == 1


@pytest.mark.slow
def test_nobody_flies_beyond_the_footprint():
    """Random controls within the bounds end within the convex hull of the points."""
    found, *_ = outline()
    points = np.stack([found.downrange, found.crossrange], axis=1) / km
    hull = ConvexHull(points)
    start = found.flights[0].scenario
    (coefficients,) = control_coefficients(start)
    rng = np.random.default_rng(5)
    drawn = rng.uniform(FREE.least, FREE.most, (200, *coefficients.shape))

    def place(values):
        scenario = replace_leaves(start, {"guidance.bank.coefficients": values})
        flight = fly(scenario, SOLVER)
        return AtEnd("downrange")(scenario, flight), AtEnd("crossrange")(
            scenario, flight
        )

    ends = np.stack(jax.jit(jax.vmap(place))(drawn), axis=1) / km
    beyond = ends @ hull.equations[:, :2].T + hull.equations[:, 2]
    # The outline has ten corners: what is cut off between them is below a tenth of it.
    width = np.max(found.crossrange) / km
    assert np.max(beyond) < 0.1 * width
    assert np.all(ends <= np.max(points, axis=0)) and np.all(
        ends >= np.min(points, axis=0)
    )
    assert np.max(ends[:, 1]) > 0.5 * width and np.min(ends[:, 1]) < -0.5 * width


@pytest.mark.slow
def test_figures():
    found, *_ = outline()
    (axes,) = draw_footprint(found, "title").axes
    assert axes.get_title(loc="left") == "10 flights"
    found = best(AtEnd("downrange"), True)
    drawn = draw_flight(found.scenario, found.flight, "title")
    labels = [axes.get_ylabel() for axes in drawn.axes]
    assert labels == ["Altitude (km)", "Controls (deg)", "Latitude (deg)"]
    found = best(AtEnd("downrange"), False, tight())
    limited = draw_flight(found.scenario, found.flight)
    assert "Share of the limit" in [axes.get_ylabel() for axes in limited.axes]


REFUSED = {
    "quantity": (lambda: AtEnd("mass"), "no quantity 'mass' at the end"),
    "control": (lambda: FreeControl(2.0, 0.0, 1.0), "the start must lie between"),
    "empty": (lambda: FreeControl(0.0, 0.0, 0.0), "the start must lie between"),
    "plane": (lambda: footprint(mars_scenario(), PROBLEM), "has no crossrange"),
    "directions": (
        lambda: footprint(entry(), PROBLEM, -1),
        "directions is -1",
    ),
    "name": (
        lambda: best_flight(
            limited(10.0),
            dataclasses.replace(
                PROBLEM,
                constraints={"load_factor": Constraint(AtEnd("time"), at_most=1.0)},
            ),
        ),
        "the name of a path constraint with a limit",
    ),
}


@pytest.mark.parametrize(("call", "said"), REFUSED.values(), ids=REFUSED)
def test_refused(call, said):
    with pytest.raises(ValueError) as refused:
        call()
    assert said in str(refused.value)
