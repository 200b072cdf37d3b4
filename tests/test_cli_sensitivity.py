"""`jentry sensitivity`: derivatives and predicted spreads."""

import dataclasses

import cheap
import jax
import pytest
from commands import (
    OVERRIDES,
    Arrived,
    assert_overridden,
    assert_refused,
    intercepted,
)

from jentry.flight import FixedStep


def test_every_option_of_sensitivity_arrives(command, monkeypatch, density):
    module = "jentry.analysis.covariance"
    seen = intercepted(monkeypatch, module, "linear_covariance")
    words = ("--scale", 0.25, "--runs", 16)
    with pytest.raises(Arrived):
        command("sensitivity", "cheap", *words, *OVERRIDES, *density)
    scenario, scaled = seen["given"]
    # A quarter as wide about the mean: 0.95 to 1.05 becomes 0.9875 to 1.0125.
    uniform = scaled["mass"].distribution
    assert [uniform.lower, uniform.upper] == pytest.approx([0.9875, 1.0125])
    as_it_is = cheap.mass_only()["mass"].distribution
    table = {"mass": dataclasses.replace(scaled["mass"], distribution=as_it_is)}
    assert_overridden(scenario, table, seen["key"], seen["solver"])
    assert seen["runs"] == 16
    seen = intercepted(monkeypatch, "jentry.analysis.sensitivities", "sensitivity")
    with pytest.raises(Arrived):
        command("sensitivity", "cheap", "--wrt", "vehicle.mass", *OVERRIDES, *density)
    (scenario,) = seen["given"]
    assert jax.tree.leaves(seen["wrt"](scenario)) == [900.0]
    assert seen["solver"] == FixedStep(2.0)


@pytest.mark.slow
def test_sensitivity_by_differences_prints_their_errors(command):
    given = ("--differences", "--step", 1, "--scale", 1, "--runs", 0)
    code, printed, said = command("sensitivity", "cheap", *given)
    assert (code, said) == (0, "")
    assert "predicted from mean differences" in printed and "+-" in printed


@pytest.mark.slow
def test_sensitivity_prints_derivatives_and_spreads(command):
    given = ("--wrt", "initial_state.velocity,vehicle.mass", "--runs", 40)
    code, printed, said = command(
        "sensitivity", "cheap", "--step", 1, "--scale", 0.1, *given
    )
    assert (code, said) == (0, "")
    for words in ("initial_state.velocity", "vehicle.mass", "dispersions x 0.1"):
        assert words in printed
    assert "holds" in printed and "one std of" in printed


def test_sensitivity_refuses_a_scale_of_nothing(command):
    result = command("sensitivity", "cheap", "--step", 1, "--scale", 0)
    assert_refused(result, "scale is 0: it must be greater than zero")
