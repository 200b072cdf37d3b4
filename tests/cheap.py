"""A campaign that is cheap to compile and to fly, for tests of what is around a flight."""

import dataclasses
import math
from typing import TYPE_CHECKING

import jax.numpy as jnp
from helpers import free_scenario

from jentry._computed_once import computed_once
from jentry.campaign import Dispersion, Uniform, add, multiply, run_campaign
from jentry.flight import FixedStep, Scenario
from jentry.guidance import BankProfile
from jentry.missions.mission import Mission, PublishedValue
from jentry.onboard.profiles import PolynomialProfile
from jentry.plots import USUAL, FigureData
from jentry.plots.style import panelled, scaled
from jentry.units import degree


if TYPE_CHECKING:
    from matplotlib.figure import Figure  # which processes that only fly do not need


SOLVER = FixedStep(1.0)

SEED = 7


@computed_once
def scenario() -> Scenario:
    """Constant bank, at a bank that lets all dispersed flights go on to the end."""
    return free_scenario(50 * degree)


@computed_once
def at_trim() -> Scenario:
    """The same flight by a law that leaves the angle of attack to the vehicle."""
    cosine = PolynomialProfile(jnp.array([math.cos(50 * degree)]))
    return dataclasses.replace(scenario(), guidance=BankProfile(cosine))


@computed_once
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


@computed_once
def mass_only() -> dict[str, Dispersion]:
    return {"mass": dispersions()["mass"]}


def campaign(out, runs, seed=SEED, table=None, **options) -> None:
    """`run_campaign` of this scenario."""
    table = dispersions() if table is None else table
    run_campaign(out, scenario(), table, seed, runs, solver=SOLVER, **options)


def ends(data: FigureData) -> "Figure":
    """A figure of this mission's own: where the runs ended, and the bank of the law."""
    figure, (axes,) = panelled(3.0, 3.0, 1, data.title)
    drawn = scaled(data.results["end_altitude"])
    axes.plot(drawn.values, ".")
    assert data.scenario is not None
    axes.set(ylabel=drawn.label, xlabel=type(data.scenario.guidance).__name__)
    return data.noted(figure)


MISSION = Mission(
    name="cheap",
    title="Constant bank",
    source="none",
    laws={"right": scenario, "steep": lambda: free_scenario(10 * degree)},
    dispersions={"all": dispersions, "mass-only": mass_only},
    figures=USUAL | {"ends": ends},
    published=(
        PublishedValue("mean time", 300.0, "s", lambda v: float(v["end_time"].mean())),
    ),
    published_note="A note",
    published_law="right",
    published_dispersions="all",
    published_runs=3,
)
