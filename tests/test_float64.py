"""Without `jentry.setup()` each function that needs float64 says so once, by its name."""

import functools
import os
import subprocess
import sys
from pathlib import Path

import pytest


HERE = Path(__file__).parent

# A process of its own, in which nothing has set float64: the tests set it for theirs.
SCRIPT = """
import sys, tempfile, warnings
sys.path.append({here!r})
import jax, numpy as np, optax
import jentry, cheap
from jentry.planning import (
    k2_polynomials, plan_bank_profile, plan_drag_reference, plan_parameters, velocity_map
)
from jentry.learning import fly_samples

one = cheap.scenario()
table = {{"density": cheap.dispersions()["density"]}}
key = jax.random.key(0)
mission = cheap.MISSION
folder = tempfile.mkdtemp()
mass = lambda s: s.vehicle.mass
bank = lambda s: s.guidance.bank_angle
loss = jentry.MeanSquare(lambda m: m.downrange / 1e3)
calls = {calls}
for name, call in calls.items():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            call()
        except Exception:
            pass
    said = [w for w in caught if "float64 is off" in str(w.message)]
    print(name, len(said), *(str(w.message).split(":")[0] for w in said))
    for w in said:
        assert "call jentry.setup() before anything else" in str(w.message)
        assert w.filename == "<string>", w.filename  # where the user calls
"""

WHOLE = {
    "fly": "lambda: jentry.fly(one, cheap.SOLVER)",
    "monte_carlo": "lambda: jentry.monte_carlo(one, table, key, 2, solver=cheap.SOLVER)",
    "run_campaign": (
        "lambda: jentry.run_campaign(folder, one, table, 0, 2, solver=cheap.SOLVER)"
    ),
    "sensitivity": "lambda: jentry.sensitivity(one, wrt=mass, solver=cheap.SOLVER)",
    "linear_covariance": (
        "lambda: jentry.linear_covariance(one, table, solver=cheap.SOLVER)"
    ),
    "tune": (
        "lambda: jentry.tune(one, bank, loss, optax.adam(0.1), "
        "jentry.Draws(table, key, 2, 2), budget=jentry.Budget(1), solver=cheap.SOLVER)"
    ),
}
"""Each flies"""

REFUSING = {
    "clairvoyant_floor": (
        "lambda: jentry.clairvoyant_floor(one, loss, table, key, end_velocity=5.0)"
    ),
    "plan_bank_profile": "lambda: plan_bank_profile(None, 503.0)",
    "plan_drag_reference": "lambda: plan_drag_reference(None, None)",
    "plan_parameters": "lambda: plan_parameters(one, 2000.0)",
    "velocity_map": "lambda: velocity_map(one, np.ones(1), np.ones(1))",
    "k2_polynomials": "lambda: k2_polynomials(one, None)",
    "fly_samples": "lambda: fly_samples(one, {}, 2, key)",
    "Mission.scenario": "lambda: mission.scenario('nowhere')",
}
"""Each is given what it refuses, but says before that what it needs"""


@functools.cache
def said():
    """By each function how often it was said, and of whom."""
    calls = WHOLE | REFUSING
    lines = ", ".join(f"{name!r}: {call}" for name, call in calls.items())
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(here=str(HERE), calls=f"{{{lines}}}")],
        capture_output=True,
        text=True,
        cwd=HERE.parent,
        env={n: v for n, v in os.environ.items() if n != "JAX_ENABLE_X64"},
    )
    assert run.returncode == 0, run.stderr
    lines = map(str.split, run.stdout.splitlines())
    return {name: words for name, *words in lines}


@pytest.mark.slow
@pytest.mark.parametrize("calls", [WHOLE, REFUSING], ids=["whole", "refusing"])
def test_each_says_so_by_its_name_and_what_it_calls_nothing_beside(calls):
    """Some of these flights are not finite in single precision."""
    assert said().keys() == WHOLE.keys() | REFUSING.keys()
    assert {name: said()[name] for name in calls} == {
        name: ["1", name] for name in calls
    }
