"""Flights with a navigation filter, for the tests of it."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from helpers import ConstantBank, mars_planet, mars_scenario, mars_vehicle

from jentry.motion import EntryDynamics, EntryState
from jentry.onboard import (
    Altimeter,
    BodyAccelerometers,
    DopplerVelocity,
    DragAltitude,
    Gyroscopes,
    InertialNavigation,
    InertialNoise,
    KnowledgeError,
    NavigationFilter,
    OnboardModel,
    TerrainPosition,
)
from jentry.units import degree, km


KNOWN = KnowledgeError(1e3, 800.0, 600.0, 1.0, 0.8, 0.6, 1e-3, 8e-4, 6e-4)
SENSING = BodyAccelerometers(1e-3, 2e-3, 3e-3, 1e-4, 2e-4, 1e-4, 2e-4, 3e-4)
TURNING = Gyroscopes(1e-6, 2e-6, 3e-6)
WALKS = 1e-3, 1e-6
NAMES = [field.name for field in dataclasses.fields(KNOWN)]

ALTIMETER = Altimeter(10.0, 60 * km, cycle=1.0)
TERRAIN = TerrainPosition(30.0, 60 * km, cycle=2.0)
DOPPLER = DopplerVelocity(0.1, 40 * km, cycle=1.0)
ON_BOARD = OnboardModel(mars_planet(), mars_vehicle())
DRAG = DragAltitude(ON_BOARD, 0.05, 1.0, cycle=1.0)


def filtering(sensors, **given):
    return NavigationFilter(KNOWN, sensors, SENSING, TURNING, *WALKS, **given)


def aided(sensors, seconds=150.0, noise=True, **given):
    """A banked flight over a planet that turns, at an angle of attack."""
    planet = dataclasses.replace(mars_planet(), rotation_rate=7.0882e-5)
    vehicle = eqx.tree_at(
        lambda v: v.trim_angle_of_attack, mars_vehicle(), jnp.asarray(-0.2)
    )
    return dataclasses.replace(
        mars_scenario(ConstantBank(0.9), dynamics=EntryDynamics(), time_limit=seconds),
        planet=planet,
        vehicle=vehicle,
        initial_state=EntryState(70 * km, 0.3, 0.5, 5500.0, -12 * degree, 70 * degree),
        navigation=InertialNavigation(
            noise=InertialNoise(*WALKS) if noise else None,
            filter=filtering(sensors, **given),
        ),
        accelerometers=BodyAccelerometers(),
    )


def errors_of(scenario):
    """All errors that the filter estimates: knowledge, accelerometers, gyroscopes."""
    navigation = scenario.navigation
    return navigation.knowledge, scenario.accelerometers, navigation.gyroscopes


def drawn(scenario, key):
    """The scenario with errors as large as its filter assumes."""
    tree = KNOWN, SENSING, TURNING
    sizes, structure = jax.tree.flatten(tree)
    numbers, seeds = jax.random.split(key)
    errors = jax.random.normal(numbers, (len(sizes),)) * jnp.stack(sizes)
    scenario = eqx.tree_at(
        errors_of, scenario, jax.tree.unflatten(structure, list(errors))
    )
    seed = jax.random.uniform(seeds)
    return eqx.tree_at(lambda s: s.navigation.seed, scenario, seed)
