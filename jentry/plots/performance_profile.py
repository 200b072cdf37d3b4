"""Profiles of performance: how often a law is within a factor of the best law."""

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from .style import ENDS, in_style, panelled


if TYPE_CHECKING:
    import matplotlib.figure


_DASHES = "-", "--", ":"
"""Line styles, which change when all colours are used"""


def draw_profiles(
    factors: Sequence[float],
    shares: Mapping[str, Sequence[float]],
    title: str,
    what: str,
) -> "matplotlib.figure.Figure":
    """Profile of performance of several laws, one curve for each.

    **Arguments:**

    - `factors`: factors of the error of the best law, increasing from 1.
    - `shares`: share of what is compared within each factor, by law.
    - `what`: what is compared, such as flights or cases.
    """
    with in_style():
        figure, (axes,) = panelled(6.4, 4.0, 1, title, measured=True)
        looks = itertools.cycle(itertools.product(_DASHES, ENDS))
        for (dashes, colour), (name, values) in zip(
            looks, shares.items(), strict=False
        ):
            axes.step(
                factors,
                [100.0 * share for share in values],
                where="post",
                color=colour,
                ls=dashes,
                label=name,
            )
        axes.set_xscale("log")
        axes.set_xlim(factors[0], factors[-1])
        axes.set_ylim(-1.0, 101.0)
        axes.set_xlabel("Factor of the error of the best law")
        axes.set_ylabel(f"{what[:1].upper()}{what[1:]} within the factor (%)")
        columns = 1 if max(map(len, shares)) > 40 else 2
        figure.legend(loc="outside lower center", ncols=columns)
    return figure
