"""Knowledge errors of the mission `msl` that are correlated with its delivery errors.

Before the entry the ground tells the spacecraft where it is: the best estimate that the
tracking gives. What such an estimate errs by is uncorrelated with the estimate itself;
otherwise a better one could be made of it. So the covariance of the delivery error (actual
minus planned) and the knowledge error (believed minus actual) is minus the variance of the
knowledge error, and their correlation

    - (standard deviation of the knowledge) / (standard deviation of the delivery).

The spacecraft believes to be nearer to the plan than it is. Sources state the sizes of
these errors, and no correlation: that the state is a best estimate, and that each pair of
components is estimated by itself, is chosen.
"""

from collections.abc import Mapping

import jax.numpy as jnp

from ...campaign.correlations import correlated_normals
from ...campaign.dispersions import Dispersion
from ...motion.state import EntryState
from ...world.planet import Planet


def moved_by_delivery(
    planet: Planet, start: EntryState
) -> dict[str, tuple[str, float]]:
    """Knowledge error of the same kind, by delivery error: its name, and how far the
    delivery error moves it, in m/rad or m/s/rad.

    The velocity is as well known as it is delivered. It is left out, since the vehicle
    would then believe its plan.
    """
    radius = planet.radius + start.altitude
    level = start.velocity * jnp.cos(start.flight_path_angle)
    return {
        "longitude": ("position east", float(radius * jnp.cos(start.latitude))),
        "latitude": ("position north", float(radius)),
        "flight-path angle": ("velocity up", float(level)),
        "heading": ("velocity north", float(-level * jnp.sin(start.heading))),
    }


def as_estimated(
    table: Mapping[str, Dispersion], planet: Planet, start: EntryState
) -> dict[str, Dispersion]:
    """A table of delivery and knowledge errors, with those of `moved_by_delivery`
    correlated."""
    table = dict(table)
    for delivery, (knowledge, per_unit) in moved_by_delivery(planet, start).items():
        off, unknown = (
            float(table[name].distribution.moments()[1])
            for name in (delivery, knowledge)
        )
        share = -unknown / (off * per_unit)
        pair = {name: table[name] for name in (delivery, knowledge)}
        table |= correlated_normals(pair, [[1.0, share], [share, 1.0]])
    return table
