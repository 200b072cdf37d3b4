"""Steps that the equations of motion refuse near singular points."""

import equinox as eqx
import jax.numpy as jnp
import pytest

from jentry.motion import EntryDynamics, EntryState, EquatorialDynamics
from jentry.units import km


REGULAR = EntryState(60 * km, 0.1, 0.2, 3000.0, -0.3, 1.0)


def moved(state, **changes):
    return eqx.tree_at(
        lambda s: [getattr(s, name) for name in changes],
        state,
        [jnp.asarray(float(x)) for x in changes.values()],
    )


@pytest.mark.parametrize(
    ("before", "after", "too_long", "in_plane"),
    [
        # Turns just below and above a quarter of a radian.
        ({}, {"flight_path_angle": -0.54}, False, False),
        ({}, {"flight_path_angle": -0.56}, True, True),
        ({}, {"heading": 0.74}, True, False),
        ({}, {"heading": 0.76}, False, False),
        ({}, {"longitude": 0.34, "heading": 1.05}, False, False),
        ({}, {"longitude": -0.16}, True, False),
        # Close by, straight and with a turn.
        ({"latitude": 1.55}, {"latitude": 1.56}, False, False),
        ({"latitude": 1.55}, {"latitude": 1.56, "longitude": 0.10001}, True, False),
        ({"latitude": 1.50}, {"latitude": 1.49, "longitude": 0.10001}, False, False),
        (
            {"flight_path_angle": -1.55},
            {"flight_path_angle": -1.54, "heading": 1.00001},
            True,
            False,
        ),
        ({"velocity": 2.0}, {"velocity": 1.0}, False, False),
        (
            {"velocity": 2.0},
            {"velocity": 1.0, "flight_path_angle": -0.29999},
            True,
            True,
        ),
        # Beyond.
        ({"latitude": 1.571}, {"latitude": 1.571}, True, False),
        ({"latitude": -1.571}, {"latitude": -1.571}, True, False),
        ({"flight_path_angle": 1.571}, {"flight_path_angle": 1.571}, True, False),
        ({"velocity": -1.0}, {"velocity": -1.0}, True, True),
    ],
)
def test_steps_that_are_too_long(before, after, too_long, in_plane):
    """In the plane of the equator only rest is a singular point."""
    start = moved(REGULAR, **before)
    end = moved(start, **after)
    assert bool(EntryDynamics().is_singular(start, end)) == too_long
    assert bool(EquatorialDynamics().is_singular(start, end)) == in_plane
    beyond = before == after and too_long
    assert bool(EntryDynamics().is_beyond(end)) == beyond
    assert bool(EquatorialDynamics().is_beyond(end)) == (beyond and in_plane)
