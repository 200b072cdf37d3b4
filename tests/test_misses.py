"""Misses of a flight that ended somewhere, without flying it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import free_scenario, with_leaf

from jentry.flight import Flight, Target, misses
from jentry.motion import ConstraintValues, EntryState
from jentry.units import degree, km


RADIUS = 3397 * km


def missed(end, target):
    """Misses of a flight that began on the equator, due east, and ended in a state."""
    scenario = with_leaf(free_scenario(), lambda s: s.target, target)
    none = jnp.asarray(0.0)
    peaks = ConstraintValues({"drag": none})
    code = jnp.asarray(0)
    return misses(scenario, Flight(none, end, code, code, peaks, {}, {}, None))


def state(longitude=0.2, heading=90 * degree):
    return EntryState(11 * km, longitude, 0.0, 510.0, -0.2, heading)


def target(downrange=0.2, heading=None):
    return Target(10 * km, 503.0, downrange * RADIUS, heading=heading)


@pytest.mark.parametrize(
    ("actual", "desired", "difference"),
    [(92, 90, 2), (-179, 179, 2), (359.5, 0.0, -0.5), (10, 730, 0), (1, -1, 2)],
)
def test_heading_is_counted_the_nearer_way_around(actual, desired, difference):
    missed_by = missed(state(heading=actual * degree), target(heading=desired * degree))
    np.testing.assert_allclose(missed_by.heading, difference * degree, atol=1e-14)


@pytest.mark.parametrize(
    ("flown", "desired"), [(0.2, 0.2), (0.25, 0.2), (3.3, 3.1), (3.0, 3.3), (6.2, 6.1)]
)
def test_downrange_is_counted_the_nearer_way_around(flown, desired):
    """A flight of more than half of the globe, rad; arcs come back as -pi to pi."""
    missed_by = missed(state(longitude=flown), target(downrange=desired))
    # Rounding of an arc of 2e7 m.
    np.testing.assert_allclose(
        missed_by.downrange, (flown - desired) * RADIUS, atol=1e-7
    )


def test_the_nearer_way_has_the_derivative_of_the_difference():
    slope = jax.grad(lambda x: missed(state(heading=x), target(heading=-3.1)).heading)(
        3.1
    )
    assert slope == 1.0
