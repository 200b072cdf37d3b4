"""What the tests of the commands share."""

import importlib

import cheap
import jax

from jentry.addresses import leaves_by_address
from jentry.flight import FixedStep
from jentry.units import degree


def monte_carlo(command, *words):
    return command("monte-carlo", "cheap", "--step", 1, "--no-figures", *words)


EASY = "peak_drag > 0 m/s2, 70 % at 60 %"
"""All keep it, and 3 runs are enough: 0.7^3 = 0.34"""
LONG = "peak_drag > 0 m/s2, 99 % at 90 %"
"""Takes 230 runs"""


def report(command, folder, *words):
    return command("report", folder, "--no-figures", *words)


def assert_refused(result, message, code=2):
    """In one line, without a traceback."""
    ended, _, said = result
    assert ended == code
    assert message in said
    assert said.startswith("jentry: ") and said.count("\n") == 1


class Arrived(Exception):
    """Ends a command where it would begin to compute."""


def intercepted(monkeypatch, module, name):
    """Keeps what a function of a module is called with, and ends the command there."""
    seen = {}

    def function(*given, **options):
        seen.update(options, given=given)
        raise Arrived

    monkeypatch.setattr(importlib.import_module(module), name, function)
    return seen


OVERRIDES = ("--law", "steep", "--set", "vehicle.mass=900", "--step", 2)
OVERRIDES += ("--dispersions", "mass-only", "--seed", 11)


def assert_overridden(scenario, table, key, solver):
    """What `OVERRIDES` and a density by a file come to."""
    leaves = leaves_by_address(scenario)
    assert leaves["vehicle.mass"] == 900.0
    assert leaves["planet.density_scale"] == 1.25
    assert leaves["guidance.bank_angle"] == 10 * degree
    assert table == cheap.mass_only()
    assert jax.random.key_data(key).tolist() == [0, 11]
    assert solver == FixedStep(2.0)
