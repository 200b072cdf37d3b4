"""How a Bézier curve is anchored again at the vehicle as it moves along."""

from abc import abstractmethod
from collections.abc import Callable

import equinox as eqx

from ..._integrate import runge_kutta
from ...fields import Scalar
from .curve import (
    BezierParameters,
    BezierPath,
    InnerPoints,
    PathPoint,
    bezier_parameters,
    inner_points,
)


VelocityRate = Callable[[PathPoint, tuple[Scalar, Scalar], Scalar], Scalar]
"""Slope of the velocity over the angle along the track (m/s/rad), as a function of a point
of a path, the second slopes at the point and the velocity"""


class Shape(eqx.Module):
    """Two numbers that define the curve for an anchoring rule.

    Velocity control adjusts the second one in flight.
    """

    first: Scalar
    second: Scalar


class AbstractAnchoring(eqx.Module):
    """Rule for what is held of a curve from one guidance cycle to the next."""

    @abstractmethod
    def shape(
        self, parameters: BezierParameters, start: PathPoint, target: PathPoint
    ) -> Shape:
        """Shape of the curve with these parameters."""

    @abstractmethod
    def inner(self, shape: Shape, start: PathPoint, target: PathPoint) -> InnerPoints:
        """Inner points of the curve from the vehicle to the target."""

    @abstractmethod
    def carried(
        self, shape: Shape, before: Scalar, start: PathPoint, target: PathPoint
    ) -> Shape:
        """Shape at a new start; `before` is the previous along-track angle, rad."""

    @abstractmethod
    def integrated(
        self,
        rate: VelocityRate,
        velocity: Scalar,
        shape: Shape,
        start: PathPoint,
        target: PathPoint,
        steps: int,
    ) -> Scalar:
        """Velocity at the target if the curve is anchored again at every instant, m/s."""

    @abstractmethod
    def features(
        self, shape: Shape, start: PathPoint, target: PathPoint
    ) -> tuple[Scalar, ...]:
        """Numbers of order 1 that describe the curve, as inputs of a network."""

    @abstractmethod
    def bounds(self, start: PathPoint, target: PathPoint) -> tuple[Scalar, Scalar]:
        """Bounds of the adjusted number."""


class StoredParameters(AbstractAnchoring):
    """The paper's rule: k1 and k2 are constant, and the curve changes.

    The vertical command depends on K = k2 / k1^2 only. Near the target the altitude error
    goes as X^(1.5/K) with the distance to go X, and the command as X^(1.5/K - 2). Hence
    K < 1.5 and k2 < 1 are required. Above K = 0.75 the command is singular, but integrable.
    """

    def shape(
        self, parameters: BezierParameters, start: PathPoint, target: PathPoint
    ) -> Shape:
        return Shape(parameters.k1, parameters.k2)

    def inner(self, shape: Shape, start: PathPoint, target: PathPoint) -> InnerPoints:
        return inner_points(BezierParameters(shape.first, shape.second), start, target)

    def carried(
        self, shape: Shape, before: Scalar, start: PathPoint, target: PathPoint
    ) -> Shape:
        return shape

    def integrated(
        self,
        rate: VelocityRate,
        velocity: Scalar,
        shape: Shape,
        start: PathPoint,
        target: PathPoint,
        steps: int,
    ) -> Scalar:
        length = target.along - start.along

        def slopes(left, y):
            """Slopes over the cube root of the share of the way that is left."""
            altitude, altitude_slope, cross, cross_slope, velocity = y
            along = target.along - length * left**3
            point = PathPoint(along, altitude, cross, altitude_slope, cross_slope)
            path = BezierPath.between(point, target, self.inner(shape, point, target))
            bend, aside = path.second_slopes(0.0 * along)
            braking = rate(point, (bend, aside), velocity)
            run = -3.0 * length * left * left
            rates = altitude_slope, bend, cross_slope, aside, braking
            return tuple(run * r for r in rates)

        y = (
            start.altitude,
            start.altitude_slope,
            start.cross,
            start.cross_slope,
            velocity,
        )
        # The command may be singular at the target. The integration stops where a share of
        # 8e-6 of the way is left. The drag over this share is that at its beginning.
        left = 0.02
        y = runge_kutta(slopes, 1.0, left, y, steps)
        return y[-1] - slopes(left, y)[-1] * left / 3.0

    def features(
        self, shape: Shape, start: PathPoint, target: PathPoint
    ) -> tuple[Scalar, ...]:
        return shape.first, shape.second

    def bounds(self, start: PathPoint, target: PathPoint) -> tuple[Scalar, Scalar]:
        nothing = 0.0 * start.along
        return nothing + 0.3, nothing + 1.05


class Subdivision(AbstractAnchoring):
    """Beyond the paper: the curve is constant, and its parameters change.

    The part of a Bézier curve beyond a point is a Bézier curve itself, whose inner points
    follow from de Casteljau's construction. The two numbers of the shape are the distances
    of the inner points from the ends (rad). They stay regular where the tangents become
    parallel; k1 and k2 do not. Moving the third control point re-plans the rest of the
    flight.
    """

    def shape(
        self, parameters: BezierParameters, start: PathPoint, target: PathPoint
    ) -> Shape:
        inner = inner_points(parameters, start, target)
        return Shape(inner.first, inner.last)

    def inner(self, shape: Shape, start: PathPoint, target: PathPoint) -> InnerPoints:
        return InnerPoints(shape.first, shape.second)

    def carried(
        self, shape: Shape, before: Scalar, start: PathPoint, target: PathPoint
    ) -> Shape:
        none = 0.0 * before
        along = (
            before,
            before + shape.first,
            target.along - shape.second,
            target.along,
        )
        flat = none, none, none, none
        curve = BezierPath(along, flat, flat)
        inner = curve.after(curve.parameter_at(start.along)).inner
        return Shape(inner.first, inner.last)

    def integrated(
        self,
        rate: VelocityRate,
        velocity: Scalar,
        shape: Shape,
        start: PathPoint,
        target: PathPoint,
        steps: int,
    ) -> Scalar:
        path = BezierPath.between(start, target, self.inner(shape, start, target))

        def slope(tau, velocity):
            braking = rate(path.point(tau), path.second_slopes(tau), velocity)
            return path.run(tau) * braking

        return runge_kutta(slope, 0.0, 1.0, velocity, steps)

    def features(
        self, shape: Shape, start: PathPoint, target: PathPoint
    ) -> tuple[Scalar, ...]:
        per_length = 1.0 / (target.along - start.along)
        return shape.first * per_length, shape.second * per_length

    def bounds(self, start: PathPoint, target: PathPoint) -> tuple[Scalar, Scalar]:
        to_go = target.along - start.along
        return 0.01 * to_go, 0.9 * to_go


def parameters_of(
    anchoring: AbstractAnchoring, shape: Shape, start: PathPoint, target: PathPoint
) -> BezierParameters:
    """k1 and k2 of the curve from the vehicle to the target."""
    return bezier_parameters(anchoring.inner(shape, start, target), start, target)
