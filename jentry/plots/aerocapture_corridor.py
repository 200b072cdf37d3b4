"""The entry corridor of an aerocapture: the two flights at its limits."""

from typing import TYPE_CHECKING

import numpy as np

from ..flight.flight import Flight
from ..planning.aerocapture_corridor import CaptureCorridor
from ..units import degree, km
from .style import ENDS, MUTED, in_style, legend, panelled


if TYPE_CHECKING:
    import matplotlib.figure


LIFT = {"shallow": "lift down", "steep": "lift up"}
"""Direction of the lift of the flight at each limit"""


def draw_corridor(
    corridor: CaptureCorridor, flights: dict[str, Flight], title: str = ""
) -> "matplotlib.figure.Figure":
    """Altitude over velocity of the two flights at the limits, which need histories."""
    with in_style():
        figure, (axes,) = panelled(6.4, 4.6, 1, title)
        for (name, flight), colour in zip(flights.items(), ENDS, strict=False):
            history = flight.history
            assert history is not None
            flown = np.isfinite(np.asarray(history.time))
            velocity = np.asarray(history.states.velocity)[flown]
            altitude = np.asarray(history.states.altitude)[flown]
            velocity = np.append(velocity, float(flight.state.velocity)) / km
            altitude = np.append(altitude, float(flight.state.altitude)) / km
            angle = float(getattr(corridor, name)) / degree
            label = f"{name} limit, {angle:.3f} deg, {LIFT[name]}"
            axes.plot(velocity, altitude, color=colour, lw=1.4, label=label)
        axes.invert_xaxis()
        axes.set_xlabel("Velocity (km/s)")
        axes.set_ylabel("Altitude (km)")
        width = float(corridor.width) / degree
        axes.set_title(f"{width:.3f} deg wide", loc="left")
        axes.set_title("time \N{RIGHTWARDS ARROW}", loc="right", color=MUTED)
        legend(axes)
    return figure
