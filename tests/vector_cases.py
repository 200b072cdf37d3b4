"""Flights through singular points, and others, beside an independent integration."""

import dataclasses

import cartesian
import jax
import jax.numpy as jnp
import numpy as np
from external_cases import NOWHERE, ballistic_vehicle
from helpers import MARS_ROTATION, ConstantBank, fly_batch, mars_planet
from scipy.integrate import solve_ivp

from jentry.flight import AltitudeBelow, FixedStep, Outcome, Scenario, Termination
from jentry.motion import EntryState
from jentry.units import degree, km
from jentry.world import ConstantWind


RADIUS, MU = 3397.0e3, 4.28283e13
STEP = 0.1
"""s"""
DURATION = 200.0
"""s; flights that meet no ground end after it"""
BELOW = -1000 * km
"""Altitude of the ground where there is none"""


@dataclasses.dataclass
class Case:
    """One flight of a ballistic coefficient of 115 kg/m2 at a constant bank (rad)."""

    state: EntryState
    bank: float = 0.0
    lift_to_drag: float = 0.18
    rotation_rate: float = MARS_ROTATION
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Towards east, north and up, m/s"""
    density_scale: float = 1.0
    ground: float = BELOW
    """m"""

    def scenario(self, dynamics):
        planet = mars_planet(
            rotation_rate=self.rotation_rate,
            density_scale=self.density_scale,
            wind=ConstantWind(*self.wind),
        )
        ground = AltitudeBelow(self.ground, outcome=Outcome.CRASHED)
        return Scenario(
            planet,
            ballistic_vehicle(115.0, self.lift_to_drag),
            self.state,
            ConstantBank(self.bank),
            Termination({"ground": ground}, DURATION),
            NOWHERE,
            dynamics=dynamics,
        )

    def expected(self, time):
        """Position (m) and velocity (m/s) after a time (s), by Newton's law in numpy."""
        start = jax.tree.map(float, self.state)
        first = np.stack(cartesian.from_entry_state(RADIUS, start, np))

        def rate(_, y):
            position, velocity = y.reshape(2, 3)
            altitude = cartesian.norm(position) - RADIUS
            density = self.density_scale * 0.0158 * np.exp(-altitude / 9354.5)
            drag = lambda airspeed: 0.5 * density * airspeed**2 / 115.0
            change = cartesian.acceleration(
                position,
                velocity,
                gravitational_parameter=MU,
                rotation_rate=self.rotation_rate,
                wind=self.wind,
                drag=drag,
                lift=(lambda v: self.lift_to_drag * drag(v))
                if self.lift_to_drag
                else None,
                bank_angle=self.bank,
            )
            return np.concatenate([velocity, change])

        solved = solve_ivp(
            rate, (0.0, float(time)), first.ravel(), "DOP853", rtol=1e-12, atol=1e-8
        )
        return solved.y[:, -1].reshape(2, 3)


def fly_all(cases, dynamics):
    scenarios = [case.scenario(dynamics) for case in cases]
    return fly_batch(jax.tree.map(lambda *x: jnp.stack(x), *scenarios), FixedStep(STEP))


def lane_of(tree, lane):
    return jax.tree.map(lambda x: x[lane], tree)


ORDINARY = [
    Case(EntryState(*numbers), bank, wind=(30.0, -20.0, 5.0))
    for numbers, bank in (
        ((126e3, 3.1, 0.5, 6750.0, -0.25, 1.5), 0.9),  # over longitude 180 deg
        ((126e3, -3.9, 0.5, 6750.0, -0.25, 4.5), -0.9),
        ((90e3, 5.0, -0.9, 5000.0, -0.1, -3.0), 2.0),
        ((60e3, 0.1, 1.2, 3000.0, 0.3, 6.2), 0.3),  # heading over north
    )
]
SINGULAR = {
    "over a pole": Case(
        EntryState(60e3, 0.3, 85 * degree, 6000.0, -0.05, 0.0), 0.7, wind=(30.0, -20, 3)
    ),
    "over the other pole": Case(
        EntryState(60e3, 2.0, -85 * degree, 6000.0, -0.05, np.pi), -1.2
    ),
    "through a pole": Case(
        EntryState(60e3, 0.3, 85 * degree, 6000.0, -0.05, 0.0), 0.0, rotation_rate=0.0
    ),
    "a fall from rest": Case(
        EntryState(9144.0, 0.4, 0.3, 0.0, 0.2, 0.5), lift_to_drag=0.0, ground=0.0
    ),
    "from rest in wind": Case(
        EntryState(9144.0, 0.4, 0.3, 0.0, 0.0, 0.5),
        1.0,
        wind=(20.0, -10.0, 3.0),
        density_scale=40.0,
        ground=6000.0,
    ),
    "up and down": Case(
        EntryState(9144.0, 0.2, 0.4, 200.0, 90 * degree, 0.5),
        lift_to_drag=0.0,
        ground=0.0,
    ),
    # It comes through the vertical over the ground, and then flies backwards.
    "in a head wind": Case(
        EntryState(30e3, 0.2, 0.4, 700.0, -30 * degree, 90 * degree),
        1.0,
        wind=(-60.0, 10.0, 0.0),
        density_scale=60.0,
        ground=20e3,
    ),
    "in a head wind without lift": Case(
        EntryState(30e3, 0.2, 0.0, 700.0, -30 * degree, 90 * degree),
        lift_to_drag=0.0,
        wind=(-60.0, 0.0, 0.0),
        density_scale=60.0,
        ground=20e3,
    ),
}
VACUUM = Case(
    EntryState(9144.0, 0.2, 0.4, 200.0, 90 * degree, 0.5),
    rotation_rate=0.0,
    density_scale=1e-30,
    ground=9144.0 - 1e-6,
)
FROM_POLE = Case(
    EntryState(60e3, 0.7, 90 * degree, 3000.0, -0.1, 0.4), rotation_rate=0.0
)
FROM_EQUATOR = Case(
    EntryState(60e3, 0.0, 0.0, 3000.0, -0.1, 90 * degree), rotation_rate=0.0
)
FROM_VERTICAL = Case(
    EntryState(60e3, 0.2, 0.4, 3000.0, -90 * degree, 3.0),
    rotation_rate=0.0,
    ground=20e3,
)
CASES = [*SINGULAR.values(), *ORDINARY, VACUUM, FROM_POLE, FROM_EQUATOR, FROM_VERTICAL]
