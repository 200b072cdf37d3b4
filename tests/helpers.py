"""Scenarios, laws and compiled functions that several test files share.

Compiling is most of the time of the tests: what is compiled here is compiled once for a
session. Every number of a scenario is a leaf, so that one compiled flight serves every
scenario of the same structure.
"""

import csv
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jentry.addresses import leaves_by_address, replace_leaves
from jentry.fields import Scalar, scalar
from jentry.flight import (
    AltitudeAbove,
    AltitudeBelow,
    Outcome,
    Scenario,
    Target,
    Termination,
    VelocityBelow,
    fly,
)
from jentry.guidance import (
    AbstractContinuousLaw,
    AbstractSampledLaw,
    BankProfile,
    FixedCycle,
)
from jentry.motion import Controls, EntryDynamics, EntryState, EquatorialDynamics
from jentry.onboard import PolynomialProfile
from jentry.units import degree, km
from jentry.world import (
    ConstantAerodynamics,
    ExponentialAtmosphere,
    InverseSquareGravity,
    Planet,
    Vehicle,
)


TRUTHS = Path(__file__).parent / "truths"

MARS_ROTATION = 7.088e-5
"""rad/s"""


_fly_compiled = eqx.filter_jit(fly)
_fly_batch = eqx.filter_jit(
    lambda scenarios, *how: jax.vmap(lambda s: fly(s, *how))(scenarios)
)


def strong(tree):
    """With arrays of one type: for `jnp.asarray(1.0)`, whose type is weak, JAX has another
    program than for `jnp.asarray(1.0, float)`."""
    return jax.tree.map(lambda x: x.astype(x.dtype) if _is_weak(x) else x, tree)


def _is_weak(leaf) -> bool:
    return getattr(leaf, "weak_type", False)


def fly_compiled(scenario, *how, **options):
    """One cache for all tests: the same structure, solver and history compile once."""
    return _fly_compiled(strong(scenario), *how, **options)


def fly_batch(scenarios, *how):
    """As `fly_compiled`, of many scenarios."""
    return _fly_batch(strong(scenarios), *how)


class ConstantBank(AbstractContinuousLaw[None]):
    """The smallest law: one bank angle, rad, of either sign."""

    bank_angle: Scalar = scalar(0.0, unit="rad")

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        angle_of_attack = jnp.zeros_like(self.bank_angle)
        bank = self.bank_angle
        return Controls(angle_of_attack, jnp.cos(bank), jnp.sin(bank)), None


class Doubting(AbstractSampledLaw[tuple[()], Scalar]):
    """Full lift, with a caveat: the share of its cycles that began below an altitude."""

    altitude: Scalar = scalar(unit="m")
    cycle: FixedCycle = FixedCycle(1.0)

    def init(self, measurement):
        nothing = 0.0 * measurement.drag
        return (), (nothing, nothing)

    def update(self, time, measurement, memory, held):
        below = measurement.state.altitude < self.altitude
        return (), (held[0] + 1.0, held[1] + jnp.where(below, 1.0, 0.0))

    def __call__(self, time, measurement, memory, held):
        one = jnp.ones_like(measurement.drag)
        return Controls(0.0 * one, one, 0.0 * one), ()

    def caveats(self, held):
        return {"low_cycles": held[1] / held[0]}


def truths(name: str) -> dict[str, dict[str, float]]:
    """`case -> quantity -> value` of a file in `tests/truths/`, its comments left out."""
    found: dict[str, dict[str, float]] = {}
    with open(TRUTHS / name) as file:
        lines = [line for line in file if not line.startswith("#")]
    for row in csv.DictReader(lines):
        found.setdefault(row["case"], {})[row["quantity"]] = float(row["value"])
    return found


CHANCE = 1e-6
"""That a bound on what is drawn is broken by one seed among all"""

SPREADS = 5.0
"""Of a mean from set to set, by as many its bounds are off: a chance of 6e-7"""


def most_by_chance(runs: int, share: float) -> int:
    """Of so many runs, at most, what a share of all flights is."""
    return _binomial(1.0 - CHANCE, runs, share)


def least_by_chance(runs: int, share: float) -> int:
    """Of so many runs, at least, what a share of all flights is."""
    return _binomial(CHANCE, runs, share)


def _binomial(chance: float, runs: int, share: float) -> int:
    from scipy import stats  # which takes as long to import as jax

    return int(stats.binom.ppf(chance, runs, share))


def mars_planet(**changes) -> Planet:
    return Planet(
        3397 * km,
        gravity=InverseSquareGravity(4.28283e13),
        atmosphere=ExponentialAtmosphere(0.0158, 9354.5),
        **changes,
    )


def mars_vehicle() -> Vehicle:
    drag_coefficient = 992.0 / (115.0 * 16.0)
    aerodynamics = ConstantAerodynamics(0.18 * drag_coefficient, drag_coefficient)
    return Vehicle(992.0, 16.0, aerodynamics=aerodynamics)


def mars_entry() -> EntryState:
    return EntryState(126.1 * km, 0.0, 0.0, 6750.0, -14.4 * degree, 90 * degree)


def bank_profile() -> BankProfile:
    """Close to the planned reference, and far from where the cosine is clipped."""
    return BankProfile(PolynomialProfile([0.62, 0.05], 503.0, 6247.0))


def mars_scenario(
    guidance=None, time_limit=400.0, dynamics=EquatorialDynamics()
) -> Scenario:
    """The entry of Yan and He; open loop if no law is given."""
    ends = {"velocity": VelocityBelow(503.0), "altitude": AltitudeBelow(10 * km)}
    return Scenario(
        mars_planet(),
        mars_vehicle(),
        mars_entry(),
        bank_profile() if guidance is None else guidance,
        Termination(ends, time_limit),
        Target(10 * km, 503.0, 723.32 * km, origin=mars_entry()),
        dynamics=dynamics,
    )


def free_scenario(bank_angle=50 * degree, time_limit=300.0) -> Scenario:
    """Constant bank in three dimensions, with an end condition for each outcome."""
    ends = {
        "ceiling": AltitudeAbove(140 * km),
        "ground": AltitudeBelow(0.0, outcome=Outcome.CRASHED),
        "velocity": VelocityBelow(503.0),
    }
    scenario = mars_scenario(ConstantBank(bank_angle), dynamics=EntryDynamics())
    return with_leaf(scenario, lambda s: s.termination, Termination(ends, time_limit))


def choices(mission) -> list[str]:
    """Every law of a mission, and what else its papers or its tests fly: as text."""
    return [*dict.fromkeys((*mission.laws, *mission.former_variants.values()))]


def with_leaf(tree, where, value):
    """The tree with another value in one place."""
    if eqx.is_array(where(tree)):
        value = jnp.asarray(value, dtype=float)
    return eqx.tree_at(where, tree, value)


def moved_alone(scenario, address):
    """The scenario with one number changed by a thousandth."""
    number = leaves_by_address(scenario)[address]
    return replace_leaves(scenario, {address: number * 1.001})


def ahead(start, heading, distance):
    """Where a great circle leads, and the heading there: the textbook formulas, deg."""
    longitude, latitude = np.radians(start)
    heading, distance = np.radians(heading), np.radians(distance)
    sine = np.sin(latitude) * np.cos(distance) + np.cos(latitude) * np.sin(
        distance
    ) * np.cos(heading)
    there = np.arcsin(sine)
    turn = np.arctan2(
        np.sin(heading) * np.sin(distance) * np.cos(latitude),
        np.cos(distance) - np.sin(latitude) * sine,
    )
    after = np.arctan2(
        np.sin(heading) * np.cos(latitude),
        np.cos(heading) * np.cos(latitude) * np.cos(distance)
        - np.sin(latitude) * np.sin(distance),
    )
    return np.degrees((longitude + turn, there, after))


def over(f):
    """Compiled, for an array of cases: without it each operation compiles by itself."""
    return jax.jit(jax.vmap(f))


def along_each(function, at, steps):
    """Derivatives of a function along each of some numbers, and central differences.

    One program for both: what is differentiated is also what differences are taken of.
    """
    pushed = jax.jit(lambda x, along: jax.jvp(function, (x,), (along,)))
    at, found = jnp.asarray(at), []
    for along, step in zip(jnp.eye(at.size), steps, strict=True):
        _, slope = pushed(at, along)
        ahead, behind = (pushed(at + h * along, along)[0] for h in (step, -step))
        found.append((slope, (ahead - behind) / (2.0 * step)))
    return map(np.stack, zip(*found, strict=True))
