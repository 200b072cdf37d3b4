"""Scenarios of range tracking, and its nominal flight, shared by test files."""

import functools

import jax
from helpers import fly_compiled

from jentry._computed_once import computed_once
from jentry.flight import FixedStep
from jentry.missions.mars import range_tracking as mars_range_tracking
from jentry.onboard import measure


def in_plane():
    """The law without lateral motion, as its paper flies."""
    return mars_range_tracking.MISSION.scenario(world="in-plane")


@computed_once
def scenario():
    return mars_range_tracking.three_dimensional()


@functools.cache
def nominal():
    """The nominal flight, without lateral motion, kept each second."""
    return fly_compiled(in_plane(), FixedStep(), 1.0)


def state_at(flight, second):
    return jax.tree.map(lambda x: x[second], flight.history.states)


def sensed(scenario, state):
    vehicle = scenario.vehicle
    return measure(scenario.planet, vehicle, state, vehicle.trim_angle_of_attack)
