"""Angles in messages are in degrees, whatever they are inside."""

import dataclasses

import cheap
import jax
import optax
import pytest

import jentry
from jentry.planning import FreeControl
from jentry.tuning import Bounds, Draws, MeanSquare, tune


def test_a_number_out_of_its_range():
    scenario = jentry.find_mission("mars-drag-tracking").scenario()
    state = scenario.initial_state
    steep = dataclasses.replace(state, flight_path_angle=91.0)
    with pytest.raises(
        ValueError, match=r"is 91 rad, 5213\.92 deg: it must be between -90"
    ):
        jentry.check(dataclasses.replace(scenario, initial_state=steep))


def test_a_control_that_starts_beyond_its_bounds():
    said = r"starts at 57\.2958 deg, with the bounds 0 deg and 28\.6479 deg"
    with pytest.raises(ValueError, match=said):
        FreeControl(1.0, 0.0, 0.5)


def test_bounds_that_do_not_hold_the_value():
    with pytest.raises(ValueError, match=r"are 114\.592 deg and 171\.887 deg: .* deg$"):
        tune(
            cheap.scenario(),
            lambda s: s.guidance.bank_angle,
            MeanSquare(lambda misses: misses.downrange),
            optax.adam(0.1),
            Draws(cheap.mass_only(), jax.random.key(0), 4, held_out=4),
            ranges={"guidance.bank_angle": Bounds(2.0, 3.0)},
        )
