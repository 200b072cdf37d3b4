"""A Bézier law, and single decisions of it, shared by test files."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jentry.guidance import AbstractVelocityPredictor, Epochs, PolynomialAdjustment
from jentry.missions.cav_h.scenario import stored
from jentry.motion import EntryState, air_data
from jentry.onboard import Measurement
from jentry.units import degree, km


def number(x):
    return jnp.asarray(x, dtype=float)


class Linear(AbstractVelocityPredictor):
    """A prediction that is linear in k2 and in the drag: 2600 m/s at 0.717 and 1."""

    def predict(self, glide, situation):
        by_shape = 1000.0 * (situation.shape.second - 0.717)
        return 2600.0 + by_shape + 300.0 * (situation.factors.drag - 1.0)


class Unknown(AbstractVelocityPredictor):
    def predict(self, glide, situation):
        return situation.shape.second * jnp.nan


TO_GO = np.array([0.1, 0.9])
NOMINAL = np.array([2580.0, 2660.0])
POLYNOMIALS = np.array([[0.70, -0.10, 0.02], [0.72, -0.20, 0.06]])

POLYNOMIAL = PolynomialAdjustment(
    TO_GO, 0.717, NOMINAL, POLYNOMIALS, Linear(), Epochs(every=25)
)
LAW = dataclasses.replace(stored().guidance, velocity_control=POLYNOMIAL)
PLANET, VEHICLE = LAW.model.planet, LAW.model.vehicle


@eqx.filter_jit
def decided(law, measurement, held):
    return law.update(number(0.0), measurement, (), held)[1]


@eqx.filter_jit
def expected_forces(state, angle_of_attack):
    air = air_data(PLANET, VEHICLE, state, angle_of_attack)
    return air.lift, air.drag


def at(along=20.0, velocity=5600.0):
    """On the track or beside it, not along the curve that is held."""
    angles = (0.02 * degree, along * degree, -0.3 * degree, 0.1 * degree)
    longitude, latitude, path, heading = map(number, angles)
    state = EntryState(41 * km, longitude, latitude, velocity, path, heading)
    return state


def cycle(
    law=LAW, state=None, lift=1.0, drag=1.0, count=1.0, duration=1.0, second=0.75
):
    """Before and after a decision, the forces being so many times those expected."""
    state = at() if state is None else state
    angle = number(0.23)
    _, before = law.init(
        Measurement(state, number(1.0), number(1.0), *2 * [number(0.0)])
    )
    before = eqx.tree_at(
        lambda d: (
            d.controls.angle_of_attack,
            d.count,
            d.duration,
            d.shape.second,
        ),
        before,
        (angle, number(count), number(duration), number(second)),
    )
    forces = expected_forces(state, angle)
    measurement = Measurement(
        state, lift * forces[0], drag * forces[1], *2 * [number(0.0)]
    )
    return before, decided(law, measurement, before)
