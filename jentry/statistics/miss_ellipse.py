"""Distribution of the misses about the target: circular errors and the error ellipse."""

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
"""Standard deviation of the crossrange error, m. Flights with less are in a plane"""


@dataclasses.dataclass(frozen=True)
class MissEllipse:
    """Distribution of the downrange and crossrange errors of a campaign.

    The ellipse is that of a normal distribution with the mean and the covariance of the
    runs. The shares of the runs that are inside it are stored with it.
    """

    mean: tuple[float, float]
    """Mean downrange and crossrange errors, m"""
    semi_axes: tuple[float, float]
    """Standard deviations along the axes of the ellipse, the larger one first, m"""
    angle: float
    """Direction of the larger axis, from downrange towards positive crossrange, rad, in
    (-pi/2, pi/2]"""
    radii: dict[float, Interval]
    """Radius about the target, m, by the percentage of the runs that are inside it. The
    radius for 50 is the circular error probable"""
    inside: dict[float, float]
    """Share of the runs inside the ellipse, by the percentage of a normal distribution that
    is inside it"""

    def scale(self, percentage: float) -> float:
        """Semi-axes of the ellipse of a percentage, in standard deviations."""
        return math.sqrt(-2.0 * math.log1p(-percentage / 100.0))

    def outline(self, percentage: float, points: int = 181) -> np.ndarray:
        """Downrange and crossrange on the ellipse of a percentage, m, (2, points)."""
        around = np.linspace(0.0, 2.0 * np.pi, points)
        major, minor = (self.scale(percentage) * axis for axis in self.semi_axes)
        cosine, sine = math.cos(self.angle), math.sin(self.angle)
        x, y = major * np.cos(around), minor * np.sin(around)
        along = self.mean[0] + cosine * x - sine * y
        return np.stack([along, self.mean[1] + sine * x + cosine * y])

    def plain(self) -> dict[str, Any]:
        """Dictionary of plain values, SI."""
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

    It is None if there are fewer than three runs, if the results have no downrange or no
    crossrange error, or if the standard deviation of the crossrange error is below 1 m.
    """
    if ALONG not in flown or ACROSS not in flown or flown.sizes["run"] < 3:
        return None
    errors = np.stack([flown[ALONG].values, flown[ACROSS].values])
    if np.std(errors[1]) < _LEAST_SPREAD:
        return None
    mean = errors.mean(axis=1)
    covariance = np.cov(errors)
    variances, axes = np.linalg.eigh(covariance)
    minor, major = spreads = np.sqrt(np.maximum(variances, 0.0))
    angle = math.atan2(axes[1, 1], axes[0, 1])
    if angle <= -0.5 * math.pi or angle > 0.5 * math.pi:  # an axis has no direction
        angle -= math.copysign(math.pi, angle)
    distances = np.sort(np.hypot(*errors))
    # In standard deviations along the axes.
    units = np.maximum(spreads, np.finfo(float).tiny)
    reach = np.hypot(*(axes.T @ (errors - mean[:, None]) / units[:, None]))
    found = MissEllipse(
        mean=(float(mean[0]), float(mean[1])),
        semi_axes=(float(major), float(minor)),
        angle=angle,
        radii={p: percentile_interval(distances, p) for p in percentages},
        inside={},
    )
    inside = {p: float(np.mean(reach <= found.scale(p))) for p in percentages}
    return dataclasses.replace(found, inside=inside)
