"""A state in winds, and what is measured there, shared by test files."""

import jax.numpy as jnp
import numpy as np
from helpers import mars_planet, mars_vehicle
from worlds import EAST_WIND, NORTH_WIND, WIND_ALTITUDES

from jentry.motion import EntryState
from jentry.onboard import measure
from jentry.units import degree, km
from jentry.world import ConstantWind, TabulatedWind


STATE = EntryState(
    *map(jnp.asarray, (14 * km, 0.1, 0.2, 700.0, -18 * degree, 65 * degree))
)
TABLE = TabulatedWind(WIND_ALTITUDES, EAST_WIND, NORTH_WIND)
WINDS = {
    # Against the heading, and to the left of it.
    "head": ConstantWind(-50 * np.sin(65 * degree), -50 * np.cos(65 * degree)),
    "side": ConstantWind(-50 * np.cos(65 * degree), 50 * np.sin(65 * degree), 3.0),
    "table": TABLE,
}


def one(x):
    return jnp.asarray(x, dtype=float)


def ground_velocity(state):
    path, heading = float(state.flight_path_angle), float(state.heading)
    level = float(state.velocity) * np.cos(path)
    up = float(state.velocity) * np.sin(path)
    return np.array([level * np.sin(heading), level * np.cos(heading), up])


def air_velocity(wind, state=STATE):
    return ground_velocity(state) - np.array(wind.velocity(state.altitude), float)


def sensed(wind, sensors=None):
    planet, vehicle = mars_planet(wind=wind), mars_vehicle()
    angle = vehicle.trim_angle_of_attack
    return measure(
        planet, vehicle, STATE, angle, sampled_at=one(80.0), flow_sensors=sensors
    )
