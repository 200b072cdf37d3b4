"""What `jentry` offers at its top, and that a number of a law is a leaf or refused."""

import dataclasses
import subprocess
import sys
import tomllib
from pathlib import Path

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ConstantBank, free_scenario

import jentry
from jentry.addresses import with_leaves
from jentry.campaign.description import describe
from jentry.fields import Scalar, scalar


ROOT = Path(__file__).parents[1]

NEEDED = """
    __version__ scalar table optional_scalar Scalar
    Planet Vehicle EntryState Controls Measurement Scenario Target Termination
    AbstractContinuousLaw AbstractSampledLaw Sampled FixedCycle ShorteningCycle
    AbstractAtmosphere AbstractAerodynamics AbstractGravity AbstractWind
    AbstractAttitude AbstractEndCondition AbstractDistribution AbstractProfile
    VelocityBelow VelocityAbove AltitudeBelow AltitudeAbove Apoapsis Periapsis Crossing
    TargetPassed Outcome has_end MeanSquare mean_square conditional_value_at_risk
    km deg Mission PublishedValue find_mission fly misses monte_carlo tune sensitivity
    linear_covariance run_campaign open_campaign Dispersion Normal Uniform add multiply
    Aim TargetOfScenario AbstractConstraint LoadFactor PathPoint write_trajectory
"""


def test_what_a_user_needs_is_there():
    assert set(NEEDED.split()) - {"__version__"} <= set(jentry.__all__)
    found = {}
    exec("from jentry import *", found)
    assert set(jentry.__all__) <= set(found)
    for name in jentry.__all__:
        assert not isinstance(getattr(jentry, name), type(sys)), f"{name} is a module"
    assert {*jentry.__all__, "__version__", "__all__"} <= set(dir(jentry))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert jentry.__version__ == project["version"]
    assert (Path(jentry.__file__).parent / "py.typed").exists()
    assert jentry.deg == jentry.units.degree
    with pytest.raises(AttributeError, match="no attribute 'fyl'"):
        jentry.fyl  # noqa: B018


LIGHT = """
import sys
import jentry
assert jentry.__version__
import jentry.cli.entry
heavy = {"jax", "numpy", "equinox", "diffrax"} & set(sys.modules)
assert not heavy, heavy
"""


def test_the_top_and_the_options_import_nothing_heavy():
    run = subprocess.run(
        [sys.executable, "-c", LIGHT], capture_output=True, text=True, cwd=ROOT
    )
    assert run.returncode == 0, run.stderr


class Plain(jentry.AbstractContinuousLaw[None]):
    """A law with numbers that are no leaves, as a user may write them."""

    gain: float = 2.0
    count: int = eqx.field(default=3, static=True)
    period: float = eqx.field(default=0.5, static=True)
    on: bool = True
    bank_angle: Scalar = scalar(0.1, unit="rad")

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        return jentry.Controls.from_bank(self.bank_angle, 0.0 * time), None


class Inside(eqx.Module):
    gains: dict


REFUSED = r"guidance.gain is the Python number 2.0, .* `gain: Scalar = jentry.scalar"


def with_law(law):
    return dataclasses.replace(cheap.scenario(), guidance=law)


def test_a_plain_number_of_a_law_is_refused_by_its_field():
    scenario = with_law(Plain())
    density = {"density": cheap.dispersions()["density"]}
    for call in (
        lambda: jentry.check(scenario),
        lambda: jentry.fly(scenario),
        lambda: jax.eval_shape(lambda: jentry.fly(scenario)),
        lambda: jentry.monte_carlo(scenario, density, jax.random.key(0), 2),
        lambda: jentry.sensitivity(scenario),
        lambda: jentry.linear_covariance(scenario, density),
    ):
        with pytest.raises(ValueError, match=REFUSED):
            call()
    with pytest.raises(ValueError, match="guidance.gain is the Python number 3,"):
        jentry.check(with_law(Plain(gain=3)))
    # As an array it is a leaf, and what is static stays as it is.
    jentry.check(with_law(Plain(gain=jnp.asarray(2.0))))


def test_a_plain_number_deep_inside_is_refused():
    with pytest.raises(ValueError, match="^gains.b.1 is the Python number 1.5"):
        with_leaves(Inside({"a": jnp.ones(2), "b": [jnp.ones(()), 1.5]}))


@pytest.mark.slow
def test_a_plain_number_in_a_field_of_a_number_becomes_a_leaf():
    """As `tree_at` leaves it: the same flight, described by the same address."""
    where = lambda s: s.guidance.bank_angle
    plain = eqx.tree_at(where, cheap.scenario(), 0.3)
    assert isinstance(plain.guidance.bank_angle, float)
    leaf = with_leaves(plain)
    assert leaf.guidance.bank_angle.dtype == np.float64
    same = eqx.tree_at(where, cheap.scenario(), jnp.asarray(0.3))
    assert with_leaves(same) is same
    ends = [jentry.fly(s, cheap.SOLVER).state for s in (plain, same)]
    assert all(map(np.array_equal, *map(jax.tree.leaves, ends)))
    moved = jentry.sensitivity(plain, wrt=where, solver=cheap.SOLVER)
    assert np.isfinite(moved.jacobian["downrange"]["guidance.bank_angle"])


class Own(jentry.AbstractDistribution):
    width: float = 1.0

    def sample(self, key):
        return jax.random.normal(key)

    def moments(self):
        return jnp.zeros(()), jnp.ones(())

    def scaled(self, factor):
        return self


def test_a_plain_number_of_a_distribution_is_refused_or_described():
    where = lambda s: s.vehicle.mass
    own = {"mass": jentry.Dispersion(where, Own(), apply=jentry.add)}
    with pytest.raises(ValueError, match="dispersions.mass.width is the Python number"):
        jentry.monte_carlo(cheap.scenario(), own, jax.random.key(0), 2)
    uniform = eqx.tree_at(lambda u: u.upper, jentry.Uniform(900.0, 950.0), 1000.0)
    table = {"mass": jentry.Dispersion(where, uniform)}
    described = describe(cheap.scenario(), table, 0, cheap.SOLVER, None)
    assert described["dispersions"]["mass"]["upper"] == 1000.0


def test_numbers_that_were_made_before_setup_are_refused():
    """In single precision, which is not what the rest of the flight is in."""
    early = ConstantBank(bank_angle=jnp.zeros((), jnp.float32))
    early = eqx.tree_at(lambda law: law.bank_angle, early, jnp.float32(0.5))
    scenario = eqx.tree_at(
        lambda s: s.guidance,
        free_scenario(0.5),
        early,
        is_leaf=lambda x: isinstance(x, jentry.AbstractLaw),
    )
    message = (
        "guidance.bank_angle is of single precision: it was made before jentry.set"
    )
    with pytest.raises(ValueError, match=message):
        jentry.fly(scenario)
