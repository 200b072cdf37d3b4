"""The figure of the entry corridor has the limits and the flights."""

import dataclasses

import cheap
import numpy as np
import pytest
import xarray
from synthetic_runs import LABELS, line, synthetic

from jentry.motion.constraints import Drag, DynamicPressure, HeatLoad, LoadFactor
from jentry.plots import FigureData, campaign_figures


@pytest.fixture(scope="module")
def runs():
    return synthetic()


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
