"""Figures of a campaign: bands over the runs, error histograms and footprints.

They do not use pyplot and its global state, and need no display.
"""

from .bands import at_velocity as at_velocity, velocity_grid as velocity_grid
from .campaign import (
    GLIDE as GLIDE,
    USUAL as USUAL,
    campaign_figures as campaign_figures,
    save_figures as save_figures,
)
from .figure_data import FigureData as FigureData
from .navigation import draw_navigation_errors as draw_navigation_errors
