"""What is printed beside its unit is the SI number that it stands for."""

import dataclasses

import cheap
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled

from jentry.addresses import leaves_by_address, unit_of
from jentry.analysis.covariance import Effect, LinearCovariance, LinearModel, Spread
from jentry.analysis.sensitivities import Sensitivity
from jentry.cli import campaign_report
from jentry.cli.analysis_report import print_covariance, print_sensitivity
from jentry.cli.mission_report import print_flight, print_leaves
from jentry.cli.tables import in_digits
from jentry.flight import Flight, Outcome, Target, misses
from jentry.missions.cav_h.scenario import stored
from jentry.motion import ConstraintValues, EntryState
from jentry.units import at_edge, km


SIZE = {
    "m": 1.0,
    "km": 1e3,
    "m/s": 1.0,
    "m/s2": 1.0,
    "deg": np.pi / 180.0,
    "s": 1.0,
    "kPa": 1e3,
    "W/cm2": 1e4,
    "g": 1.0,
}
"""What a printed unit is in SI; of the load factor nothing is changed"""


def rows(printed):
    """Cells of the tables, without their rules."""
    lines = (line for line in printed.splitlines() if "│" in line)
    return [[cell.strip() for cell in line.strip("│ ").split("│")] for line in lines]


@pytest.mark.parametrize("scenario", [cheap.scenario, stored], ids=["mars", "cav-h"])
def test_show_has_every_number_in_the_unit_of_its_field(scenario, capsys):
    scenario = scenario()
    print_leaves(scenario)
    shown = {address: rest for address, *rest in rows(capsys.readouterr().out)}
    leaves = leaves_by_address(scenario)
    assert set(leaves) == set(shown)
    for address, leaf in leaves.items():
        value, unit, *_ = shown[address]
        assert unit == unit_of(scenario, address)
        if leaf.shape == ():
            assert float(value) == pytest.approx(float(leaf), rel=1e-9), address
        else:
            assert value == f"table of {' x '.join(map(str, leaf.shape))}"


def a_flight(**changes):
    """Numbers of a flight that are all different."""
    state = EntryState(10.5 * km, 0.21, -0.03, 503.25, -0.31, 1.6)
    sizes = {"drag": 98.7, "dynamic_pressure": 12_345.0}
    sizes |= {"heat_rate": 876_543.0, "load_factor": 10.25}
    peaks = ConstraintValues({name: jnp.asarray(x) for name, x in sizes.items()})
    numbers = {
        "time": jnp.asarray(227.125),
        "state": state,
        "outcome": jnp.asarray(int(Outcome.SKIPPED_OUT)),
        "ended_by": jnp.asarray(0),
        "peaks": peaks,
        "at_peaks": {},
        "caveats": {},
        "history": None,
    }
    return Flight(**numbers | changes)


def test_fly_prints_what_was_flown(capsys):
    target = Target(10 * km, 503.0, 723.32 * km, -2.0, -0.3, 1.5)
    scenario = dataclasses.replace(cheap.scenario(), target=target)
    flight = a_flight()
    print_flight(cheap.MISSION, scenario, flight)
    printed = capsys.readouterr().out
    assert "cheap: skipped out of the atmosphere (ceiling)" in printed
    found = {name: (float(value), unit) for name, value, unit in rows(printed)}
    missed = misses(scenario, flight)
    expected = {"time": flight.time}
    expected |= {n.replace("_", " "): x for n, x in vars(flight.state).items()}
    expected |= {f"peak {n}".replace("_", " "): x for n, x in flight.peaks.items()}
    known = {n: x for n, x in vars(missed).items() if x is not None}  # of a place
    expected |= {f"{n} error".replace("_", " "): x for n, x in known.items()}
    expected["miss distance"] = missed.distance
    expected = {n.replace("flight path", "flight-path"): x for n, x in expected.items()}
    assert set(found) == set(expected)
    for name, value in expected.items():
        shown, unit = found[name]
        # Six decimals, four of the time.
        half = 0.5001 * (1e-4 if name == "time" else 1e-6)
        assert abs(shown - float(value) / SIZE[unit]) < half, name
    units = {name: unit for name, (_, unit) in found.items()}
    assert units["altitude"] == units["downrange error"] == "km"
    assert units["flight-path angle error"] == units["heading"] == "deg"
    assert units["peak heat rate"] == "W/cm2" and units["peak load factor"] == "g"
    assert units["velocity error"] == "m/s" and units["peak drag"] == "m/s2"


@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        (9.99, "m", (9.99, "m")),
        (-9.99, "m", (-9.99, "m")),
        (10.0, "m", (0.01, "km")),
        (-2500.0, "m", (-2.5, "km")),
        (np.pi, "rad", (180.0, "deg")),
        (250.0, "Pa", (0.25, "kPa")),
        (5e5, "W/m2", (50.0, "W/cm2")),
        (5e7, "J/m2", (5000.0, "J/cm2")),
        (9.0, "m/s", (9.0, "m/s")),
        (3.0, "kg", (3.0, "kg")),
    ],
)
def test_units_at_the_edge(value, unit, shown):
    number, name = at_edge(value, unit)
    assert (float(number), name) == (pytest.approx(shown[0], rel=1e-15), shown[1])


def test_lengths_beside_one_another_share_a_unit():
    values, unit = at_edge(np.array([0.5, 20.0]), "m")
    assert unit == "km"
    np.testing.assert_allclose(values, [5e-4, 0.02], rtol=1e-15)


def test_sensitivity_prints_derivatives_in_si(capsys):
    address, table = "vehicle.mass", "guidance.bank_angle"
    jacobian = {
        "downrange": {address: np.array(1234.5), table: np.array(-6.5e5)},
        "crossrange": {address: np.array(-7.25), table: np.array(3.0)},
    }
    values = {name: np.array(0.0) for name in jacobian}
    print_sensitivity(cheap.scenario(), Sensitivity(values, jacobian, "velocity"))
    printed = capsys.readouterr().out
    assert "while the flight ends by velocity" in printed
    found = {name: rest for name, *rest in rows(printed)}
    assert found[address] == ["kg", "1234.5", "-7.25"]
    assert found[table] == ["rad", "-650000", "3"]


def made(kind, otherwise, **given):
    """One of these records: what is not given is of no interest here."""
    names = [field.name for field in dataclasses.fields(kind)]
    return kind(**{name: given.get(name, otherwise) for name in names})


def test_covariance_prints_predicted_and_flown_spreads_apart(capsys):
    spreads = {
        "downrange": Spread(-100.0, -110.0, 2000.0, -120.0, 2100.0, 0.952),
        "velocity": Spread(0.25, 0.5, 3.0, 0.75, 4.0, 0.75),
    }
    effect_of = lambda linear, flown, bend: made(
        Effect, 0.0, linear=linear, flown=flown, bend=bend
    )
    effects = {
        "downrange": {"mass": effect_of(1500.0, 1400.0, -50.0)},
        "velocity": {"mass": effect_of(1.5, 1.25, 0.125)},
    }
    model = made(LinearModel, {}, time=227.0)
    analysis = LinearCovariance({"velocity": model}, spreads, effects, 500, 2, {})
    print_covariance(cheap.scenario(), analysis, 0.1)
    printed = capsys.readouterr().out
    assert "dispersions x 0.1" in printed and "beside 500 runs" in printed
    found = rows(printed)
    numbers = ["-0.1000", "-0.1100", "2.0000", "-0.1200", "2.1000", "0.952", "holds"]
    assert ["downrange", "km", *numbers] in found
    numbers = ["0.2500", "0.5000", "3.0000", "0.7500", "4.0000", "0.750", "DEPARTS"]
    assert ["velocity", "m/s", *numbers] in found
    effect = ["1.5000", "1.4000", "-0.0500", "1.5000", "1.2500", "0.1250"]
    assert ["mass", *effect] in found
    assert "runs not finite or without an end, left out: 2\n" in printed
    assert "NOTHING" not in printed


def test_covariance_says_of_which_flights_nothing_is_predicted(capsys):
    spreads = {"velocity": Spread(0.25, 0.5, 3.0, 0.75, 4.0, 0.75)}
    model = made(LinearModel, {}, time=227.0)
    without = {"altitude": 0.125, "skip_out": 0.03}
    analysis = LinearCovariance(
        {"velocity": model}, spreads, {"velocity": {}}, 500, 0, without
    )
    print_covariance(cheap.scenario(), analysis, 0.1)
    printed = " ".join(capsys.readouterr().out.split())
    assert "NOTHING is predicted for the flights that end by altitude, 12.5%" in printed
    assert "NOTHING is predicted for the flights that end by skip_out, 3.0%" in printed
    assert "left out" not in printed and "no slopes" not in printed


def test_covariance_says_what_it_leaves_out(capsys):
    spreads = {"velocity": Spread(0.25, 0.5, 3.0, 0.75, 4.0, 0.75)}
    model = made(LinearModel, {}, time=227.0)
    given = {"velocity": model}, spreads, {"velocity": {}}, 500, 0, {}
    analysis = LinearCovariance(*given, ("navigation noise", "wind east"))
    print_covariance(cheap.scenario(), analysis, 0.1)
    printed = " ".join(capsys.readouterr().out.split())
    assert "no slopes by what only chooses: navigation noise, wind east; the" in printed


@pytest.mark.parametrize(
    ("number", "whole", "short"),
    [
        (-4.3e-11, "0.0000", "0"),  # the crossrange of a planar flight, km
        (2e-9, "2.0e-09", "2.0e-09"),
        (-0.5, "-0.5000", "-0.5"),
        (np.nan, "-", "-"),
    ],
)
def test_rounding_errors_are_printed_as_zero(number, whole, short):
    assert in_digits(number) == whole
    assert campaign_report._short(number) == short


def test_a_limit_that_is_exceeded_is_marked(capsys):
    scenario = cheap.scenario()
    peaks = fly_compiled(scenario, cheap.SOLVER).peaks
    for factor, marked in ((0.9, True), (1.1, False)):
        limit = factor * float(peaks["load_factor"])
        constraint = dataclasses.replace(
            scenario.constraints["load_factor"], limit=jnp.asarray(limit)
        )
        limited = dataclasses.replace(
            scenario, constraints={**scenario.constraints, "load_factor": constraint}
        )
        print_flight(cheap.MISSION, limited, fly_compiled(scenario, cheap.SOLVER))
        printed = capsys.readouterr().out
        assert ("limit of the peak load factor, exceeded" in printed) == marked


def test_a_flight_without_an_end_has_no_errors(capsys):
    flight = fly_compiled(cheap.scenario(), cheap.SOLVER)
    lost = dataclasses.replace(flight, outcome=jnp.asarray(int(Outcome.NOT_FINITE)))
    print_flight(cheap.MISSION, cheap.scenario(), lost)
    printed = capsys.readouterr().out
    assert "stopped where its numbers" in printed and "altitude" in printed
    assert "error" not in printed and "peak" not in printed
