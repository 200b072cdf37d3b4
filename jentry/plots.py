"""Figures of a campaign: bands over the runs, error histograms and footprints.

They are built without pyplot and its global state, so they need no display.
"""

import contextlib
import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .flight.termination import Outcome
from .units import degree, km


if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray


RUNS = "#0072B2"
"""Okabe and Ito's blue: all that is drawn over many runs"""
ENDS = (RUNS, "#E69F00", "#CC79A7", "#009E73", "#56B4E9", "#D55E00")
"""Of the same colour-blind-safe palette: runs by the condition that ended them"""
NOMINAL = "#1A1A1A"
RUNS_LIGHT = "#80B9D9"
"""Half of the way to white"""
MEAN = "#D55E00"
MUTED = "#6E6E6E"

_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.labelsize": 10.0,
    "axes.titlesize": 9.5,
    "legend.fontsize": 9.0,
    "legend.edgecolor": "none",
    "legend.framealpha": 0.85,
    "legend.handlelength": 1.6,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": NOMINAL,
    "ytick.labelcolor": NOMINAL,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.7,
}

_SPREADS = ((5.0, 95.0, 0.18), (25.0, 75.0, 0.32))
"""Percentiles of each band, and its opacity; they overlap"""
_REFERENCE = {"lw": 1.1, "ls": (0, (5, 3))}
_GRID = 400
"""Velocities at which the runs are compared"""
_MOST_BINS = 40
_FLAT = 1e-3
"""km. Errors closer together than this count as equal"""
_MANY_POINTS = 20_000
"""Too many to search them for the best place of a legend"""
_CROSSRANGE_SPREAD = 1.0
"""m, above which the crossrange has a panel of its own"""


_Quantity = Callable[["xarray.Dataset"], np.ndarray]
"""Of shape (run, time), in the unit of its axis"""


def campaign_figures(
    results: "xarray.Dataset",
    trajectories: "xarray.Dataset | None" = None,
    nominal: "xarray.Dataset | None" = None,
    title: str = "",
) -> dict[str, "matplotlib.figure.Figure"]:
    """Every figure of a campaign, by name.

    - `drag`, `altitude`: percentile bands of the runs at equal velocity, with the
      nominal flight as the reference line.
    - `bank`: the same at equal time.
    - `downrange`: histogram of the downrange error, actual minus desired.
    - `footprint`: altitude error, and crossrange error if there is any, over downrange
      error.

    The first three need `trajectories`. Runs that did not stay finite are left out, and
    each figure says how many.

    **Arguments:**

    - `results`: all runs, as of `jentry.campaign.results.dataset`.
    - `trajectories`: some runs with histories, on (run, time), NaN after the end.
    - `nominal`: the same of one flight.
    - `title`: above each figure.

        figures = campaign_figures(results, trajectories, nominal, mission.title)
        save_figures(figures, "figures")
    """
    flown, left_out = _finite_runs(results)
    figures = {}
    with _style():
        if trajectories is not None:
            kept, lost = _finite_runs(trajectories)
            for name, draw in _HISTORIES.items():
                figures[name], (axes,) = _figure(6.4, 4.2, 1, title)
                draw(axes, kept, nominal)
                _legend(axes)
                _note(figures[name], lost, trajectories)
        figures["downrange"], (axes,) = _figure(6.4, 4.2, 1, title)
        _draw_downrange(axes, flown)
        _note(figures["downrange"], left_out, results)
        figures["footprint"] = _footprint(flown, nominal, title)
        _note(figures["footprint"], left_out, results)
    return figures


def overview(
    results: "xarray.Dataset",
    trajectories: "xarray.Dataset | None" = None,
    nominal: "xarray.Dataset | None" = None,
    title: str = "",
) -> "matplotlib.figure.Figure":
    """One wide figure of a campaign: drag, bank and downrange error.

    Arguments as of `campaign_figures`. Without `trajectories` there are the downrange
    error and the footprint.
    """
    flown, left_out = _finite_runs(results)
    with _style():
        if trajectories is None:
            figure, (histogram, footprint) = _figure(11.0, 3.6, 2, title)
            _draw_footprint(footprint, flown, nominal, "altitude")
        else:
            figure, (drag, bank, histogram) = _figure(11.0, 3.6, 3, title)
            kept, _ = _finite_runs(trajectories)
            _draw_drag(drag, kept, nominal)
            _draw_bank(bank, kept, nominal)
            _legend(drag)
        _draw_downrange(histogram, flown)
        _note(figure, left_out, results)
    return figure


def save_figures(
    figures: Mapping[str, "matplotlib.figure.Figure"], folder: str | Path
) -> list[Path]:
    """Write each figure as `folder/<name>.png`, 150 dots per inch, and say where."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}.png")
        with _style():
            figure.savefig(paths[-1], dpi=150)
    return paths


def velocity_grid(velocity: np.ndarray, points: int = _GRID) -> np.ndarray:
    """Velocities (m/s) that at least half of the runs pass, rising.

    `velocity` has shape (runs, time), NaN after the end.
    """
    finite = np.isfinite(velocity)
    if not finite.any():
        return np.empty(0)
    slowest = np.where(finite, velocity, np.inf).min(axis=1)
    fastest = np.where(finite, velocity, -np.inf).max(axis=1)
    grid = np.linspace(slowest.min(), fastest.max(), points)
    passing = (slowest[:, None] <= grid) & (grid <= fastest[:, None])
    return grid[passing.sum(axis=0) >= len(velocity) / 2]


def at_velocity(
    velocity: np.ndarray, values: np.ndarray, grid: np.ndarray
) -> np.ndarray:
    """Each run's values where it first slows to each velocity of a rising grid.

    Linear between the samples, from the sample of highest velocity on. Shapes
    (runs, time) to (runs, grid); NaN where a run does not fly.
    """
    found = np.full((len(velocity), len(grid)), np.nan)
    for row, speeds, quantity in zip(found, velocity, values, strict=True):
        flying = np.isfinite(speeds) & np.isfinite(quantity)
        if not flying.any():
            continue
        speeds, quantity = speeds[flying], quantity[flying]
        peak = np.argmax(speeds)
        speeds, quantity = speeds[peak:], quantity[peak:]
        before = np.minimum.accumulate(np.concatenate([[np.inf], speeds[:-1]]))
        slower = speeds < before
        falling, there = speeds[slower][::-1], quantity[slower][::-1]
        row[:] = np.interp(grid, falling, there, left=np.nan, right=np.nan)
    return found


@contextlib.contextmanager
def _style():
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield


def _figure(
    width: float, height: float, panels: int, title: str
) -> tuple["matplotlib.figure.Figure", "list[matplotlib.axes.Axes]"]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.06, wspace=0.04)
    axes = list(figure.subplots(1, panels, squeeze=False).flat)
    if title:
        figure.suptitle(title, fontsize=11.0)
    return figure, axes


def _note(
    figure: "matplotlib.figure.Figure", left_out: int, runs: "xarray.Dataset"
) -> None:
    """Says below the figure how many runs it is without."""
    if left_out:
        text = f"{left_out} of {_count(runs)} not finite: left out"
        figure.supxlabel(text, x=0.99, ha="right", fontsize=8.0, color=MUTED)


def _count(runs: "xarray.Dataset") -> str:
    number = runs.sizes["run"]
    return "1 run" if number == 1 else f"{number} runs"


def _finite_runs(runs: "xarray.Dataset") -> tuple["xarray.Dataset", int]:
    """The runs that stayed finite to the end, and the number of others."""
    good = np.ones(runs.sizes["run"], dtype=bool)
    if "outcome" in runs:
        good &= runs["outcome"].values != int(Outcome.NOT_FINITE)
    for name in ("downrange_error", "crossrange_error", "altitude_error"):
        if name in runs:
            good &= np.isfinite(runs[name].values)
    return runs.isel(run=good), int((~good).sum())


def _draw_drag(axes, runs, nominal) -> None:
    axes.set_ylabel("Drag acceleration (m/s²)")
    _draw_against_velocity(axes, lambda flown: flown["drag"].values, runs, nominal)


def _draw_altitude(axes, runs, nominal) -> None:
    axes.set_ylabel("Altitude (km)")
    _draw_against_velocity(
        axes, lambda flown: flown["altitude"].values / km, runs, nominal
    )


def _draw_bank(axes, runs, nominal) -> None:
    from matplotlib.ticker import MultipleLocator

    def magnitude(flown):
        return np.abs(flown["bank_angle"].values) / degree

    axes.set_ylabel("Bank angle magnitude (deg)")
    _draw_against_time(axes, magnitude, runs, nominal)
    axes.yaxis.set_major_locator(MultipleLocator(30.0))


_HISTORIES = {"drag": _draw_drag, "altitude": _draw_altitude, "bank": _draw_bank}


def _draw_against_velocity(
    axes: "matplotlib.axes.Axes",
    quantity: _Quantity,
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset | None",
) -> None:
    """Bands at equal velocity, which falls to the left as time goes on."""
    velocity = runs["velocity"].values
    grid = velocity_grid(velocity)
    _draw_bands(axes, grid / km, at_velocity(velocity, quantity(runs), grid))
    if nominal is not None:
        _draw_nominal(axes, nominal["velocity"].values[0] / km, quantity, nominal)
    axes.set_xlabel("Velocity (km/s)")
    axes.set_title("← time", loc="right", color=MUTED)
    _finish(axes, _count(runs))


def _draw_against_time(
    axes: "matplotlib.axes.Axes",
    quantity: _Quantity,
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset | None",
) -> None:
    flying = np.isfinite(runs["velocity"].values)
    # Controls, unlike states, may have numbers after the end.
    values = np.where(flying, quantity(runs), np.nan)
    half = flying.sum(axis=0) >= max(len(flying), 1) / 2
    _draw_bands(axes, runs["time"].values[half], values[:, half])
    if nominal is not None:
        _draw_nominal(axes, nominal["time"].values, quantity, nominal)
    axes.set_xlabel("Time (s)")
    _finish(axes, _count(runs))


def _draw_nominal(
    axes: "matplotlib.axes.Axes",
    at: np.ndarray,
    quantity: _Quantity,
    nominal: "xarray.Dataset",
) -> None:
    flying = np.isfinite(nominal["velocity"].values[0])
    values = quantity(nominal)[0]
    axes.plot(at[flying], values[flying], color=NOMINAL, label="nominal", **_REFERENCE)


def _finish(axes: "matplotlib.axes.Axes", heading: str) -> None:
    """From zero on, with the number of runs above."""
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
    axes.set_title(heading, loc="left")


def _draw_bands(
    axes: "matplotlib.axes.Axes", grid: np.ndarray, values: np.ndarray
) -> None:
    """Percentiles over the runs of values (runs, grid); NaN where a run is not."""
    somewhere = np.isfinite(values).any(axis=0)
    if not somewhere.any():
        return
    grid, values = grid[somewhere], values[:, somewhere]
    for low, high, opacity in _SPREADS:
        lower, upper = np.nanpercentile(values, [low, high], axis=0)
        axes.fill_between(
            grid,
            lower,
            upper,
            color=RUNS,
            alpha=opacity,
            lw=0,
            label=f"{low:.0f}–{high:.0f} %",
        )
    axes.plot(grid, np.nanmedian(values, axis=0), color=RUNS, lw=1.8, label="median")


def _legend(axes: "matplotlib.axes.Axes") -> None:
    handles, _ = axes.get_legend_handles_labels()
    if not handles:
        return
    points = sum(len(scatter.get_offsets()) for scatter in axes.collections)
    place = "best" if points < _MANY_POINTS else "upper left"
    for handle in axes.legend(loc=place).legend_handles:
        if hasattr(handle, "set_sizes"):
            handle.set_sizes([24.0])


def _draw_downrange(axes: "matplotlib.axes.Axes", runs: "xarray.Dataset") -> None:
    """Histogram of the downrange error, with its mean and standard deviation."""
    errors = runs["downrange_error"].values / km
    axes.set_xlabel("Downrange error, actual − desired (km)")
    axes.set_ylabel("Runs")
    axes.grid(visible=False, axis="x")
    heading = [_count(runs)]
    if errors.size:
        axes.hist(errors, _bin_edges(errors), color=RUNS_LIGHT, ec="white", lw=0.6)
        axes.yaxis.get_major_locator().set_params(integer=True)
        heading += _mark_moments(axes, errors)
    axes.set_title(", ".join(heading), loc="left")


def _mark_moments(axes: "matplotlib.axes.Axes", errors: np.ndarray) -> list[str]:
    """Lines at the mean and a standard deviation about it, and both in words (km)."""
    mean = errors.mean()
    axes.axvline(mean, color=MEAN, lw=1.8)
    if errors.size == 1:
        return [f"mean {_number(mean, abs(mean), '+')} km"]
    deviation = np.std(errors, ddof=1)
    for side in (mean - deviation, mean + deviation):
        axes.axvline(side, color=MEAN, lw=1.1, ls=(0, (3, 2)))
    return [
        f"mean {_number(mean, deviation, '+')} km",
        f"std {_number(deviation, deviation)} km",
    ]


def _bin_edges(errors: np.ndarray) -> np.ndarray:
    """Of 40 bins at most; of 1 km about errors that are all equal."""
    if np.ptp(errors) < _FLAT:
        return np.mean(errors) + np.arange(-2.5, 3.0)
    bins = int(np.clip(np.sqrt(errors.size), 5, _MOST_BINS))
    return np.linspace(errors.min(), errors.max(), bins + 1)


def _number(value: float, scale: float, sign: str = "") -> str:
    """Three digits of a number of this scale, down to thousandths."""
    digits = np.clip(2 - np.floor(np.log10(max(scale, _FLAT))), 0, 3)
    return f"{value:{sign}.{digits:.0f}f}".replace("-", "−")


def _footprint(
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset | None",
    title: str,
) -> "matplotlib.figure.Figure":
    if not _spreads_across(runs):
        figure, (axes,) = _figure(6.4, 4.2, 1, title)
        _draw_footprint(axes, runs, nominal, "altitude")
        return figure
    figure, (left, right) = _figure(10.0, 4.2, 2, title)
    _draw_footprint(left, runs, nominal, "altitude")
    _draw_footprint(right, runs, nominal, "crossrange")
    right.get_legend().remove()
    right.set_title("", loc="left")
    return figure


def _spreads_across(runs: "xarray.Dataset") -> bool:
    if "crossrange_error" not in runs or runs.sizes["run"] == 0:
        return False
    return bool(np.std(runs["crossrange_error"].values) > _CROSSRANGE_SPREAD)


def _draw_footprint(
    axes: "matplotlib.axes.Axes",
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset | None",
    error: str,
) -> None:
    """Where the runs ended about the target, by the condition that ended them."""
    axes.axhline(0.0, color=MUTED, lw=0.8)
    axes.axvline(0.0, color=MUTED, lw=0.8)
    size = np.clip(4000.0 / max(runs.sizes["run"], 1), 3.0, 18.0)
    ends = _by_end(runs).items()
    for (label, ended), color in zip(ends, itertools.cycle(ENDS), strict=False):
        axes.scatter(
            runs["downrange_error"].values[ended] / km,
            runs[f"{error}_error"].values[ended] / km,
            s=size,
            color=color,
            alpha=0.6,
            lw=0,
            label=label,
        )
    if nominal is not None:
        axes.plot(
            nominal["downrange_error"].values / km,
            nominal[f"{error}_error"].values / km,
            "+",
            color=NOMINAL,
            ms=10,
            mew=1.6,
            label="nominal",
        )
    axes.set_xlabel("Downrange error (km)")
    axes.set_ylabel(f"{error.capitalize()} error (km)")
    axes.set_title(_count(runs), loc="left")
    _legend(axes)


def _by_end(runs: "xarray.Dataset") -> dict[str, np.ndarray]:
    """Which runs each end condition ended, by the legend's words."""
    if "ended_by" not in runs or "flag_meanings" not in runs["ended_by"].attrs:
        return {"runs": np.ones(runs.sizes["run"], dtype=bool)}
    codes = runs["ended_by"].values
    attributes = runs["ended_by"].attrs
    names = dict(
        zip(
            np.atleast_1d(attributes["flag_values"]),
            attributes["flag_meanings"].split(),
            strict=True,
        )
    )
    return {
        f"ended by {names[code].replace('_', ' ')}": codes == code
        for code in np.unique(codes)
    }
