"""The figures of a campaign show all of its runs, with labels and units."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from synthetic_runs import (
    NOT_FINITE,
    RUNS,
    counts,
    described,
    figures_of,
    line,
    synthetic,
)

from jentry.flight.termination import Outcome
from jentry.plots import GLIDE, USUAL, save_figures
from jentry.plots.convergence import draw_course
from jentry.tuning.record import Entry
from jentry.tuning.tuning import Tuned


@pytest.fixture(scope="module")
def runs():
    return synthetic()


@pytest.fixture(scope="module")
def figures(runs):
    return figures_of(runs, runs, runs.isel(run=[0]), "A title")


def test_all_figures_with_their_labels(figures):
    axes = {name: figure.axes[0] for name, figure in figures.items()}
    labels = {name: (a.get_xlabel(), a.get_ylabel()) for name, a in axes.items()}
    assert labels == {
        "drag": ("Velocity (m/s)", "Drag (m/s²)"),
        "altitude": ("Velocity (m/s)", "Altitude (km)"),
        "drag_deviation": ("Velocity (m/s)", "Drag less nominal (m/s²)"),
        "bank": ("Time (s)", "Bank angle (deg)"),
        "downrange": ("Downrange error (km)", "Runs"),
        "footprint": ("Downrange error (km)", "Altitude error (km)"),
        "overview": ("Velocity (m/s)", "Drag less nominal (m/s²)"),
    }
    figures = {n: f for n, f in figures.items() if n != "overview"}
    for figure in figures.values():
        assert isinstance(figure, Figure)
        assert figure.get_suptitle() == "A title"
        assert len(figure.axes) == 1


def test_the_bank_is_that_of_runs_with_its_sign(runs, figures):
    """No percentiles: of what reverses they are those of no flight."""
    (axes,) = figures["bank"].axes
    assert not axes.collections
    *flown, nominal = axes.lines
    assert len(flown) == 24 and axes.get_title(loc="left") == "24 of 40 runs"
    for i, drawn in enumerate(flown):
        np.testing.assert_array_equal(drawn.get_xdata(), runs["time"].values)
        banks = np.degrees(runs["bank_angle"].values[i])
        assert np.nanmin(banks) < 0.0
        np.testing.assert_allclose(drawn.get_ydata(), banks)
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["runs", "nominal"]
    assert nominal.get_xdata()[-1] == 120.0


def test_histogram_counts_every_run_and_states_its_moments(runs, figures):
    (axes,) = figures["downrange"].axes
    assert sum(counts(axes)) == RUNS
    errors = runs["downrange_error"].values / 1e3
    mean, deviation = errors.mean(), errors.std(ddof=1)
    marked = sorted(line.get_xdata()[0] for line in axes.lines)
    assert marked == pytest.approx([mean - deviation, mean, mean + deviation])
    title = axes.get_title(loc="left")
    assert title == f"40 runs, mean {mean:+.2f} km, std {deviation:.2f} km"


def test_footprint_tells_the_end_conditions_apart(runs, figures):
    (axes,) = figures["footprint"].axes
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert texts == ["ended by velocity", "ended by altitude", "nominal"]
    shown = np.concatenate([c.get_offsets() for c in axes.collections])
    assert len(shown) == RUNS
    assert set(shown[:, 0]) == set(runs["downrange_error"].values / 1e3)


def test_crossrange_has_a_panel_when_it_spreads(runs):
    across = runs.assign(crossrange_error=("run", np.linspace(-5e3, 5e3, RUNS)))
    _, right = figures_of(described(across))["footprint"].axes
    assert right.get_ylabel() == "Crossrange error (km)"
    shown = np.concatenate([c.get_offsets() for c in right.collections])
    assert sorted(shown[:, 1]) == pytest.approx(np.linspace(-5.0, 5.0, RUNS))


def test_runs_that_are_not_finite_are_left_out_and_counted(runs):
    errors = runs["downrange_error"].values.copy()
    errors[:3] = [np.nan, np.inf, np.nan]
    outcome = runs["outcome"].values.copy()
    outcome[5:8] = [Outcome.NOT_FINITE, Outcome.SINGULAR, Outcome.BEGAN_BEYOND_END]
    lost = runs.assign(downrange_error=("run", errors), outcome=("run", outcome))
    figures = figures_of(lost, lost)  # and no nominal flight
    assert set(figures) == set(USUAL) - {"corridor", "drag_deviation", "navigation"}
    for name, figure in figures.items():
        assert (
            figure.get_supxlabel()
            == "6 of 40 runs not finite or without an end: left out"
        )
        heading = figure.axes[0].get_title(loc="left")
        assert heading.startswith("24 of 34 runs" if name == "bank" else "34 runs")
    assert sum(counts(figures["downrange"].axes[0])) == 34
    assert figures_of(runs)["downrange"].get_supxlabel() == ""


def test_without_trajectories_only_errors(runs):
    figures = figures_of(runs)
    assert list(figures) == ["downrange", "footprint", "overview"]
    histogram, footprint = figures["overview"].axes
    assert histogram.get_ylabel() == "Runs"
    assert footprint.get_ylabel() == "Altitude error (km)"


def test_overview_is_wide_and_names_the_bands_once(runs):
    figure = figures_of(runs, runs, runs.isel(run=[0]))["overview"]
    assert tuple(figure.get_size_inches()) == (11.0, 3.6)
    assert [axes.get_legend() is not None for axes in figure.axes] == [1, 0, 0]
    assert figure.axes[1].get_ylabel() == "Bank angle (deg)"
    assert sum(counts(figure.axes[2])) == RUNS


def nowhere(name):
    """Runs without a finite value of a variable."""
    runs = synthetic()
    return runs.assign({name: runs[name] * np.nan})


DEGENERATE = {
    "one run": synthetic(1),
    "equal errors": synthetic(spread=0.0),
    "no run finite": nowhere("downrange_error"),
    "no history finite": nowhere("velocity"),
}


@pytest.mark.parametrize("runs", DEGENERATE.values(), ids=DEGENERATE)
def test_degenerate_runs_are_drawn(runs, tmp_path):
    figures = figures_of(runs, runs, runs.isel(run=[0]))
    save_figures({"overview": figures["overview"]}, tmp_path)
    finite = np.isfinite(runs["downrange_error"].values).sum()
    assert sum(counts(figures["downrange"].axes[0])) == finite


def test_files_are_named_after_the_figures(runs, tmp_path):
    figures = figures_of(runs)
    paths = save_figures(figures, tmp_path / "new")
    assert [path.name for path in paths] == [f"{name}.png" for name in figures]
    for path in paths:
        assert path.read_bytes().startswith(b"\x89PNG")


def test_the_module_alone_loads_no_plotting():
    code = (
        "import sys, jentry.plots; assert not {'matplotlib', 'xarray'} & {*sys.modules}"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_nominal_end_is_marked_in_the_footprint(runs):
    nominal = runs.isel(run=[7])
    (axes,) = figures_of(runs, None, nominal)["footprint"].axes
    (marked,) = [line for line in axes.lines if line.get_label() == "nominal"]
    place = np.array(marked.get_data())[:, 0]
    expected = [runs[f"{n}_error"].values[7] / 1e3 for n in ("downrange", "altitude")]
    np.testing.assert_allclose(place, expected, rtol=1e-15)


def test_each_end_condition_has_the_runs_that_it_ended(runs):
    (axes,) = figures_of(runs)["footprint"].axes
    for scatter in axes.collections:
        which = {"ended by velocity": 0, "ended by altitude": 1}[scatter.get_label()]
        ended = runs["ended_by"].values == which
        expected = runs["altitude_error"].values[ended] / 1e3
        np.testing.assert_allclose(np.array(scatter.get_offsets())[:, 1], expected)


def test_figures_are_those_that_the_mission_asks_for(runs):
    """Whatever the results hold: nothing is guessed from the names of their variables."""
    ends = np.linspace(-1e-4, 1e-4, runs.sizes["run"])
    extra = {n: ("run", ends) for n in ("heading_error", "flight_path_angle_error")}
    extra |= {n: ("run", ends) for n in ("velocity_error", "miss_distance")}
    directed = runs.assign(extra)
    assert set(figures_of(directed)) == {"downrange", "footprint", "overview"}
    drawn = figures_of(directed, figures=GLIDE)
    assert set(drawn) == {"end_errors"}
    own = {"mine": lambda data: Figure(), "none": lambda data: None}
    assert set(figures_of(runs, figures=own)) == {"mine"}


def test_units_of_an_axis_are_those_of_the_results(runs):
    """Of a unit that jentry does not know, and of lengths that are all short."""
    other = runs.assign(downrange_error=runs["downrange_error"] * 0.0 + 2.5)
    other["drag"].attrs.update(units="ft/s2", long_name="deceleration")
    other["downrange_error"].attrs["units"] = "m"
    figures = figures_of(other, other)
    assert figures["drag"].axes[0].get_ylabel() == "Deceleration (ft/s²)"
    (axes,) = figures["footprint"].axes
    assert axes.get_xlabel() == "Downrange error (m)"
    shown = np.concatenate([c.get_offsets() for c in axes.collections])
    np.testing.assert_array_equal(shown[:, 0], 2.5)


def test_what_is_left_out_is_counted_where_it_is_left_out(runs):
    """Of the results by the figures of the ends, of the trajectories by their own."""
    lose = lambda n: runs.assign(outcome=("run", (np.arange(RUNS) < n) * NOT_FINITE))
    figures = figures_of(lose(3), lose(5), runs.isel(run=[0]))
    said = "{} of 40 runs not finite or without an end: left out"
    for name in ("downrange", "footprint", "overview"):
        assert figures[name].get_supxlabel() == said.format(3)
    for name in ("drag", "altitude", "bank"):
        assert figures[name].get_supxlabel() == said.format(5)


def test_the_nominal_flight_is_in_the_units_of_its_axes(runs, figures):
    nominal = runs.isel(run=0)
    flying = np.isfinite(nominal["velocity"].values)
    speed, altitude = line(figures["altitude"].axes[0], "nominal")
    np.testing.assert_allclose(speed, nominal["velocity"].values[flying])
    np.testing.assert_allclose(altitude, nominal["altitude"].values[flying] / 1e3)
    _, bank = line(figures["bank"].axes[0], "nominal")
    expected = np.degrees(nominal["bank_angle"].values[flying])
    np.testing.assert_allclose(bank, expected)


def point(loss, values, failed):
    entry = Entry.__new__(Entry)
    vars(entry).update(loss=loss, values=values, failed=failed)
    return entry


def test_the_course_of_tuning():
    """Losses as they were tried, and numbers as shares of the first ones."""
    losses = [4.0, 5.0, np.nan, 1.0, 0.5]  # the last one without a flight
    gains = [[2.0, 0.0], [3.0, 0.5], [3.0, 0.5], [1.0, -1.0], [4.0, 0.0]]
    course = [
        point(loss, {"a.gain": np.array(x[0]), "b": np.array(x)}, failed)
        for loss, x, failed in zip(losses, gains, (0, 0, 0, 0, 1), strict=True)
    ]
    tuned = Tuned.__new__(Tuned)  # of which nothing else is drawn
    vars(tuned).update(course=course, best=3, values=course[0].values)
    left, right = draw_course(tuned, "A title").axes
    tried, so_far, best = left.lines
    np.testing.assert_array_equal(tried.get_ydata(), losses)
    np.testing.assert_array_equal(so_far.get_ydata(), [4.0, 4.0, 4.0, 1.0, 1.0])
    assert (best.get_xdata(), best.get_ydata()) == (4, 1.0)
    assert left.get_yscale() == "log"
    drawn = {x.get_label(): x.get_ydata() for x in right.lines[:3]}
    np.testing.assert_array_equal(drawn["a.gain"], [1.0, 1.5, 1.5, 0.5, 2.0])
    np.testing.assert_array_equal(drawn["b[0]"], drawn["a.gain"])
    np.testing.assert_array_equal(drawn["b[1], change"], [0.0, 0.5, 0.5, -1.0, 0.0])
