"""`fly` refuses numbers and options that cannot be flown."""

import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers import bank_profile, free_scenario, mars_scenario, with_leaf
from jax.core import Tracer
from laws import all_laws

from jentry.fields import Scalar, scalar
from jentry.flight import (
    AltitudeBelow,
    FixedStep,
    Outcome,
    Termination,
    VelocityBelow,
    check,
    fly,
)
from jentry.guidance import BankProfile, Sampled


def sampled_scenario():
    return mars_scenario(Sampled(bank_profile(), 1.0))


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (lambda s: s.vehicle.mass, 0.0, "vehicle.mass is 0 kg"),
        (lambda s: s.vehicle.mass, -5.0, "vehicle.mass is -5 kg"),
        (lambda s: s.planet.density_scale, np.nan, "planet.density_scale is nan"),
        (lambda s: s.initial_state.velocity, np.inf, "initial_state.velocity is inf"),
        (lambda s: s.guidance.bank_angle, np.nan, "guidance.bank_angle is nan"),
        (
            lambda s: s.termination.conditions["velocity"].velocity,
            -1.0,
            "termination.conditions.velocity.velocity is -1 m/s",
        ),
    ],
)
def test_numbers_that_cannot_be_flown_are_refused(where, value, message):
    scenario = with_leaf(free_scenario(), where, value)
    with pytest.raises(ValueError, match=message):
        check(scenario)
    with pytest.raises(ValueError, match=message):
        fly(scenario)


class Band(BankProfile):
    """A law with two numbers of which one must be less than the other."""

    low: Scalar = scalar(1.0)
    high: Scalar = scalar(2.0)

    def __check_init__(self):
        if not isinstance(self.low, Tracer) and not self.low < self.high:
            raise ValueError(f"low is {self.low:g}: it must be below high")


class BandOfItsOwn(Band):
    """Inherits the check."""


@pytest.mark.parametrize("kind", [Band, BandOfItsOwn])
def test_a_part_that_its_class_refuses_is_refused_after_a_change(kind):
    """No constructor runs when a leaf is replaced."""
    law = kind(bank_profile().cos_bank)
    scenario = mars_scenario(Sampled(law, 1.0))
    check(scenario)
    changed = with_leaf(scenario, lambda s: s.guidance.law.low, 3.0)
    with pytest.raises(ValueError, match="^guidance.law, Band: low is 3: it must be"):
        check(changed)
    with pytest.raises(ValueError, match="low is 3"):
        fly(changed)


def test_a_part_is_looked_at_within_a_traced_program():
    """Its numbers are known there, and a comparison of them must not be traced."""

    def check_traced(scenario):
        def checked(mass):
            check(with_leaf(scenario, lambda s: s.vehicle.mass, mass))
            return mass

        return jax.jit(checked)(900.0)

    scenario = mars_scenario(Sampled(Band(bank_profile().cos_bank), 1.0))
    assert check_traced(scenario) == 900.0
    with pytest.raises(ValueError, match="low is 3"):
        check_traced(with_leaf(scenario, lambda s: s.guidance.law.low, 3.0))


def test_a_good_scenario_is_not_refused():
    check(free_scenario())
    check(mars_scenario())


@pytest.mark.parametrize("law", ["state feedback", "observer", "sampled observer"])
def test_planned_laws_are_not_refused(law, reference):
    check(mars_scenario(all_laws[law](reference)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FixedStep(-0.1), "step is -0.1 s"),
        (lambda: FixedStep(0.0), "step is 0.0 s"),
        (lambda: Sampled(bank_profile(), 0.0), "period is 0.0 s"),
        (lambda: Termination({}, -1.0), "time_limit is -1.0 s"),
        (lambda: fly(mars_scenario(), history=0.0), "history is 0.0 s"),
        (lambda: fly(mars_scenario(), history=-1.0), "history is -1.0 s"),
        (
            lambda: fly(sampled_scenario(), history=0.3),
            "history is 0.3 s and the guidance period is 1.0 s",
        ),
        (
            lambda: fly(sampled_scenario(), history=1.5),
            "history is 1.5 s and the guidance period is 1.0 s",
        ),
    ],
)
def test_options_that_cannot_be_meant_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_names_and_outcomes_of_end_conditions_go_together():
    ends = {"b": VelocityBelow(1.0), "a": AltitudeBelow(2.0, outcome=Outcome.CRASHED)}
    termination = Termination(ends, 5.0)
    assert termination.names == ("a", "b", "time_limit")
    assert termination.outcomes == (
        Outcome.CRASHED,
        Outcome.REACHED,
        Outcome.TIMED_OUT,
    )
    assert all(outcome.message for outcome in Outcome)


_IN_FLOAT32 = """
import warnings
import jax
from helpers import mars_scenario
from jentry.flight import fly
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    jax.eval_shape(fly, mars_scenario())
assert any("float64 is off" in str(w.message) for w in caught), caught
"""


@pytest.mark.slow
def test_fly_warns_without_float64():
    """In a fresh process, where nothing has set it."""
    here = Path(__file__).parent
    run = subprocess.run(
        [
            sys.executable,
            "-c",
            f"import sys; sys.path.append({str(here)!r})" + _IN_FLOAT32,
        ],
        capture_output=True,
        text=True,
        cwd=here.parent,
    )
    assert run.returncode == 0, run.stderr
