"""Shape of a planet: a sphere, or an ellipsoid with geodetic altitude and latitude."""

import equinox as eqx
import jax.numpy as jnp

from .._math import sincos
from ..fields import Scalar, scalar
from .atmosphere import AbstractAtmosphere
from .wind import AbstractWind


class Sphere(eqx.Module):
    """The sphere of `Planet.radius`."""


class Ellipsoid(eqx.Module):
    """An ellipsoid of revolution about the axis of rotation.

    The geodetic altitude is the distance from the ellipsoid, along its normal; the geodetic
    latitude is the angle of the normal above the equator. For Earth and Mars they are
    accurate to 1e-8 m and 1e-15 rad from 11 km below the ground to 1000 km, and for a
    flattening of 0.1 to 1e-5 m. The ellipsoid of WGS 84 is
    `Ellipsoid(6378137.0, 1 / 298.257223563)`, and that of Mars, by the working group of the
    IAU (2015), `Ellipsoid(3396190.0, 1 / 169.894447)`.
    """

    equatorial_radius: Scalar = scalar(unit="m", positive=True)
    flattening: Scalar = scalar(range=(0.0, 0.5))
    """Difference of equatorial and polar radius over the equatorial radius"""

    @property
    def polar_radius(self) -> Scalar:
        """m"""
        return self.equatorial_radius * (1.0 - self.flattening)

    def geodetic(self, radius: Scalar, latitude: Scalar) -> tuple[Scalar, Scalar]:
        """Geodetic altitude (m) and latitude (rad) of a point.

        **Arguments:**

        - `radius`: distance from the centre, m; at least half of the equatorial radius.
        - `latitude`: geocentric latitude, rad.
        """
        rise, run = self._along(radius, latitude, 2)
        return self.altitude(radius, latitude), jnp.arctan2(rise, run)

    def altitude(self, radius: Scalar, latitude: Scalar) -> Scalar:
        """Geodetic altitude (m) of a point; see `geodetic`."""
        rise, run = self._along(radius, latitude, 1)
        sine, cosine = sincos(latitude)
        squashed = 1.0 - self.flattening
        # The distance from the tangent plane is stationary in the latitude: an error of
        # 1e-8 rad is one of 1e-9 m.
        per_size = 1.0 / jnp.sqrt(rise * rise + run * run)
        support = jnp.sqrt(run * run + (squashed * rise) * (squashed * rise))
        out = radius * (run * cosine + rise * sine)
        return (out - self.equatorial_radius * support) * per_size

    def tilt(self, radius: Scalar, latitude: Scalar) -> tuple[Scalar, Scalar]:
        """Sine and cosine of the geodetic minus the geocentric latitude."""
        rise, run = self._along(radius, latitude, 2)
        per_size = 1.0 / jnp.sqrt(rise * rise + run * run)
        sine, cosine = sincos(latitude)
        return (
            per_size * (rise * cosine - run * sine),
            per_size * (run * cosine + rise * sine),
        )

    def geocentric(self, altitude: Scalar, latitude: Scalar) -> tuple[Scalar, Scalar]:
        """Distance from the centre (m) and geocentric latitude (rad) of a point.

        The inverse of `geodetic`: geodetic altitude (m) and latitude (rad).
        """
        sine, cosine = sincos(latitude)
        squashed = 1.0 - self.flattening
        square = squashed * squashed
        # Radius of curvature in the prime vertical.
        normal = self.equatorial_radius / jnp.sqrt(
            cosine * cosine + square * sine * sine
        )
        out, up = (normal + altitude) * cosine, (square * normal + altitude) * sine
        return jnp.sqrt(out * out + up * up), jnp.arctan2(up, out)

    def _along(
        self, radius: Scalar, latitude: Scalar, steps: int
    ) -> tuple[Scalar, Scalar]:
        """Sine and cosine of the geodetic latitude, times a positive factor.

        Bowring's iteration for the parametric latitude, in a fixed number of steps, in
        sines and cosines: it has no singular point, neither at a pole nor at the equator.
        Each step squares the error. It begins with the parametric latitude of the point of
        the ellipsoid at this geocentric latitude, which is exact on the ground.

        Reference: B. R. Bowring, "Transformation from spatial to geographical
        coordinates", Survey Review 23(181), 1976; in the form of T. Fukushima, "Fast
        transform from geocentric to geodetic coordinates", Journal of Geodesy 73, 1999.
        """
        sine, cosine = sincos(latitude)
        squashed = 1.0 - self.flattening
        square = 1.0 - squashed * squashed  # of the eccentricity
        ratio = radius * (1.0 / self.equatorial_radius)
        out, up = ratio * cosine, squashed * (ratio * sine)
        rise, run = sine, squashed * cosine
        for _ in range(steps):
            size = rise * rise + run * run
            cube = size * jnp.sqrt(size)
            rise, run = (
                up * cube + square * (rise * rise * rise),
                out * cube - square * (run * run * run),
            )
        # The tangent of the geodetic latitude is that of the parametric one / squashed.
        return rise, squashed * run


class GeodeticAtmosphere(AbstractAtmosphere):
    """An atmosphere over an ellipsoid at one latitude, as a function of the altitude above
    the sphere of the planet's radius."""

    atmosphere: AbstractAtmosphere
    shape: Ellipsoid
    radius: Scalar = scalar(unit="m", positive=True)
    """Radius of the sphere, m"""
    latitude: Scalar = scalar(unit="rad")
    """Geocentric latitude, rad"""

    def density(self, altitude: Scalar) -> Scalar:
        return self.atmosphere.density(self._above(altitude))

    def temperature(self, altitude: Scalar) -> Scalar:
        return self.atmosphere.temperature(self._above(altitude))

    def pressure(self, altitude: Scalar) -> Scalar:
        return self.atmosphere.pressure(self._above(altitude))

    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        return self.atmosphere.speed_of_sound(self._above(altitude))

    def _above(self, altitude: Scalar) -> Scalar:
        return self.shape.altitude(self.radius + altitude, self.latitude)


class GeodeticWind(AbstractWind):
    """A wind over an ellipsoid at one latitude, as a function of the altitude above the
    sphere of the planet's radius.

    North and up of the wind are along the ellipsoid and its normal. Those of the result
    are, as everywhere, across and along the radius.
    """

    wind: AbstractWind
    shape: Ellipsoid
    radius: Scalar = scalar(unit="m", positive=True)
    """Radius of the sphere, m"""
    latitude: Scalar = scalar(unit="rad")
    """Geocentric latitude, rad"""

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        radius = self.radius + altitude
        east, north, up = self.wind.velocity(self.shape.altitude(radius, self.latitude))
        sine, cosine = self.shape.tilt(radius, self.latitude)
        return east, north * cosine + up * sine, up * cosine - north * sine
