"""States of SX-2 beside its reference, and its tracking law, shared by test files."""

import jax.numpy as jnp
import numpy as np
import sx_2_by_hand as hand

from jentry.guidance import GroundTrackTracking
from jentry.guidance.feedback_linearization import along_reference
from jentry.missions.sx_2.scenario import band, gains, track_model
from jentry.motion import EntryState
from jentry.onboard import quintic_table


POINTS = {
    "early": (0.97, 60.0e3, 0.02, 0.01, -0.5, 3.0),
    "high": (0.75, 57.0e3, 0.10, 0.02, -1.0, 12.0),
    "at the reversal": (0.352, 44.0e3, 0.22, 0.03, -1.5, 25.0),
    "behind it": (0.30, 42.0e3, 0.25, 0.035, 0.7, -20.0),
    "late": (0.04, 27.0e3, 0.31, 0.045, -6.0, -40.0),
}
"""Share of the energy, altitude (m), longitude and latitude (rad), path angle and heading
from east to the left (deg): none of them on the reference"""


def by_hand(name):
    e, altitude, theta, phi, gamma, chi = POINTS[name]
    r = hand.R0 + altitude
    v = np.sqrt(2.0 * (hand.LAST + e * hand.SPAN + hand.MU / r))
    return np.array([r, theta, phi, v, np.radians(gamma), np.radians(chi)])


def as_state(x) -> EntryState:
    r, theta, phi, v, gamma, chi = x
    return EntryState(r - hand.R0, theta, phi, v, gamma, 0.5 * np.pi - chi)


def law_at(state, linearization, **changes) -> GroundTrackTracking:
    """The law with a reference that is the state itself, at every energy."""
    model = track_model()
    here = along_reference(linearization, model, state)
    nothing = jnp.zeros(2)
    columns = {n: (jnp.full(2, x), nothing, nothing) for n, x in here.items()}
    table = quintic_table(jnp.array([hand.FIRST, hand.LAST]), columns)
    return GroundTrackTracking(
        model, table, gains(), band(), linearization=linearization, **changes
    )
