"""The figures of glides to a target, and the units on their axes."""

import math

import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from synthetic_runs import described, figures_of, synthetic

from jentry.flight.termination import Outcome
from jentry.plots import GLIDE, glide


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
    assert set(figures) == set(GLIDE) - {
        "drag",
        "drag_deviation",
        "corridor",
        "navigation",
    }
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
