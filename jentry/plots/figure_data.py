"""What the figures of a campaign are drawn of."""

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
    """Flown runs of a scenario, as a figure of a mission is given them.

    A figure is a function of this. It returns None where it lacks something, and is left
    out then:

        def velocity(data):
            figure, (axes,) = panelled(6.4, 4.2, 1, data.title)
            draw_end(axes, data.results["end_velocity"])
            return data.noted(figure)

        MISSION = Mission(..., figures={**USUAL, "velocity": velocity})
    """

    results: "xarray.Dataset"
    """All runs that are finite and have an end, as of `jentry.campaign.results.dataset`"""
    trajectories: "xarray.Dataset | None" = None
    """Some of these runs with histories, on (run, time), NaN after the end"""
    nominal: "xarray.Dataset | None" = None
    """The same of one flight, the nominal one"""
    scenario: Scenario | None = None
    """The nominal one"""
    title: str = ""
    """Above each figure"""
    lost: int = 0
    """Runs that are left out of the results"""
    lost_trajectories: int = 0
    """Runs that are left out of the trajectories"""

    @classmethod
    def of(
        cls,
        results: "xarray.Dataset",
        trajectories: "xarray.Dataset | None" = None,
        nominal: "xarray.Dataset | None" = None,
        scenario: Scenario | None = None,
        title: str = "",
    ) -> "FigureData":
        """Of stored results, as they are: runs without an end are left out and counted."""
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
        """A figure of the results, or of histories, that says how many runs it lacks."""
        if histories and self.trajectories is not None:
            note(figure, self.lost_trajectories, self.trajectories)
        else:
            note(figure, self.lost, self.results)
        return figure
