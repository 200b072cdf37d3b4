"""Figures of the papers that are of single flights or cases, beside those of jentry.

    python benchmarks/published.py                 # all tables, about ten minutes
    python benchmarks/published.py "x-33 cases"    # one of them
    python benchmarks/published.py --save          # and write them to published.csv

The pages of the missions take their tables from `published.csv`. The tests fly the tables
again and compare.
"""

import argparse
import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from records import FOLDER, PUBLISHED, Cell, save
from scipy.optimize import bisect

import jentry
from jentry.cli.overrides import apply_values, in_si, read_overrides
from jentry.flight import (
    AltitudeAbove,
    AltitudeBelow,
    Outcome,
    Termination,
    fly,
    misses,
)
from jentry.guidance import BankProfile
from jentry.missions import find_mission
from jentry.missions.x_33.cases import TABLE_1, TABLE_2
from jentry.motion import orbit_of
from jentry.onboard import PolynomialProfile
from jentry.planning.aerocapture_corridor import STEEPEST, capture_corridor
from jentry.planning.bezier_curve import k2_polynomial, velocity_map
from jentry.planning.flight_problem import best_flight
from jentry.units import degree, km, nautical_mile
from jentry.world import ZonalGravity


def mars_nominal() -> list[Cell]:
    """Nominal downrange errors, m; section 4 of the paper has those of two laws."""
    mission, cells = find_mission("mars-drag-tracking"), []
    paper = {"state-feedback": 4.75, "observer-feedback": 72.2, "time-index": None}
    for law, published in paper.items():
        scenario = mission.scenario(law)
        error = misses(scenario, eqx.filter_jit(fly)(scenario)).downrange
        row = f"`{law}`"
        cells.append(Cell(row, "downrange error, m", float(error), 2, published))
    return cells


def _errors_of_cases(mission: jentry.Mission, law: str, cases: list[str | None]):
    """Misses of the flights of a law from the initial states of cases, one batch."""
    nominal = mission.scenario(law)
    starts = [
        mission.scenario(law, case=case).initial_state
        if case
        else nominal.initial_state
        for case in cases
    ]
    states = jax.tree.map(lambda *x: jnp.stack(x), *starts)

    def missed(state):
        scenario = eqx.tree_at(lambda s: s.initial_state, nominal, state)
        return misses(scenario, fly(scenario))

    return jax.tree.map(np.asarray, eqx.filter_jit(jax.vmap(missed))(states))


def sx_2_cases() -> list[Cell]:
    """Largest errors of the twelve cases with one initial error each, n mile."""
    mission, cells = find_mission("sx-2"), []
    names = [name for name in mission.cases if name != "figures"]
    for law in ("full", "small-angle"):
        found = _errors_of_cases(mission, law, [*names, "figures", None])
        down, cross = (
            np.abs(x) / nautical_mile for x in (found.downrange, found.crossrange)
        )
        n, row = len(names), f"`{law}`"
        for column, value, decimals in (
            (f"largest downrange error of the {n}", np.max(down[:n]), 2),
            (f"largest crossrange error of the {n}", np.max(cross[:n]), 2),
            ("case `figures`: downrange", down[n], 2),
            ("case `figures`: crossrange", cross[n], 2),
            ("nominal: downrange", down[n + 1], 5),
            ("nominal: crossrange", cross[n + 1], 5),
        ):
            published = 1.0 if column.startswith("largest") else None
            cells.append(Cell(row, column, float(value), decimals, published))
    return cells


def x_33_cases() -> list[Cell]:
    """Errors at the end from the four initial errors of Tables 1 and 2."""
    mission = find_mission("x-33")
    names = list(mission.cases)
    closed, free, ranged = (
        _errors_of_cases(mission, law, [*names])
        for law in ("tracking", "open-loop", "with-range")
    )
    cells = []
    for n, name in enumerate(names):
        of, first = TABLE_2[n], TABLE_1[n]
        cells += [
            Cell(name, "altitude, m", closed.altitude[n], 1, of.altitude),
            Cell(name, "velocity, m/s", closed.velocity[n], 2, of.velocity),
            Cell(
                name,
                "path angle, deg",
                closed.flight_path_angle[n] / degree,
                3,
                of.flight_path_angle / degree,
            ),
            Cell(name, "range, km", closed.downrange[n] / km, 0, of.downrange / km),
            Cell(
                name,
                "range without feedback, km",
                free.downrange[n] / km,
                0,
                first.downrange / km,
            ),
            Cell(name, "range as a fourth state, km", ranged.downrange[n] / km, 3),
        ]
    return [cell._replace(value=float(cell.value)) for cell in cells]


RUNS = 500
SEEDS = 1, 2, 3

DRAG_ERRORS = (
    ("modulation", "table-1"),
    ("shuttle", "table-1-estimated-angle"),
    ("shuttle-quarter", "table-1-estimated-angle"),
    ("modulation-fast-observer world attitude-8", "table-1"),
    ("lag-inverted world attitude-3", "table-1"),
    ("lag-inverted world attitude-3 world noise", "table-1-noise"),
    ("lag-inverted-fast world attitude-3 world noise", "table-1-noise"),
)
"""Choices of the mission `rlv` and their dispersions. The law `lag-inverted` has the gains
of `tuned-rlv.toml`. Seed 0, that of the tuning, is left out"""


def rlv_drag_error() -> list[Cell]:
    """Largest error of the drag below 7000 m/s, 1e-3 g: nominal, and of three sets."""
    mission, cells = find_mission("rlv"), []
    published = {"modulation": 2.0, "shuttle": 20.0}
    for choice, dispersions in DRAG_ERRORS:
        scenario = mission.scenario_of(choice)
        if choice.startswith("lag-inverted world"):
            overrides = in_si(read_overrides(FOLDER / "tuned-rlv.toml"), scenario)
            scenario = apply_values(scenario, overrides.values)
        table = mission.dispersion_table(dispersions)
        nominal = eqx.filter_jit(fly)(scenario).peaks["drag_deviation"]
        sets = []
        for seed in SEEDS:
            campaign = jentry.monte_carlo(scenario, table, jax.random.key(seed), RUNS)
            sets.append(1e3 * np.asarray(campaign.flights.peaks["drag_deviation"]))
        row = f"`{choice}`".replace(" world ", "`, `")
        cells += [
            Cell(row, "nominal", 1e3 * float(nominal), 2),
            Cell(
                row, "median, mean of the sets", float(np.mean(np.median(sets, 1))), 2
            ),
            Cell(
                row,
                "99 %, mean of the sets",
                float(np.mean(np.percentile(sets, 99, axis=1))),
                2,
            ),
            Cell(
                row,
                "largest of 1500",
                float(np.max(sets)),
                2,
                published.get(choice),
            ),
        ]
    return cells


def shuttle() -> list[Cell]:
    """Largest cross-range, without and with a limit on the heating, from a cold start."""
    mission, cells = find_mission("shuttle"), []
    times = {"glide": 2008.59, "glide case limited-heating": 2198.67}
    for choice, time in times.items():
        problem = mission.problem()
        best = best_flight(mission.scenario_of(choice), problem)
        row = f"`{choice}`"
        published = problem.published[choice] / degree
        latitude = float(best.flight.state.latitude) / degree
        cells += [
            Cell(row, "latitude at the end, deg", latitude, 4, published),
            Cell(row, "time, s", float(best.flight.time), 2, time),
        ]
    return cells


def cav_h_fit() -> list[Cell]:
    """Coefficients of the polynomial (37) for three ranges of k2, in steps of 0.05."""
    mission, cells = find_mission("cav-h"), []
    scenario = mission.scenario("stored")
    k2 = np.linspace(0.3, 1.0, 15)
    flown = velocity_map(scenario, np.array([0.8, 0.848]), k2).velocity[1]
    for low, high in ((0.4, 1.0), (0.55, 0.9), (0.3, 1.0)):
        some = (k2 > low - 1e-6) & (k2 < high + 1e-6)
        a, b, c = map(float, k2_polynomial(flown[some], k2[some]))
        row = f"{low} to {high}"
        cells += [
            Cell(row, "a, 1e-7 s2/m2", 1e7 * a, 2, 2.32),
            Cell(row, "b, 1e-3 s/m", 1e3 * b, 2, -2.4),
            Cell(row, "c", c, 2, 5.46),
        ]
    return cells


def _cells_of_corridor(row: str, limits, published=(None, None)) -> list[Cell]:
    """Both limits of an entry corridor and its width, deg."""
    shallow, steep = (float(x) / degree for x in limits)
    wide = None if None in published else round(published[0] - published[1], 4)
    return [
        Cell(row, "shallow limit, deg", shallow, 4, published[0]),
        Cell(row, "steep limit, deg", steep, 4, published[1]),
        Cell(row, "width, deg", shallow - steep, 4, wide),
    ]


AMAT_LIMITS = -12.7393, -13.7081
"""Overshoot and undershoot limit, deg: tests/test_girija2020.py of AMAT"""

AMAT_J2 = 3411.0e-6
"""AMAT/planet.py"""


def corridor_as_in_amat() -> list[float]:
    """Limits of the entry corridor over Neptune by the definition of AMAT, rad.

    It has J2, and an apoapsis of the velocity relative to the planet, as if that were
    inertial (AMAT/vehicle.py, `hitsTargetApoapsis`). Otherwise it is `capture_corridor`.
    """
    start = find_mission("neptune-aerocapture").scenario()
    planet, target = start.planet, start.target
    still = dataclasses.replace(planet, rotation_rate=jnp.zeros(()))
    gravity = ZonalGravity(
        planet.gravity.gravitational_parameter, planet.radius, {"j2": AMAT_J2}
    )
    ends = {
        "exit": AltitudeAbove(start.termination.conditions["captured"].altitude),
        "ground": AltitudeBelow(0.0, outcome=Outcome.CRASHED),
    }
    goal = planet.radius + target.apoapsis_altitude

    @eqx.filter_jit
    def braked_too_much(path, cos_bank):
        state = dataclasses.replace(start.initial_state, flight_path_angle=path)
        scenario = dataclasses.replace(
            start,
            planet=dataclasses.replace(planet, gravity=gravity),
            initial_state=state,
            guidance=BankProfile(PolynomialProfile(cos_bank[None])),
            termination=Termination(ends, time_limit=start.termination.time_limit),
        )
        end = fly(scenario).state
        return goal * orbit_of(still, end).inverse_apoapsis_radius - 1.0

    return [
        bisect(
            lambda path, cosine=cosine: float(
                braked_too_much(jnp.asarray(path), jnp.asarray(cosine))
            ),
            STEEPEST,
            -9.0 * degree,
            xtol=1e-9,
        )
        for cosine in (-1.0, 1.0)
    ]


def neptune_corridor() -> list[Cell]:
    """Entry corridor over Neptune by the definition of AMAT, and by our own."""
    ours = capture_corridor(find_mission("neptune-aerocapture").scenario())
    amat = "as AMAT: J2, apoapsis of the relative velocity"
    return [
        *_cells_of_corridor(amat, corridor_as_in_amat(), AMAT_LIMITS),
        *_cells_of_corridor("`jentry corridor neptune-aerocapture`", ours),
    ]


def _cells_of_floor(name: str, case: str | None) -> list[Cell]:
    """Least velocity increment to the target orbit of a mission, and that of its law."""
    mission = find_mission(name)
    scenario = mission.scenario(case=case)
    best = best_flight(scenario, mission.problem())
    guided = eqx.filter_jit(fly)(scenario)
    cells = []
    for row, flight, flown in (
        ("best flight", best.flight, best.scenario),
        ("law", guided, scenario),
    ):
        increment = float(misses(flown, flight).velocity_increment)
        orbit = orbit_of(flown.planet, flight.state)
        cells += [
            Cell(row, "velocity increment, m/s", increment, 1),
            Cell(row, "periapsis, km", float(orbit.periapsis_altitude) / km, 1),
        ]
    return cells


def mars_capture_corridor() -> list[Cell]:
    """Entry corridor of the Mars orbiter."""
    ours = capture_corridor(find_mission("mars-aerocapture").scenario())
    return _cells_of_corridor("`jentry corridor mars-aerocapture`", ours)


def mars_capture_floor() -> list[Cell]:
    """Least velocity increment over Mars in the case `free-plane`."""
    return _cells_of_floor("mars-aerocapture", "free-plane")


def neptune_capture_floor() -> list[Cell]:
    """Least velocity increment over Neptune."""
    return _cells_of_floor("neptune-aerocapture", None)


TABLES: dict[str, Callable[[], list[Cell]]] = {
    "mars nominal": mars_nominal,
    "sx-2 cases": sx_2_cases,
    "x-33 cases": x_33_cases,
    "rlv drag error": rlv_drag_error,
    "cav-h fit": cav_h_fit,
    "shuttle": shuttle,
    "mars aerocapture corridor": mars_capture_corridor,
    "mars aerocapture floor": mars_capture_floor,
    "neptune aerocapture corridor": neptune_corridor,
    "neptune aerocapture floor": neptune_capture_floor,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="*", choices=[[], *TABLES], default=[])
    parser.add_argument("--save", action="store_true", help=f"to {PUBLISHED.name}")
    options = parser.parse_args()
    jentry.setup()
    for name in options.tables or TABLES:
        cells = TABLES[name]()
        print(name)
        for cell in cells:
            beside = "" if cell.published is None else f" ({cell.published:.6g})"
            value = f"{cell.value:.{cell.decimals}f}"
            print(f"  {cell.row:40} {cell.column:40} {value}{beside}", flush=True)
        if options.save:
            save(PUBLISHED, name, cells)


if __name__ == "__main__":
    main()
