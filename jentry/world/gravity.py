"""Gravity: acceleration and potential over the distance from the planet's centre."""

import re
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Array

from .._math import sincos
from ..fields import Scalar, as_float_array, scalar


class AbstractGravity(eqx.Module):
    """Gravity over the distance from the centre (m) and the geocentric latitude (rad).

    A central gravity, which does not depend on the latitude, defines `acceleration` and
    `potential` of the radius. Any other overrides `components` and `potential_at`, sets
    `is_central` to False and raises an error in the two functions of the radius alone:
    computations that assume a central gravity call these.
    """

    is_central: ClassVar[bool] = True
    """Whether the acceleration is towards the centre and depends on the radius alone"""

    @abstractmethod
    def acceleration(self, radius: Scalar) -> Scalar:
        """Acceleration towards the centre, m/s2."""

    @abstractmethod
    def potential(self, radius: Scalar) -> Scalar:
        """Potential energy per unit mass, J/kg; its slope is the acceleration."""

    def components(
        self, radius: Scalar, latitude: Scalar
    ) -> tuple[Scalar, Scalar | None]:
        """Acceleration towards the centre and towards north, m/s2.

        The second is None for a central gravity, which costs nothing.
        """
        return self.acceleration(radius), None

    def potential_at(self, radius: Scalar, latitude: Scalar) -> Scalar:
        """Potential energy per unit mass at a radius and a latitude, J/kg."""
        return self.potential(radius)

    def in_equator(self, radius: Scalar) -> Scalar:
        """Acceleration towards the centre in the plane of the equator, m/s2.

        Raises `ValueError` if gravity pulls out of that plane.
        """
        return self.acceleration(radius)


class InverseSquareGravity(AbstractGravity):
    """Newton's law for a sphere."""

    gravitational_parameter: Scalar = scalar(unit="m3/s2", positive=True)

    def acceleration(self, radius: Scalar) -> Scalar:
        per_radius = 1.0 / radius
        return self.gravitational_parameter * per_radius * per_radius

    def potential(self, radius: Scalar) -> Scalar:
        return -self.gravitational_parameter * (1.0 / radius)


class ConstantGravity(AbstractGravity):
    """Acceleration that is equal at every radius, as in many published studies.

    The potential is counted from the planet's centre.
    """

    surface_acceleration: Scalar = scalar(unit="m/s2")

    def acceleration(self, radius: Scalar) -> Scalar:
        return self.surface_acceleration + 0.0 * radius

    def potential(self, radius: Scalar) -> Scalar:
        return self.surface_acceleration * radius


def _harmonics(given: Any) -> dict[str, Array]:
    if not isinstance(given, Mapping):
        raise ValueError(
            f"zonal_harmonics is {given!r}: give the coefficients by their names, such as "
            '{"j2": 1.0826e-3}'
        )
    for name in given:
        if not re.fullmatch(r"j([2-9]|[1-9][0-9]+)", name):
            raise ValueError(
                f"zonal_harmonics has the name {name!r}: expected j2, j3 and so on, such "
                'as {"j2": 1.0826e-3}'
            )
    if not given:
        raise ValueError(
            "zonal_harmonics is empty: give J2, such as {'j2': 1.0826e-3}, or take "
            "InverseSquareGravity"
        )
    return {name: as_float_array(given[name]) for name in sorted(given, key=_degree)}


def _coefficients() -> Any:
    """A field of numbers by name, each a leaf."""
    metadata = {"unit": "1", "positive": False, "range": None}
    return eqx.field(converter=_harmonics, metadata=metadata)


def _degree(name: str) -> int:
    return int(name[1:])


class ZonalGravity(AbstractGravity):
    """Gravity of a body of revolution: Newton's law with zonal harmonics J2, J3, ...

    The potential energy per unit mass at the radius r and the geocentric latitude is

        -(mu / r) (1 - sum of J_n (R / r)^n P_n(sin(latitude)))

    with the Legendre polynomials P_n and coefficients J_n that are not normalised. It does
    not contain the rotation of the planet. For the Earth, by WGS 84, mu is 3.986004418e14
    m3/s2, R 6378137 m and J2 1.08262982e-3:

        ZonalGravity(3.986004418e14, 6378137.0, {"j2": 1.08262982e-3})

    Reference: O. Montenbruck, E. Gill, *Satellite Orbits*, 2000, section 3.2.
    """

    is_central = False

    gravitational_parameter: Scalar = scalar(unit="m3/s2", positive=True)
    reference_radius: Scalar = scalar(unit="m", positive=True)
    """R, the radius of the coefficients: not necessarily that of the planet"""
    zonal_harmonics: Mapping[str, Scalar] = _coefficients()
    """Coefficients by name, {"j2": ..., "j3": ...}; those that are left out cost nothing.
    The address of the first is `planet.gravity.zonal_harmonics.j2`"""

    def acceleration(self, radius: Scalar) -> Scalar:
        raise _needs_latitude()

    def potential(self, radius: Scalar) -> Scalar:
        raise _needs_latitude()

    def components(self, radius: Scalar, latitude: Scalar) -> tuple[Scalar, Scalar]:
        """Acceleration towards the centre and towards north, m/s2."""
        sine, cosine = sincos(latitude)
        per_radius = 1.0 / radius
        newton = self.gravitational_parameter * per_radius * per_radius
        down, north = 1.0, 0.0
        for degree, share, value, slope in self._terms(per_radius, sine):
            down = down - (degree + 1.0) * share * value
            north = north - share * slope
        return newton * down, newton * cosine * north

    def potential_at(self, radius: Scalar, latitude: Scalar) -> Scalar:
        sine, _ = sincos(latitude)
        per_radius = 1.0 / radius
        size = 1.0
        for _, share, value, _ in self._terms(per_radius, sine):
            size = size - share * value
        return -self.gravitational_parameter * per_radius * size

    def in_equator(self, radius: Scalar) -> Scalar:
        odd = [name for name in self.zonal_harmonics if _degree(name) % 2 == 1]
        if odd:
            raise ValueError(
                f"the gravity has the zonal harmonics {', '.join(odd)}, which pull out of "
                "the plane of the equator: take dynamics=EntryDynamics(), or leave the "
                "harmonics of odd degree out"
            )
        return self.components(radius, 0.0 * radius)[0]

    def _terms(
        self, per_radius: Scalar, sine: Scalar
    ) -> Iterator[tuple[int, Scalar, Scalar, Scalar]]:
        """Degree n, J_n (R / r)^n, P_n and its derivative over the sine, for each term."""
        ratio = self.reference_radius * per_radius
        before, value = 1.0, sine
        slope_before, slope = 0.0, 1.0
        power = ratio
        for degree in range(2, max(map(_degree, self.zonal_harmonics)) + 1):
            power = power * ratio
            after = (2.0 - 1.0 / degree) * sine * value - (1.0 - 1.0 / degree) * before
            slope_before, slope = slope, slope_before + (2.0 * degree - 1.0) * value
            before, value = value, after
            if f"j{degree}" in self.zonal_harmonics:
                share = self.zonal_harmonics[f"j{degree}"] * power
                yield degree, share, value, slope


def _needs_latitude() -> ValueError:
    return ValueError(
        "a computation assumes a gravity that depends on the radius alone, and "
        "ZonalGravity depends on the latitude as well: give this planet, such as that of "
        "the onboard model, InverseSquareGravity; the planet of the scenario may have "
        "ZonalGravity nevertheless"
    )
