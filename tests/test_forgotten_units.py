"""A number without a unit that was meant in another one than SI is refused or warned of."""

import math

import cheap
import numpy as np
import pytest
from helpers import mars_scenario
from override_files import read, uniform

from jentry.campaign import Dispersion, Normal, Uniform, add
from jentry.campaign.campaign import fly_in_blocks
from jentry.campaign.dispersions import check_dispersions
from jentry.fields import check_values
from jentry.units import forgotten_unit, parse_quantity


# Published entries, and what a person types who thinks in the usual units.
FORGOTTEN = [
    (5.8, 11_069.0, "m/s", "km/s"),
    (47.4, 11_069.0, "m/s", "km/s"),
    (-120.0, 121_920.0, "m", "km"),
    (3.3, 5498.0, "kg", "t"),
    (1.2, 0.02, "rad", "deg"),
    (-20.0, 0.349, "rad/s", "deg/s"),
    (21.0, 21_000.0, "Pa", "kPa"),
    (100.0, 1e6, "W/m2", "W/cm2"),
    (1.2, 1e6, "W/m2", "MW/m2"),
    (1000.0, 1e6, "W/m2", "kW/m2"),
    (398_600.4, 4.28e14, "m3/s2", "km3/s2"),
    (0.287, 191.0, "J/(kg K)", "kJ/(kg K)"),
]


@pytest.mark.parametrize(("typed", "present", "unit", "meant"), FORGOTTEN)
def test_the_unit_in_which_the_numbers_are_of_one_size(typed, present, unit, meant):
    assert forgotten_unit(typed, present, unit) == meant
    # In that unit it is no more than five times larger or smaller, and in SI it is.
    si = parse_quantity(f"{typed} {meant}", unit)
    assert 0.2 <= abs(si / present) <= 5.0
    assert not 0.2 <= abs(typed / present) <= 5.0
    assert forgotten_unit(si, present, unit) == ""


TAKEN = [
    (5800.0, 11_069.0, "m/s"),
    (300.0, 11_069.0, "m/s"),  # a drop from a balloon
    (2000.0, 121_920.0, "m"),  # a hop
    (0.0, 11_069.0, "m/s"),  # from rest
    (5.0, 0.0, "rad"),
    (math.nan, 1.0, "m"),
    (math.inf, 1.0, "m"),
    (1.0, math.inf, "m"),
    (1e-320, 1e300, "m"),
    (1e300, 1e-320, "m"),
    (95.0, 1.0, "1"),  # a gain
    (-0.0044, -1.7e-5, "rad"),  # from a level start
    (0.3, 0.005, "rad"),
    (0.2, 0.012, "rad"),
    (1e-5, 1e-7, "rad/s"),  # the drift of a gyroscope
    (0.001, 1.0, "1/s"),
]


@pytest.mark.parametrize(("typed", "present", "unit"), TAKEN)
def test_other_numbers_are_taken(typed, present, unit):
    assert forgotten_unit(typed, present, unit) == ""


def test_a_unit_lifts_the_refusal(written):
    speed = "initial_state.velocity"
    for wrong in ("6.5", " 6.5 "):
        with pytest.raises(ValueError, match=r"6\.5km/s\? .* 6\.5km/s or 6\.5m/s"):
            read(None, [f"{speed}={wrong}"])
    with pytest.raises(ValueError, match=r"6\.5km/s"):
        read(written(f"[set]\n{speed} = 6.5"))
    assert read(None, [f"{speed}=6.5m/s"]).values == {speed: 6.5}
    assert read(None, [f"{speed}=6.5km/s"]).values == {speed: 6500.0}
    assert read(None, [f"{speed}=6500"]).values == {speed: 6500.0}


@pytest.mark.parametrize("bound", ["lower", "upper"])
def test_dispersions_of_a_file(written, bound):
    limits = {"lower": 6500, "upper": 7000} | {bound: 6.9}
    text = uniform(address='"initial_state.velocity"', **limits)
    with pytest.raises(ValueError, match=rf"x\.{bound} is 6\.9, without a unit"):
        read(written(text))
    with_unit = text.replace("6.9", '"6.9 m/s"')
    number = getattr(read(written(with_unit)).dispersions["x"].distribution, bound)
    assert number == 6.9


def test_what_cannot_be_flown_in_any_unit_is_said_first():
    with pytest.raises(ValueError, match="mass is -1 kg: it must be greater than zero"):
        read(None, ["vehicle.mass=-1"])


def test_a_table_is_of_no_size(written):
    """Dispersions of it are refused elsewhere, and so is one number for it."""
    address = "guidance.cos_bank.coefficients"
    text = uniform(address=f'"{address}"', lower=500, upper=600)
    scenario = mars_scenario()
    assert set(read(written(text), scenario=scenario).dispersions) == {"x"}
    assert read(None, [f"{address}=500"], scenario=scenario).values == {address: 500.0}


def test_values_of_a_file(written):
    text = uniform(address='"initial_state.velocity"', lower=None, upper=None)
    text = text.replace("uniform", "discrete") + '\nvalues = [6.75, "6.8 km/s"]'
    with pytest.raises(ValueError, match=r"x\.values is 6\.75, without a unit"):
        read(written(text))


def test_what_is_added_and_factors_are_of_another_size(written):
    text = uniform(address='"vehicle.mass"', lower=0.9, upper=1.1)
    table = read(written(text + '\napply = "add"')).dispersions
    check_dispersions(cheap.scenario(), table)
    table = read(written(text)).dispersions
    with pytest.raises(ValueError, match="For a factor use apply=multiply"):
        check_dispersions(cheap.scenario(), table)


def test_a_dispersion_in_python_warns():
    speed = lambda s: s.initial_state.velocity
    with pytest.warns(UserWarning, match=r"about 6\.5 m/s: if they are in km/s"):
        check_dispersions(
            cheap.scenario(), {"speed": Dispersion(speed, Normal(6.5, 0.1))}
        )
    # Warnings are errors here.
    for distribution, apply in ((Normal(6.5, 0.1), add), (Uniform(6e3, 7e3), None)):
        given = {} if apply is None else {"apply": apply}
        check_dispersions(
            cheap.scenario(), {"speed": Dispersion(speed, distribution, **given)}
        )


def test_inputs_in_python_warn():
    """They are checked before the first flight."""

    def begun(*altitudes):
        inputs = {"initial_state.altitude": altitudes}
        fly_in_blocks(cheap.scenario(), None, None, None, inputs=inputs)

    with pytest.warns(UserWarning, match=r"an input replaces initial_state\.altitude"):
        begun(120.0, 130.0, 125e3)
    begun(120e3, 130e3, 125.0)


def test_a_value_with_its_unit_is_not_asked_for_degrees(written):
    said = (
        "initial_state.latitude is 3.31613 rad, 190 deg: it must be between -90 and 90"
    )
    for text in (
        "[set]\ninitial_state.latitude = '190 deg'",
        "[set]\ninitial_state.latitude = '3.316125578789226 rad'",
    ):
        with pytest.raises(ValueError, match=f"{said} deg$"):
            read(written(text))
    metadata = {"unit": "rad", "range": (-1.0, 1.0)}
    with pytest.raises(ValueError, match="did you mean 3deg"):
        check_values("x", np.asarray(3.0), metadata)
