"""Data from which the figures of a campaign are drawn."""

import dataclasses
from typing import TYPE_CHECKING

from ..campaign.populations import finite_flights
from ..flight.scenario import Scenario
from .style import note


if TYPE_CHECKING:
    import matplotlib.figure
    import xarray


@dataclasses.dataclass(frozen=True)
class FigureData:
    """Runs of a scenario, as the argument of a function that draws a figure of a mission.

    The function returns None if data are missing. The figure is then left out:

        def velocity(data):
            figure, (axes,) = panelled(6.4, 4.2, 1, data.title)
            draw_end(axes, data.results["end_velocity"])
            return data.noted(figure)

        MISSION = Mission(..., figures={**USUAL, "velocity": velocity})
    """

    results: "xarray.Dataset"
    """All runs that are finite and have an end, from `jentry.campaign.results.dataset`"""
    trajectories: "xarray.Dataset | None" = None
    """Some of these runs with histories, on (run, time), NaN after the end"""
    nominal: "xarray.Dataset | None" = None
    """The nominal flight with its history, as one run"""
    scenario: Scenario | None = None
    """Nominal scenario"""
    title: str = ""
    """Title of each figure"""
    lost: int = 0
    """Number of runs that are left out of the results"""
    lost_trajectories: int = 0
    """Number of runs that are left out of the trajectories"""

    @classmethod
    def of(
        cls,
        results: "xarray.Dataset",
        trajectories: "xarray.Dataset | None" = None,
        nominal: "xarray.Dataset | None" = None,
        scenario: Scenario | None = None,
        title: str = "",
    ) -> "FigureData":
        """Data from stored results. Runs without an end are left out and counted."""
        ends = finite_flights(results)
        lost = results.sizes["run"] - ends.sizes["run"]
        if trajectories is None:
            return cls(ends, None, nominal, scenario, title, lost)
        kept = finite_flights(trajectories)
        gone = trajectories.sizes["run"] - kept.sizes["run"]
        return cls(ends, kept, nominal, scenario, title, lost, gone)

    def noted(
        self, figure: "matplotlib.figure.Figure", histories: bool = False
    ) -> "matplotlib.figure.Figure":
        """The figure with a note of how many runs were left out of results or histories."""
        if histories and self.trajectories is not None:
            note(figure, self.lost_trajectories, self.trajectories)
        else:
            note(figure, self.lost, self.results)
        return figure
