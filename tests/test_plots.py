"""Figures show what the runs hold; synthetic runs, nothing is flown."""

import dataclasses
import math
import subprocess
import sys

import cheap
import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure

from jentry._printed import in_words
from jentry.campaign.outputs import error_of
from jentry.fields import units_of
from jentry.flight import Flight, Misses
from jentry.flight.termination import Outcome
from jentry.motion import Controls, EntryState
from jentry.motion.constraints import (
    Drag,
    DynamicPressure,
    HeatLoad,
    LoadFactor,
    usual_constraints,
)
from jentry.plots import (
    GLIDE,
    USUAL,
    FigureData,
    at_velocity,
    campaign_figures,
    glide,
    save_figures,
    velocity_grid,
)
from jentry.plots.bands import percentiles
from jentry.plots.convergence import draw_course
from jentry.tuning.record import Entry
from jentry.tuning.tuning import Tuned


RUNS, TIMES = 40, 61
NOT_FINITE = int(Outcome.NOT_FINITE)
LABELS = ["5–95 %", "25–75 %", "median", "nominal"]


UNITS = units_of(EntryState) | units_of(Controls) | {"time": units_of(Flight)["time"]}
UNITS |= {error_of(name): unit for name, unit in units_of(Misses).items()}
UNITS |= {name: each.unit for name, each in usual_constraints().items()}


def described(results):
    """Runs with the attributes that results have."""
    usual = usual_constraints()
    for name, variable in results.variables.items():
        if name in UNITS:
            variable.attrs["units"] = UNITS[name]
            variable.attrs["long_name"] = in_words(name)
        if name in usual and usual[name].shown_unit is not None:
            variable.attrs["shown_units"] = usual[name].shown_unit
    return results


def figures_of(results, trajectories=None, nominal=None, title="", figures=USUAL):
    data = FigureData.of(results, trajectories, nominal, None, title)
    return campaign_figures(data, figures)


def synthetic(runs=RUNS, spread=1.0):
    """Runs that slow from 6 km/s, each with drag and bank linear in velocity.

    Later runs stop earlier: run i flies 61 - i // 4 samples.
    """
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 120.0, TIMES)
    velocity = np.tile(6000.0 - 45.0 * time, (runs, 1))
    samples = TIMES - np.arange(runs) // 4
    velocity[np.arange(TIMES) >= samples[:, None]] = np.nan
    slope = 0.01 + spread * rng.uniform(0.0, 0.01, (runs, 1))
    both = ("run", "time")
    results = xarray.Dataset(
        {
            "velocity": (both, velocity),
            "drag": (both, slope * velocity),
            "altitude": (both, 10.0 * velocity + 1e6 * slope),
            "bank_angle": (both, np.where(np.isnan(velocity), np.nan, -50.0 * slope)),
            "downrange_error": ("run", spread * rng.normal(2e3, 5e3, runs)),
            "crossrange_error": ("run", np.zeros(runs)),
            "altitude_error": ("run", spread * rng.normal(0.0, 800.0, runs)),
            "outcome": ("run", np.zeros(runs, dtype=np.int8)),
            "ended_by": (
                "run",
                (np.arange(runs) % 2).astype(np.int8),
                {
                    "flag_values": np.arange(3, dtype=np.int8),
                    "flag_meanings": "velocity altitude skip_out",
                },
            ),
        },
        {"time": time, "run": np.arange(runs)},
    )
    return described(results)


@pytest.fixture(scope="module")
def runs():
    return synthetic()


@pytest.fixture(scope="module")
def figures(runs):
    return figures_of(runs, runs, runs.isel(run=[0]), "A title")


def line(axes, label):
    (found,) = [line for line in axes.lines if line.get_label() == label]
    return found.get_data()


def band(axes, label):
    """Lower and upper edge of a band over its grid."""
    (found,) = [c for c in axes.collections if c.get_label() == label]
    outline = found.get_paths()[0].vertices
    grid = np.unique(outline[:, 0])
    edges = [outline[outline[:, 0] == at, 1] for at in grid]
    return grid, np.array([(edge.min(), edge.max()) for edge in edges]).T


def counts(axes):
    return [bar.get_height() for bar in axes.patches]


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


@pytest.mark.parametrize("name", ["drag", "altitude", "drag_deviation"])
def test_histories_have_two_bands_a_median_and_the_nominal(figures, name):
    (axes,) = figures[name].axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == LABELS
    assert len(axes.lines) == 2
    assert axes.get_title(loc="left") == "40 runs"


def test_percentiles_are_those_of_numpy():
    random = np.random.default_rng(5)
    values = random.normal(size=(37, 60))
    values[random.uniform(size=values.shape) < 0.3] = np.nan
    values[1:, 7], values[0, 7] = np.nan, 3.0
    which = [0.0, 5.0, 33.3, 50.0, 100.0]
    expected = np.nanpercentile(values, which, axis=0)
    # Both interpolate between the same two numbers, of order one, from either of them.
    np.testing.assert_allclose(percentiles(values, which), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "factor"), [("drag", 1.0), ("altitude", 1e-3)], ids=str
)
def test_bands_are_percentiles_at_equal_velocity(runs, figures, name, factor):
    """The quantities are linear in velocity: interpolation is exact to rounding."""
    (axes,) = figures[name].axes
    grid, (low, high) = band(axes, "5–95 %")
    at = np.searchsorted(grid, 5000.0)
    slope = runs["drag"].values[:, 0] / 6000.0
    value = slope if name == "drag" else 10.0
    offset = 0.0 if name == "drag" else 1e6 * slope
    exact = factor * (value * grid[at] + offset)
    assert [low[at], high[at]] == pytest.approx(np.percentile(exact, [5, 95]), rel=1e-9)
    speeds, median = line(axes, "median")
    there = np.argmin(abs(speeds - grid[at]))
    assert median[there] == pytest.approx(np.median(exact), rel=1e-9)


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


def test_values_at_equal_velocity_between_samples():
    """The cubic is of fourth order, the linear interpolant of second."""
    grid = np.linspace(1010.0, 5990.0, 77)
    drag = lambda v: np.exp(v / 500.0)
    errors = []
    for samples in (51, 101):
        velocity = np.linspace(6000.0, 1000.0, samples)[None]
        found = [
            at_velocity(velocity, drag(velocity), grid, cubic=cubic)
            for cubic in (False, True)
        ]
        errors.append([np.max(np.abs(x[0] - drag(grid))[3:-3]) for x in found])
    (linear, cubic), (linear_half, cubic_half) = errors
    assert 3.0 < linear / linear_half < 5.0 and 10.0 < cubic / cubic_half < 25.0
    assert np.isnan(
        at_velocity(velocity, velocity, np.array([999.0]), cubic=True)
    ).all()


@pytest.mark.parametrize("samples", [2, 3, 4, 9])
def test_cubics_of_uneven_samples_are_exact_to_their_degree(samples):
    """At the samples and between them; with fewer than four of them it is of less."""
    velocity = np.cumsum([7.0, 1.0, 2.0, 0.3, 4.0, 1.0, 0.7, 3.0, 2.0][:samples])
    quantity = lambda v: 2.0 - v + 0.3 * v ** min(samples - 1, 3)
    grid = np.append(velocity, np.linspace(7.0, velocity[-1], 50))
    falling = velocity[None, ::-1]
    found = at_velocity(falling, quantity(falling), grid, cubic=True)
    assert found[0] == pytest.approx(quantity(grid), rel=1e-12)
    beyond = np.array([6.99, velocity[-1] + 0.01])
    assert np.isnan(at_velocity(falling, falling, beyond, cubic=True)).all()


def test_the_deviation_of_the_drag_is_from_the_nominal_flight(runs, figures):
    """Drag is linear in velocity: so are differences, to rounding."""
    (axes,) = figures["drag_deviation"].axes
    grid, (low, high) = band(axes, "5–95 %")
    slope = runs["drag"].values[:, 0] / 6000.0
    at = np.searchsorted(grid, 5000.0)
    exact = (slope - slope[0]) * grid[at]  # the nominal flight is the first of them
    expected = pytest.approx(np.percentile(exact, [5, 95]), rel=1e-9)
    assert [low[at], high[at]] == expected


def test_velocity_grid_is_where_half_of_the_runs_fly(runs):
    grid = velocity_grid(runs["velocity"].values)
    # Half of the runs reach the 57th sample.
    slowest = runs["velocity"].values[0, 56]
    step = np.diff(grid).max()
    assert slowest <= grid[0] < slowest + step
    assert grid[-1] == 6000.0


def test_velocity_that_rises_first_is_taken_from_its_peak():
    velocity = np.array([[5.0, 7.0, 6.0, 6.5, 4.0, np.nan]])
    values = np.array([[0.0, 1.0, 2.0, 3.0, 4.0, 9.0]])
    found = at_velocity(velocity, values, np.array([3.0, 4.0, 5.0, 6.5, 7.0, 8.0]))
    assert np.allclose(found, [[np.nan, 4.0, 3.0, 1.5, 1.0, np.nan]], equal_nan=True)


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
    assert set(figures) == set(USUAL) - {"corridor", "drag_deviation"}
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


# Glides to a target with a direction.


@pytest.fixture
def glides():
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 50.0, 10.0)
    both = ("run", "time")
    names = (*glide.STATES, *glide.CONTROLS, *glide.CONSTRAINTS)
    histories = {n: (both, rng.uniform(1.0, 2.0, (6, 5))) for n in names}
    errors = ("velocity_error", "flight_path_angle_error", "heading_error")
    ends = {n: ("run", rng.normal(0.0, 1.0, 6)) for n in (*errors, "miss_distance")}
    results = xarray.Dataset(histories | ends, {"run": np.arange(6), "time": time})
    return described(results.assign(outcome=("run", np.zeros(6, dtype=np.int8))))


def test_every_run_is_drawn_over_time_under_its_limit(glides):
    glides["heat_rate"].attrs["limit"] = 1.5
    figure = glide.over_time(glides, glide.CONSTRAINTS)
    heat, pressure, load = figure.axes
    assert heat.get_ylabel() == "Heat rate (W/cm²)"
    assert len(heat.lines) == 7 and len(pressure.lines) == len(load.lines) == 6
    np.testing.assert_allclose(heat.lines[6].get_ydata(), 1.5e-4)
    drawn = np.array([line.get_ydata() for line in load.lines])
    np.testing.assert_array_equal(drawn, glides["load_factor"].values)


SI = {"km": 1e3, "m": 1.0, "m/s": 1.0, "deg": math.pi / 180.0}
SI |= {"W/cm²": 1e4, "kPa": 1e3, "g": 1.0, "s": 1.0}
"""SI value of each unit on an axis; load factors are counted in g"""


def unit(label):
    """SI value of the unit that a label ends in, such as 1e-3 m."""
    power, _, name = label.rstrip(")").rsplit(" (", 1)[1].rpartition(" ")
    return float(power or 1.0) * SI[name]


@pytest.mark.parametrize("names", [glide.STATES, glide.CONTROLS, glide.CONSTRAINTS])
def test_every_panel_shows_its_quantity_in_the_unit_that_it_names(glides, names):
    """Of sizes that no other unit on the figure would have."""
    figure = glide.over_time(glides, names)
    for axes, name in zip(figure.axes, names, strict=True):
        words, _ = axes.get_ylabel().rsplit(" (", 1)
        hyphened = {"flight_path_angle": "Flight-path angle"}
        assert words == hyphened.get(name, name.replace("_", " ").capitalize())
        assert unit(axes.get_xlabel()) == 1.0
        drawn = np.array([line.get_ydata() for line in axes.lines])
        np.testing.assert_allclose(drawn * unit(axes.get_ylabel()), glides[name].values)
        times = np.array([line.get_xdata() for line in axes.lines])
        assert np.array_equal(times, np.tile(glides["time"].values, (6, 1)))


@pytest.mark.parametrize("size", [1.0, 1e-5], ids=["large", "small"])
def test_errors_at_the_end_are_in_the_unit_that_they_name(glides, size):
    """The histogram reaches from the least error to the largest."""
    names = (
        "miss_distance",
        "flight_path_angle_error",
        "heading_error",
        "velocity_error",
    )
    results = glides.map(lambda values: size * values)
    figure = glide.end_errors(results)
    for axes, name in zip(figure.axes, names, strict=True):
        edges = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches]
        reach = unit(axes.get_xlabel()) * np.array([edges[0][0], edges[-1][1]])
        values = results[name].values
        np.testing.assert_allclose(reach, [values.min(), values.max()])
        # Small ones in a power of ten that makes them readable.
        assert 1e-2 <= np.max(np.abs(edges)) < 1e3


def test_velocity_errors_of_campaigns_with_their_means(glides):
    figure = glide.velocity_errors({"one": glides, "other": glides})
    (axes,) = figure.axes
    mean = np.mean(np.abs(glides["velocity_error"].values))
    assert axes.lines[0].get_label() == f"one: mean {mean:.3g} m/s"
    np.testing.assert_array_equal(
        axes.lines[1].get_ydata(), glides["velocity_error"].values
    )


def test_errors_at_the_end_count_every_run(glides):
    figure = glide.end_errors(glides)
    for axes in figure.axes:
        assert sum(patch.get_height() for patch in axes.patches) == 6
    assert "deg" in figure.axes[1].get_xlabel()


def test_glides_that_are_not_finite_are_left_out_and_counted(glides):
    outcome = np.full(6, Outcome.REACHED)
    outcome[4] = Outcome.NOT_FINITE
    ended_by = synthetic(6)["ended_by"]
    peaks = {f"peak_{n}": ("run", np.ones(6)) for n in glide.CONSTRAINTS}
    lost = glides.assign(outcome=("run", outcome), ended_by=ended_by, **peaks)
    figures = figures_of(lost, lost, figures=GLIDE)
    assert set(figures) == set(GLIDE) - {"drag", "drag_deviation", "corridor"}
    for figure in figures.values():
        said = "1 of 6 runs not finite or without an end: left out"
        assert figure.get_supxlabel() == said
    assert all(len(axes.lines) == 5 for axes in figures["states"].axes)


def test_velocity_map_has_the_wanted_velocity():
    k1, k2 = np.linspace(0.6, 1.0, 5), np.linspace(0.5, 0.9, 4)
    velocity = 2000.0 + 1000.0 * k1[:, None] - 500.0 * k2[None, :]
    figure = glide.draw_velocity_map(k1, k2, velocity, 2450.0)
    assert figure.axes[0].get_xlabel() == "$k_1$"
    filled, wanted = figure.axes[0].collections
    # The line lies where the velocity is the wanted one: it is linear in both.
    places = np.concatenate([path.vertices for path in wanted.get_paths()])
    assert len(places) > 3 and np.ptp(places[:, 1]) > 0.3
    np.testing.assert_allclose(1000.0 * places[:, 0] - 500.0 * places[:, 1], 450.0)
    assert filled.get_array().min() == pytest.approx(velocity.min(), abs=30.0)


def test_prediction_errors_are_means_over_the_way_to_go():
    to_go = np.repeat(np.linspace(1e5, 6e6, 24), 10)
    error = np.where(np.arange(240) % 2, 2.0, -4.0)
    figure = glide.prediction_errors(to_go, {"a network": error})
    (line,) = figure.axes[0].lines
    np.testing.assert_allclose(line.get_ydata(), 3.0)
    # 24 bins from zero on, drawn at their middles in km.
    np.testing.assert_allclose(line.get_xdata(), 250.0 * (np.arange(24) + 0.5))


def test_small_errors_are_shown_in_powers_of_ten():
    axes = Figure().subplots()
    values = np.array([-4.2e-5, 1e-5, 2e-5])
    glide.draw_errors(axes, values, "Heading error (deg)")
    assert axes.get_xlabel() == "Heading error (1e-5 deg)"
    edges = [axes.patches[0].get_x(), axes.patches[-1].get_x()]
    assert edges[0] == pytest.approx(-4.2)
    assert edges[1] + axes.patches[-1].get_width() == pytest.approx(2.0)
    large = Figure().subplots()
    glide.draw_errors(large, 1e3 * values, "Velocity error (m/s)")
    assert large.get_xlabel() == "Velocity error (m/s)"
    assert large.patches[0].get_x() == pytest.approx(-0.042)


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


# The entry corridor.


LIMITED = {
    "dynamic_pressure": DynamicPressure(9e3),
    "load_factor": LoadFactor(10.0),
    "heat_load": HeatLoad(1e8),
    "drag": Drag(),
}


@pytest.fixture(scope="module")
def corridor_data(runs):
    angle = xarray.full_like(runs["velocity"], 0.0) + 0.0 * runs["velocity"]
    runs = runs.assign(angle_of_attack=angle)
    scenario = dataclasses.replace(cheap.scenario(), constraints=LIMITED)
    return FigureData.of(runs, runs, runs.isel(run=[0]), scenario, "A title")


def test_the_corridor_has_the_limits_and_the_flights(corridor_data):
    """Each limit where the exponential air of Mars has it; the load by drag and lift."""
    figure = campaign_figures(corridor_data)["corridor"]
    altitude, drag = figure.axes
    assert altitude.get_ylabel() == "Altitude (km)"
    assert drag.get_ylabel() == "Drag (m/s²)"
    labels = ["dynamic pressure, 9 kPa", "load factor, 10 g"]
    for axes in figure.axes:
        shown = [text.get_text() for text in axes.get_legend().get_texts()]
        assert shown == [*LABELS, *labels]
    ballistic, lift_to_drag = 115.0, 0.18  # kg/m2
    at_limit = (
        9e3 / ballistic,
        10.0 * 9.80665 / np.sqrt(1.0 + lift_to_drag**2),
    )
    for label, expected in zip(labels, at_limit, strict=True):
        speed, found = line(drag, label)
        assert (np.min(speed), np.max(speed)) == (600.0, 6000.0)
        density = 2.0 * ballistic * expected / speed**2
        height = 9354.5 * np.log(0.0158 / density)
        above = height > 0.0  # else it is met at no altitude
        assert 30 < np.sum(above) < 79 and not np.isfinite(found[~above]).any()
        np.testing.assert_allclose(found[above], expected, rtol=1e-9)
        at, found = line(altitude, label)
        np.testing.assert_array_equal(at, speed)
        np.testing.assert_allclose(found[above], height[above] / 1e3, rtol=1e-8)
    # The nearest limit is always to be seen.
    assert drag.get_ylim()[1] > min(at_limit)


def test_without_a_limit_there_is_no_corridor(corridor_data):
    free = dataclasses.replace(corridor_data.scenario, constraints={"drag": Drag()})
    for lacking in ({"scenario": free}, {"scenario": None}, {"trajectories": None}):
        data = dataclasses.replace(corridor_data, **lacking)
        assert "corridor" not in campaign_figures(data)


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
