"""The course of a tuning run: its loss, and the values of the tuned numbers."""

import itertools
from typing import TYPE_CHECKING

import numpy as np

from ..tuning.tuning import Tuned
from .style import ENDS, MEAN, MUTED, NOMINAL, in_style, legend, panelled


if TYPE_CHECKING:
    import matplotlib.figure


def _best_so_far(tuned: Tuned) -> list[int]:
    """Place of the best point up to each step, in the order of `Entry.better_than`."""
    places = [0]
    for place in range(1, len(tuned.course)):
        better = tuned.course[place].better_than(tuned.course[places[-1]])
        places.append(place if better else places[-1])
    return places


def draw_course(tuned: Tuned, title: str = "") -> "matplotlib.figure.Figure":
    """Loss of all evaluated points, and the tuned numbers as shares of their first values.

    For a number that starts at zero, its change is drawn. The best point is marked.
    """
    losses = np.array([entry.loss for entry in tuned.course])
    steps = np.arange(1, losses.size + 1)
    best = tuned.best
    with in_style():
        figure, (left, right) = panelled(9.6, 3.9, 2, title)
        left.plot(steps, losses, ".", color=MUTED, ms=5.0, label="tried")
        so_far = losses[_best_so_far(tuned)]
        left.plot(steps, so_far, color=ENDS[0], label="best so far")
        left.plot(steps[best], losses[best], "o", color=MEAN, ms=6.0, label="best")
        if np.all(losses[np.isfinite(losses)] > 0.0):
            left.set_yscale("log")
        left.set_xlabel("Step")
        left.set_ylabel("Loss")
        legend(left)
        colours = itertools.cycle(ENDS)
        for address in tuned.values:
            course = np.stack([np.ravel(e.values[address]) for e in tuned.course], 1)
            for place, values in enumerate(course):
                label = address if len(course) == 1 else f"{address}[{place}]"
                if values[0] == 0.0:
                    label, shares = f"{label}, change", values
                else:
                    shares = values / values[0]
                right.plot(steps, shares, color=next(colours), lw=1.4, label=label)
        right.axvline(steps[best], color=MEAN, lw=1.0, ls=(0, (3, 2)))
        right.axhline(1.0, color=NOMINAL, lw=0.7)
        right.set_xlabel("Step")
        right.set_ylabel("Share of the first value")
        legend(right)
    return figure
