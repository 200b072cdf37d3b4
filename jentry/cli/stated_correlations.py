"""Dispersions with the correlations that a configuration file states for pairs."""

from collections.abc import Mapping

import numpy as np

from ..addresses import nearest
from ..campaign.correlations import correlated_normals
from ..campaign.dispersions import Dispersion


def correlated(
    dispersions: Mapping[str, Dispersion],
    correlations: Mapping[str, Mapping[str, float]],
) -> dict[str, Dispersion]:
    """A table of dispersions, with the correlations that a file states for pairs.

    A pair without a stated coefficient is uncorrelated, even if both are correlated with
    a third dispersion.

    **Raises:** `ValueError` for an unknown name, for a dispersion with itself, and for two
    coefficients of one pair.
    """
    table, joined = dict(dispersions), {name: {name} for name in dispersions}
    coefficients: dict[frozenset[str], float] = {}
    for name, others in correlations.items():
        for other, value in others.items():
            place = f"dispersions.{name}.correlation"
            if other not in table:
                raise ValueError(
                    f"{place}: no dispersion {other!r}; {nearest(other, table)}"
                )
            if other == name:
                raise ValueError(f"{place}: the correlation of {name} with itself is 1")
            pair = frozenset((name, other))
            if coefficients.setdefault(pair, value) != value:
                raise ValueError(
                    f"{place}.{other} is {value:g}, and dispersions.{other}.correlation"
                    f".{name} {coefficients[pair]:g}: give one of them"
                )
            group = joined[name] | joined[other]
            joined |= dict.fromkeys(group, group)
    for group in {id(group): group for group in joined.values()}.values():
        if len(group) < 2:
            continue
        names = [name for name in dispersions if name in group]
        matrix = np.eye(len(names))
        for i, j in np.ndindex(matrix.shape):
            if i != j:
                matrix[i, j] = coefficients.get(frozenset((names[i], names[j])), 0.0)
        table |= correlated_normals({name: table[name] for name in names}, matrix)
    return table
