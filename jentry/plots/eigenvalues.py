"""Eigenvalues of a frozen closed loop along its flight, with transmission zeros."""

from typing import TYPE_CHECKING

import numpy as np

from ..analysis.frozen_loop import FrozenLoop
from ..units import edge_unit
from .style import MEAN, MUTED, RUNS, in_style, panelled, typeset


if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure


_LINEAR = 1.0
"""Value per span below which the axes are linear; they are logarithmic above"""


def draw_eigenvalues(found: FrozenLoop, title: str = "") -> "matplotlib.figure.Figure":
    """Real and imaginary parts per span of the index, over the index, with time rightwards.

    Dots are eigenvalues, and crosses are transmission zeros. The band extends to the
    magnitude of the largest zero. Deadbeat eigenvalues are not drawn, but counted.
    """
    unit, size = edge_unit(found.unit, found.index)
    at = found.index / size
    with in_style():
        figure, panels = panelled(11.0, 4.4, 2, title, measured=True)
        for axes, part, name in zip(
            panels, (np.real, np.imag), ("Real", "Imaginary"), strict=True
        ):
            finite = np.isfinite(found.eigenvalues)
            drawn = np.where(finite, part(found.per_span), np.nan)
            if part is np.real:
                axes.plot(at, drawn, "-", color=RUNS, lw=0.7, alpha=0.35)
            (dots, *_) = axes.plot(at, drawn, ".", color=RUNS, ms=6.0)
            dots.set_label("eigenvalues of the closed loop")
            if found.zeros is not None and np.isfinite(found.zeros).any():
                _draw_zeros(axes, at, found.zeros * found.span, part)
            axes.axhline(0.0, color=MUTED, lw=0.9)
            axes.set_yscale("symlog", linthresh=_LINEAR)
            spelled = "" if unit == "1" else f" ({typeset(unit)})"
            axes.set_xlabel(f"{found.over.capitalize()}{spelled}")
            axes.set_ylabel(f"{name} part (1 / span)")
            if found.index[-1] < found.index[0]:
                axes.invert_xaxis()
        panels[0].set_title("above zero errors grow", loc="left")
        deadbeat = int(np.sum(~np.isfinite(found.eigenvalues)))
        if deadbeat:
            panels[1].set_title(f"{deadbeat} deadbeat: not drawn", loc="left")
        handles = panels[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=3)
    return figure


def _draw_zeros(
    axes: "matplotlib.axes.Axes", at: np.ndarray, zeros: np.ndarray, part
) -> None:
    there = np.isfinite(zeros)
    far = np.max(np.where(there, np.abs(zeros), 0.0), axis=1, initial=0.0)
    far = np.where(there.any(axis=1), far, np.nan)
    axes.fill_between(
        at, -far, far, color=MEAN, alpha=0.08, lw=0.0, label="as far as the zeros"
    )
    drawn = np.where(there, part(zeros), np.nan)
    (crosses, *_) = axes.plot(at, drawn, "x", color=MEAN, ms=5.0)
    crosses.set_label("transmission zeros of the vehicle")
