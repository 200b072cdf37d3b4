"""A campaign that is cheap to compile and to fly, for tests of what is around a flight."""

import functools

from helpers import free_scenario

from jentry.campaign import Dispersion, Uniform, add, multiply, run_campaign
from jentry.flight import FixedStep, Scenario
from jentry.missions.mission import Mission, PublishedValue
from jentry.units import degree


SOLVER = FixedStep(1.0)

SEED = 7


@functools.cache
def scenario() -> Scenario:
    """Constant bank, at a bank that lets all dispersed flights go on to the end."""
    return free_scenario(50 * degree)


@functools.cache
def dispersions() -> dict[str, Dispersion]:
    """Of each way to move a leaf one, and one draw that moves two leaves."""
    both = lambda s: (s.vehicle.lift_scale, s.vehicle.drag_scale)
    return {
        "mass": Dispersion(
            lambda s: s.vehicle.mass, Uniform(0.95, 1.05), apply=multiply
        ),
        "density": Dispersion(lambda s: s.planet.density_scale, Uniform(0.8, 1.2)),
        "coefficients": Dispersion(both, Uniform(0.9, 1.1)),
        "path": Dispersion(
            lambda s: s.initial_state.flight_path_angle,
            Uniform(-0.1 * degree, 0.1 * degree),
            apply=add,
        ),
    }


@functools.cache
def mass_only() -> dict[str, Dispersion]:
    return {"mass": dispersions()["mass"]}


def campaign(out, runs, seed=SEED, table=None, **options) -> None:
    """`run_campaign` of this scenario."""
    table = dispersions() if table is None else table
    run_campaign(out, scenario(), table, seed, runs, solver=SOLVER, **options)


MISSION = Mission(
    name="cheap",
    title="Constant bank",
    source="none",
    variants={"right": scenario, "steep": lambda: free_scenario(10 * degree)},
    dispersions={"all": dispersions, "mass-only": mass_only},
    published=(
        PublishedValue("mean time", 300.0, "s", lambda v: float(v["end_time"].mean())),
    ),
    published_note="A note",
    published_variant="right",
    published_dispersions="all",
    published_runs=3,
)
