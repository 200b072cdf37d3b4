"""Each dispersion that a mission declares changes its flights."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from first_sets import small_batches
from helpers import choices

from jentry.addresses import leaves_by_address
from jentry.campaign import disperse, draw, monte_carlo
from jentry.campaign.dispersions import check_dispersions
from jentry.campaign.distributions import Constant
from jentry.missions import ALL


# apollo-10 falls almost vertically at the end.
MARKS = {
    "apollo-10": [pytest.mark.filterwarnings("ignore:.*decisions without prediction")],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "mission",
    [pytest.param(m, marks=MARKS.get(name, []), id=name) for name, m in ALL.items()],
)
def test_every_declared_dispersion_changes_the_flight_when_it_alone_is_drawn_anew(
    mission, key
):
    """A flight of each table, and for every dispersion one in which only that differs."""
    for variant, readings in readings_by_variant(mission).items():
        scenario = mission.scenario_of(variant)
        names, rows, seen = [], [], {}
        for reading in readings:
            table = mission.dispersion_table(reading)
            # Of a distribution that is often zero, the first draw that is another one.
            many = jax.vmap(functools.partial(draw, table, key))(jnp.arange(64))
            base = {name: x[0] for name, x in many.items()}
            other = {name: x[np.argmax(x != x[0])] for name, x in many.items()}
            # Those that an earlier table has too have been drawn.
            drawn = [
                n
                for n, d in table.items()
                if not isinstance(d.distribution, Constant) and seen.get(n) != d
            ]
            seen |= table
            if not drawn:
                continue
            for name in [None, *drawn]:
                draws = base if name is None else base | {name: other[name]}
                names.append((reading, name))
                rows.append(disperse(scenario, table, draws))
        leaves = leaves_by_address(scenario)
        addresses = {address for row in rows for address in row}
        inputs = {a: [float(row.get(a, leaves[a])) for row in rows] for a in addresses}
        with small_batches():
            campaign = monte_carlo(scenario, inputs=inputs)
        misses, flights = campaign.misses, campaign.flights
        place = misses.downrange, misses.velocity
        if (
            misses.downrange is None
        ):  # the target is an orbit, and any longitude will do
            place = misses.apoapsis, flights.state.longitude
        ends = np.stack((flights.time, *place))
        bases = [names.index((reading, None)) for reading, _ in names]
        change = np.abs(ends - ends[:, bases]).max(axis=0)
        # s, m and m/s; far above rounding, far below what a tenth of a deviation does.
        moved = dict(zip(names, change > 1e-6, strict=True))
        assert not [name for name, by in moved.items() if name[1] and not by]


def readings_by_variant(mission):
    """The readings, by as few choices as have what they move: each is compiled.

    The errors of the navigation, which all missions make by the same code, are those of
    one mission: `test_inertial_missions` says that they reach their leaves in each.
    """
    mars = mission.name == "mars-range-tracking"
    scenario_of = functools.cache(mission.scenario_of)
    readings = [r for r in mission.dispersions if mars or "knowledge" not in r]

    def takes(variant, reading):
        try:
            check_dispersions(scenario_of(variant), mission.dispersion_table(reading))
        except ValueError:
            return False
        return True

    found = {}
    # Those that move much first: their choices have what the others move as well.
    for reading in sorted(readings, key=lambda r: -size(mission, r)):
        # The first law in every world before every law: to make one takes a second.
        worlds = [
            f"{law} world {world}" for law in mission.laws for world in mission.worlds
        ]
        few = len(mission.worlds)
        two = [
            f"{law} world {one} world {other}"
            for law in mission.laws
            for one, other in itertools.permutations(mission.worlds, 2)
        ]
        every = (
            *found,
            next(iter(mission.laws)),
            *worlds[:few],
            *choices(mission),
            *worlds,
            *two,
        )
        variant = next(v for v in every if takes(v, reading))
        found.setdefault(variant, []).append(reading)
    return found


def size(mission, reading):
    return len(mission.dispersion_table(reading))
