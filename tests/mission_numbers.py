"""Numbers of the missions, to compare with those that their papers print."""

import pytest
from helpers import truths

from jentry.addresses import addresses_of, leaves_by_address
from jentry.missions import find_mission


YAN_HE, ZHOU = truths("yan_he.csv"), truths("zhou.csv")

MARS, RANGE, CAV_H, SX_2 = (
    find_mission(name)
    for name in ("mars-drag-tracking", "mars-range-tracking", "cav-h", "sx-2")
)

ROUNDING = 1e-14
"""Relative: a product of two or three numbers"""


def numbers(scenario):
    """Value of each single number by address."""
    leaves = leaves_by_address(scenario).items()
    return {address: float(leaf) for address, leaf in leaves if leaf.shape == ()}


def assert_has(scenario, expected):
    """The values at their addresses, and nothing else there."""
    known = numbers(scenario)
    found = {address: known[address] for address in expected}
    assert found == pytest.approx(expected, rel=ROUNDING, abs=0.0)


def below(beginning, **values):
    return {f"{beginning}.{name}": value for name, value in values.items()}


MONTE_CARLO = "monte_carlo_gains", "monte_carlo_observer"
NOMINAL = "nominal_gains", "nominal_observer"


def drawn(scenario, dispersion):
    """Addresses, kind, bounds or moments, and how they are applied."""
    distribution = dispersion.distribution
    values = [float(x) for x in leaves_by_address(distribution).values()]
    where = tuple(addresses_of(scenario, dispersion.where))
    return where, type(distribution), tuple(values), dispersion.apply


def assert_drawn(scenario, table, expected):
    assert set(table) == set(expected)
    for name, (where, kind, values, apply) in expected.items():
        found = drawn(scenario, table[name])
        assert found[:2] == (where, kind) and found[3] is apply, name
        assert found[2] == pytest.approx(values, rel=ROUNDING, abs=1e-16), name


DENSITY, LIFT, DRAG = "planet.density_scale", "vehicle.lift_scale", "vehicle.drag_scale"


def assert_published(mission, truth, units):
    """Each value of the printed table, in its unit, of as many runs as it is printed of."""
    printed = {value.name: value.value for value in mission.published}
    assert printed == truth["table_3"]
    assert {value.unit for value in mission.published} == units
    assert mission.published_runs == truth["study"]["runs"]
