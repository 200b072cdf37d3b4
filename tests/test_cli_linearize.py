"""`jentry linearize`: frozen eigenvalues as a table, a figure and numbers."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
from commands import Arrived, assert_refused, intercepted

from jentry.analysis.frozen_loop import FrozenLoop
from jentry.cli.linearization_report import print_loop, write_loop
from jentry.flight import FixedStep
from jentry.missions import find_mission
from jentry.missions.choice import Choice
from jentry.motion.index import AltitudeIndex, DownrangeIndex


NAN = complex(np.nan, np.nan)
SLOW = np.full((2, 3), -1e-4 + 0j)


def loop() -> FrozenLoop:
    """Two points, a pair and a deadbeat eigenvalue, and a zero that comes and goes."""
    return FrozenLoop(
        over="altitude",
        unit="m",
        index=np.array([60e3, 20e3]),
        time=np.array([0.0, 100.0]),
        span=50e3,
        coordinates=("e1", "e1'", "held.command.angle_of_attack"),
        eliminated="altitude",
        ignorable=("longitude",),
        forgotten=("held.command.cos_bank",),
        matrices=np.arange(18.0).reshape(2, 3, 3) / 3.0,
        multipliers=np.full((2, 3), 0.5 + 0.0j),
        eigenvalues=np.array(
            [[-2e-4 + 1e-4j, -2e-4 - 1e-4j, -np.inf], [-1e-4, 6e-5, -4e-4]]
        ),
        zeros=np.array([[3e-4, -3e-4], [NAN, NAN]]),
        without_zeros="",
        ended_by="ground",
    )


def test_every_option_of_linearize_arrives(command, monkeypatch, tmp_path):
    seen = intercepted(monkeypatch, "jentry.analysis.frozen_loop", "linearize")
    changed = ("--set", "vehicle.mass=900", "--law", "steep", "--step", 2)
    with pytest.raises(Arrived):
        command("linearize", "cheap", "--over", "altitude", "--points", 7, *changed)
    scenario, index, points = seen["given"]
    assert isinstance(index, AltitudeIndex) and points == 7
    assert seen["solver"] == FixedStep(2.0)
    assert float(scenario.vehicle.mass) == 900.0
    config = tmp_path / "changes.toml"
    config.write_text('[set]\n"vehicle.mass" = 800.0\n')
    with pytest.raises(Arrived):
        command("linearize", "cheap", "--over", "downrange", "--config", config)
    scenario, index, points = seen["given"]
    assert isinstance(index, DownrangeIndex) and points == 20
    assert float(scenario.vehicle.mass) == 800.0
    assert index.origin is scenario.target.origin


def test_linearize_refuses_what_is_no_figure_or_index(command):
    result = command("linearize", "cheap", "--out", "loop.pdf")
    assert_refused(result, "out is 'loop.pdf': it must be the name of a PNG")
    code, _, said = command("linearize", "cheap", "--over", "range")
    assert code == 2 and "range" in said
    result = command("linearize", "cheap", "--faster-than", "nan")
    assert_refused(result, "--faster-than is nan: it must not be negative")
    result = command("linearize", "cheap", "--points", 0)
    assert_refused(result, "points is 0: it must be 1 or more")


def test_the_table_has_rates_per_span_at_the_units_of_the_edge(capsys):
    print_loop(find_mission("sx-2"), loop())
    printed = capsys.readouterr().out
    first, second = (line for line in printed.splitlines() if line.startswith("│"))
    for cell in ("60", "0.0", "-10", "0.894", "deadbeat", "-10±5i", "-15  15"):
        assert cell in first.replace("│", " "), first
    for cell in ("20", "100.0", "3", "-1.000", "-20  -5  3", "none"):
        assert cell in second.replace("│", " "), second
    assert "at equal altitude, rates per 50 km passed" in printed
    assert "nothing depends on them: longitude" in printed
    assert "replaces them, which is deadbeat: held.command.cos_bank" in printed
    assert "largest real part 3, at altitude 20 km, 100.0 s after" in printed
    assert "least damping -1.000, at altitude 20 km" in printed
    assert "inf" not in printed and "nan" not in printed


def test_the_damping_is_of_the_modes_that_count(capsys):
    """Of the four that are not deadbeat the aperiodic one of the second point is faster."""
    print_loop(find_mission("sx-2"), loop(), 3e-4)
    printed = capsys.readouterr().out
    first, second = (line for line in printed.splitlines() if line.startswith("│"))
    assert "1.000" in first and "0.894" not in first
    assert "1.000" in second and "-1.000" not in second
    assert "least damping of eigenvalues beyond 0.0003 1/m 1.000, at alt" in printed
    print_loop(find_mission("sx-2"), dataclasses.replace(loop(), eigenvalues=SLOW), 1.0)
    printed = capsys.readouterr().out
    assert "least damping of eigenvalues beyond 1 1/m: there are none" in printed
    first, _ = (line for line in printed.splitlines() if line.startswith("│"))
    assert first.split("│")[4].strip() == "-"


def test_the_figure_and_every_number_are_written(tmp_path):
    given = loop()
    figure, numbers = write_loop(
        tmp_path / "loop.png", find_mission("sx-2"), Choice("full"), given
    )
    assert figure.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    told = json.loads(numbers.read_text())
    assert told["mission"] == "sx-2" and told["law"] == "full"
    assert np.array(told["matrices"]).tolist() == given.matrices.tolist()
    assert told["index"] == given.index.tolist() and told["span"] == given.span
    assert told["eigenvalues"][0] == [[-2e-4, 1e-4], [-2e-4, -1e-4], None]
    assert told["zeros"] == [[[3e-4, 0.0], [-3e-4, 0.0]], [None, None]]
    assert told["coordinates"] == list(given.coordinates)


def test_the_figure_draws_parts_over_the_index_as_time_goes_on():
    from jentry.plots.eigenvalues import draw_eigenvalues

    real, imaginary = draw_eigenvalues(loop(), "title").axes
    assert real.xaxis_inverted() and imaginary.xaxis_inverted()
    assert real.get_xlabel() == "Altitude (km)"
    dots = [line for line in real.lines if line.get_marker() == "."]
    drawn = np.stack([line.get_ydata() for line in dots], axis=1)
    np.testing.assert_allclose(drawn, [[-10.0, -10.0, np.nan], [-5.0, 3.0, -20.0]])
    np.testing.assert_allclose(dots[0].get_xdata(), [60.0, 20.0])
    dots = [line for line in imaginary.lines if line.get_marker() == "."]
    drawn = np.stack([line.get_ydata() for line in dots], axis=1)
    np.testing.assert_allclose(drawn, [[5.0, -5.0, np.nan], [0.0, 0.0, 0.0]])
    crosses = [line for line in real.lines if line.get_marker() == "x"]
    drawn = np.stack([line.get_ydata() for line in crosses], axis=1)
    np.testing.assert_allclose(drawn, [[15.0, -15.0], [np.nan, np.nan]])
    assert "1 deadbeat" in imaginary.get_title(loc="left")


def test_the_legend_stands_below_the_axes_and_over_nothing():
    from jentry.plots.eigenvalues import draw_eigenvalues

    figure = draw_eigenvalues(loop(), "title")
    figure.draw_without_rendering()
    (legend,) = figure.legends
    for axes in figure.axes:
        assert axes.xaxis.label.get_window_extent().y0 > legend.get_window_extent().y1


@pytest.mark.slow
def test_linearize_as_a_process(tmp_path):
    def run(*words):
        call = [sys.executable, "-m", "jentry", "linearize", *words]
        return subprocess.run(call, capture_output=True, text=True, cwd=tmp_path)

    mission = ("mars-drag-tracking", "--law", "state-feedback")
    done = run(*mission, "--over", "energy", "--points", "3", "--out", "loop.png")
    assert (done.returncode, done.stderr) == (0, "")
    assert "closed loop at equal energy" in done.stdout
    assert "deviations: e1, e1'" in done.stdout
    told = json.loads((tmp_path / "loop.json").read_text())
    assert len(told["index"]) == 3 and (tmp_path / "loop.png").stat().st_size > 1000
    turned = run(*mission, "--over", "velocity")
    assert turned.returncode == 2 and turned.stdout == ""
    assert "VelocityIndex stands still or turns" in turned.stderr
