"""The path to the target as a cubic Bézier curve in curvilinear coordinates.

Source: H. Zhou, T. Rahman, W. Chen, "Neural Network Assisted Inverse Dynamic Guidance for
Terminally Constrained Entry Flight", 2014, section 3.2. The coordinates of the paper are
those of a local Cartesian frame (25), in which the tangent at the target has the directions
of the start. Over 56 degrees of arc such a curve leaves the atmosphere; with the tangent
turned correctly it dips to 2 km. Here the coordinates are the angles along and across the
track and the altitude (`Track`), in which a glide is nearly straight.
"""

import equinox as eqx
import jax.numpy as jnp

from ...fields import Scalar, scalar


class PathPoint(eqx.Module):
    """A point of a path and its tangent there, over the angle along the track."""

    along: Scalar
    """rad"""
    altitude: Scalar
    """m"""
    cross: Scalar
    """rad, positive to the right"""
    altitude_slope: Scalar
    """m/rad"""
    cross_slope: Scalar


class BezierParameters(eqx.Module):
    """Places of the inner control points on the tangents at the ends: equation (29).

    The tangents meet, in the vertical plane, between start and target. k1 is the place of
    the second control point between the start and that point. k2 is the place of the third
    control point between that point and the target. Both are negative or more than 1 where
    the tangents meet elsewhere.
    """

    k1: Scalar = scalar()
    k2: Scalar = scalar()


class InnerPoints(eqx.Module):
    """Inner control points as distances along the track, rad."""

    first: Scalar
    """Distance from the start to the second control point"""
    last: Scalar
    """Distance from the third control point to the target"""


def tangents_meet(start: PathPoint, target: PathPoint) -> Scalar:
    """Distance along the track from the start to where the tangents meet, rad.

    Equation (30), corrected. Not finite where the tangents are parallel.
    """
    to_go = target.along - start.along
    fall = target.altitude - start.altitude - target.altitude_slope * to_go
    return fall / (start.altitude_slope - target.altitude_slope)


def inner_points(
    parameters: BezierParameters, start: PathPoint, target: PathPoint
) -> InnerPoints:
    """Inner points of a curve with these parameters, equation (30)."""
    meet = tangents_meet(start, target)
    to_go = target.along - start.along
    return InnerPoints(
        first=parameters.k1 * meet, last=(1.0 - parameters.k2) * (to_go - meet)
    )


def bezier_parameters(
    inner: InnerPoints, start: PathPoint, target: PathPoint
) -> BezierParameters:
    """Parameters of a curve with these inner points, equation (29)."""
    meet = tangents_meet(start, target)
    to_go = target.along - start.along
    return BezierParameters(k1=inner.first / meet, k2=1.0 - inner.last / (to_go - meet))


class BezierPath(eqx.Module):
    """A cubic Bézier curve with four control points; the parameter tau goes from 0 to 1."""

    along: tuple[Scalar, Scalar, Scalar, Scalar]
    altitude: tuple[Scalar, Scalar, Scalar, Scalar]
    cross: tuple[Scalar, Scalar, Scalar, Scalar]

    @classmethod
    def between(cls, start: PathPoint, target: PathPoint, inner: InnerPoints):
        """The curve with these ends, tangents and inner points: equations (28), (30)."""
        first, last = inner.first, inner.last
        return cls(
            (start.along, start.along + first, target.along - last, target.along),
            (
                start.altitude,
                start.altitude + start.altitude_slope * first,
                target.altitude - target.altitude_slope * last,
                target.altitude,
            ),
            (
                start.cross,
                start.cross + start.cross_slope * first,
                target.cross - target.cross_slope * last,
                target.cross,
            ),
        )

    def point(self, tau: Scalar) -> PathPoint:
        """Point and tangent at tau: equations (26), (31)."""
        run, rise, drift = self._rates(tau)
        return PathPoint(
            along=_value(self.along, tau),
            altitude=_value(self.altitude, tau),
            cross=_value(self.cross, tau),
            altitude_slope=rise / run,
            cross_slope=drift / run,
        )

    def run(self, tau: Scalar) -> Scalar:
        """Derivative of the angle along the track with tau, rad."""
        return _first(self.along, tau)

    def second_slopes(self, tau: Scalar) -> tuple[Scalar, Scalar]:
        """Second slopes of altitude (m/rad2) and cross-track (1/rad), equation (32)."""
        run, rise, drift = self._rates(tau)
        bend, up, aside = (
            _second(points, tau) for points in (self.along, self.altitude, self.cross)
        )
        square = run * run
        return (up - rise * bend / run) / square, (aside - drift * bend / run) / square

    def parameter_at(self, along: Scalar) -> Scalar:
        """tau at an angle along the track, by Newton's method from the start.

        The point must be ahead of the start. The nearer it is, the faster the method
        converges: four steps reach rounding for all points of a guidance cycle.
        """
        tau = jnp.zeros_like(along)
        for _ in range(4):
            tau = tau - (_value(self.along, tau) - along) / self.run(tau)
        return tau

    def after(self, tau: Scalar) -> "BezierPath":
        """The rest of the curve from tau on, as a Bézier curve (de Casteljau)."""
        return BezierPath(
            *(_after(p, tau) for p in (self.along, self.altitude, self.cross))
        )

    @property
    def inner(self) -> InnerPoints:
        """Inner points of the curve."""
        return InnerPoints(
            first=self.along[1] - self.along[0], last=self.along[3] - self.along[2]
        )

    def _rates(self, tau: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return (
            _first(self.along, tau),
            _first(self.altitude, tau),
            _first(self.cross, tau),
        )


def _value(points, tau):
    # Differences from the start, which are small beside the control points.
    p0, p1, p2, p3 = points
    rest = 1.0 - tau
    return p0 + tau * (
        3.0 * rest * rest * (p1 - p0)
        + 3.0 * tau * rest * (p2 - p0)
        + tau * tau * (p3 - p0)
    )


def _first(points, tau):
    p0, p1, p2, p3 = points
    rest = 1.0 - tau
    return 3.0 * (
        rest * rest * (p1 - p0) + 2.0 * tau * rest * (p2 - p1) + tau * tau * (p3 - p2)
    )


def _second(points, tau):
    p0, p1, p2, p3 = points
    return 6.0 * ((1.0 - tau) * (p0 - 2.0 * p1 + p2) + tau * (p1 - 2.0 * p2 + p3))


def _after(points, tau):
    p0, p1, p2, p3 = points

    def between(a, b):
        return a + tau * (b - a)

    a, b, c = between(p0, p1), between(p1, p2), between(p2, p3)
    d, e = between(a, b), between(b, c)
    return between(d, e), e, c, p3
