"""Where flights end about their target: circular errors, and the ellipse of the misses."""

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..campaign.outputs import error_of
from .intervals import Interval, percentile_interval


if TYPE_CHECKING:
    import xarray


ALONG, ACROSS = map(error_of, ("downrange", "crossrange"))

_LEAST_SPREAD = 1.0
"""m, below which there is nothing across to speak of: a flight in a plane"""


@dataclasses.dataclass(frozen=True)
class MissEllipse:
    """The misses of a campaign over the ground: downrange and crossrange errors.

    The ellipse is that of a normal distribution with the mean and the covariance of the
    runs. How much of the runs it holds is counted beside it.
    """

    mean: tuple[float, float]
    """Downrange and crossrange, m"""
    semi_axes: tuple[float, float]
    """Standard deviations along the axes of the ellipse, the larger one first, m"""
    angle: float
    """Of the larger axis from downrange towards positive crossrange, rad, in (-pi/2,
    pi/2]"""
    radii: dict[float, Interval]
    """Radius about the target (m) that a percentage of the runs is within, by it; that of
    50 is the circular error probable"""
    inside: dict[float, float]
    """Share of the runs in the ellipse that holds a percentage of a normal distribution"""

    def scale(self, percentage: float) -> float:
        """How many standard deviations the ellipse of a percentage reaches."""
        return math.sqrt(-2.0 * math.log1p(-percentage / 100.0))

    def outline(self, percentage: float, points: int = 181) -> np.ndarray:
        """Downrange and crossrange (m) around the ellipse of a percentage, (2, points)."""
        around = np.linspace(0.0, 2.0 * np.pi, points)
        major, minor = (self.scale(percentage) * axis for axis in self.semi_axes)
        cosine, sine = math.cos(self.angle), math.sin(self.angle)
        x, y = major * np.cos(around), minor * np.sin(around)
        along = self.mean[0] + cosine * x - sine * y
        return np.stack([along, self.mean[1] + sine * x + cosine * y])

    def plain(self) -> dict[str, Any]:
        """As plain values, SI."""
        return {
            "mean_downrange_error": self.mean[0],
            "mean_crossrange_error": self.mean[1],
            "semi_major_axis": self.semi_axes[0],
            "semi_minor_axis": self.semi_axes[1],
            "angle": self.angle,
            "radii": {f"{p:g}": r._asdict() for p, r in self.radii.items()},
            "share_inside": {f"{p:g}": share for p, share in self.inside.items()},
        }


def ellipse_of(
    flown: "xarray.Dataset", percentages: tuple[float, ...]
) -> MissEllipse | None:
    """The ellipse and the circular errors of finite flights.

    None where the results have no crossrange error, or one that does not spread by 1 m,
    or fewer than three runs.
    """
    if ALONG not in flown or ACROSS not in flown or flown.sizes["run"] < 3:
        return None
    errors = np.stack([flown[ALONG].values, flown[ACROSS].values])
    if np.std(errors[1]) < _LEAST_SPREAD:
        return None
    mean = errors.mean(axis=1)
    covariance = np.cov(errors)
    variances, axes = np.linalg.eigh(covariance)
    minor, major = np.sqrt(np.maximum(variances, 0.0))
    angle = math.atan2(axes[1, 1], axes[0, 1])
    if angle <= -0.5 * math.pi or angle > 0.5 * math.pi:  # an axis has no direction
        angle -= math.copysign(math.pi, angle)
    distances = np.sort(np.hypot(*errors))
    # In standard deviations along the axes.
    axes_of = (axes.T @ (errors - mean[:, None])) / np.maximum(
        np.sqrt(np.maximum(variances, 0.0)), np.finfo(float).tiny
    )[:, None]
    reach = np.hypot(*axes_of)
    found = MissEllipse(
        mean=(float(mean[0]), float(mean[1])),
        semi_axes=(float(major), float(minor)),
        angle=angle,
        radii={p: percentile_interval(distances, p) for p in percentages},
        inside={},
    )
    inside = {p: float(np.mean(reach <= found.scale(p))) for p in percentages}
    return dataclasses.replace(found, inside=inside)
