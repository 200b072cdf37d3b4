"""Path constraints: quantities along the flight, with their names, units and limits."""

import dataclasses
import functools
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from .._math import sincos
from .._printed import as_text
from ..fields import Scalar, optional_scalar, scalar
from ..units import standard_gravity
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from .dynamics import AbstractDynamics, EntryDynamics
from .forces import AirData, air_data
from .geodesy import geodetic_position
from .quantities import convective_heat_rate, load_factor
from .state import Controls, EntryState


class PathPoint(eqx.Module):
    """A point of a flight: the state, the controls and the air around the vehicle."""

    planet: Planet
    vehicle: Vehicle
    state: EntryState
    controls: Controls
    air: AirData
    dynamics: AbstractDynamics

    @classmethod
    def of(
        cls,
        planet: Planet,
        vehicle: Vehicle,
        state: EntryState,
        controls: Controls,
        dynamics: AbstractDynamics = EntryDynamics(),
    ) -> "PathPoint":
        """The point at a state and controls, with its air data."""
        air = air_data(planet, vehicle, state, controls.angle_of_attack)
        return cls(planet, vehicle, state, controls, air, dynamics)


class AbstractPathConstraint(eqx.Module):
    """A quantity along the path of a flight, with an upper limit.

    Its name is its key in `Scenario.constraints`. Your own class states `limit`, `unit`
    and `value`. It then has a peak, a column in the results and in the tables, and a
    penalty:

        class NoseTemperature(AbstractConstraint):
            \"""Radiative equilibrium temperature at the stagnation point.\"""

            limit: Scalar | None = optional_scalar(unit="K")
            unit = "K"

            def value(self, point):
                heat_rate = HeatRate().value(point)
                return (heat_rate / (0.85 * 5.670374419e-8)) ** 0.25

        constraints = {**scenario.constraints, "nose_temperature": NoseTemperature(1900.0)}
        scenario = dataclasses.replace(scenario, constraints=constraints)
    """

    limit: eqx.AbstractVar[Scalar | None]
    """Largest allowed value; None for no limit"""
    unit: ClassVar[str]
    """SI unit of the value and of the limit"""
    shown_unit: ClassVar[str | None] = None
    """Text that tables and figures show in place of the unit, for the same number"""

    def excess(self, value: Scalar) -> Scalar:
        """Excess of a value over the limit; zero within the limit.

        It is a share of the limit. If the limit is not positive, such as that of the
        equilibrium glide, it is in the unit of the value. Without a limit it is zero.
        """
        if self.limit is None:
            return jnp.zeros_like(value)
        share = self.limit > 0.0
        size = jnp.where(share, self.limit, 1.0)
        return jax.nn.relu((value - self.limit) / size)


class AbstractConstraint(AbstractPathConstraint):
    """A constraint on a quantity that follows from one point of the flight."""

    @abstractmethod
    def value(self, point: PathPoint) -> Scalar:
        """The quantity at a point of a flight."""


class AbstractIntegral(AbstractPathConstraint):
    """A constraint on an integral over time, which is integrated with the motion.

    It begins at zero. Without such a constraint only the motion is integrated.
    """

    @abstractmethod
    def rate(self, point: PathPoint) -> Scalar:
        """The integrand at a point of a flight, in the unit of the integral per second."""


class Drag(AbstractConstraint):
    """Specific drag."""

    limit: Scalar | None = optional_scalar(unit="m/s2")
    unit = "m/s2"

    def value(self, point: PathPoint) -> Scalar:
        return point.air.drag


class DynamicPressure(AbstractConstraint):
    """Dynamic pressure."""

    limit: Scalar | None = optional_scalar(unit="Pa")
    unit = "Pa"

    def value(self, point: PathPoint) -> Scalar:
        return point.air.dynamic_pressure


class MachNumber(AbstractConstraint):
    """Mach number: speed relative to the air in units of the speed of sound."""

    limit: Scalar | None = optional_scalar()
    unit = "1"

    def value(self, point: PathPoint) -> Scalar:
        return point.air.mach


class GeodeticAltitude(AbstractConstraint):
    """Altitude above the shape of the planet: on a sphere, the altitude.

    The highest is its peak. `values_at_end` has its value at the end.
    """

    limit: Scalar | None = optional_scalar(unit="m")
    unit = "m"

    def value(self, point: PathPoint) -> Scalar:
        state = point.state
        return point.planet.geodetic_altitude(state.altitude, state.latitude)


class GeodeticLatitude(AbstractConstraint):
    """Angle of the normal of the planet's shape above the equator: on a sphere, the
    latitude."""

    limit: Scalar | None = optional_scalar(unit="rad")
    unit = "rad"

    def value(self, point: PathPoint) -> Scalar:
        return geodetic_position(point.planet, point.state)[1]


class HeatRate(AbstractConstraint):
    """Convective heat rate at the stagnation point: `convective_heat_rate`."""

    limit: Scalar | None = optional_scalar(unit="W/m2")
    unit = "W/m2"

    def value(self, point: PathPoint) -> Scalar:
        return _heat_rate(point)


class LoadFactor(AbstractConstraint):
    """Total aerodynamic acceleration in units of 9.80665 m/s2."""

    limit: Scalar | None = optional_scalar()
    unit = "1"
    shown_unit = "g"

    def value(self, point: PathPoint) -> Scalar:
        return load_factor(point.air)


class NormalLoadFactor(AbstractConstraint):
    """Aerodynamic acceleration normal to the body axis, in units of 9.80665 m/s2.

    It is lift * cos(angle of attack) + drag * sin(angle of attack).
    """

    limit: Scalar | None = optional_scalar()
    unit = "1"
    shown_unit = "g"

    def value(self, point: PathPoint) -> Scalar:
        sine, cosine = sincos(point.controls.angle_of_attack)
        air = point.air
        return (air.lift * cosine + air.drag * sine) / standard_gravity


class HeatLoad(AbstractIntegral):
    """Heat load at the stagnation point: the integral of the heat rate over time."""

    limit: Scalar | None = optional_scalar(unit="J/m2")
    unit = "J/m2"

    def rate(self, point: PathPoint) -> Scalar:
        return _heat_rate(point)


class EquilibriumGlide(AbstractConstraint):
    """Missing vertical acceleration for an equilibrium glide at a bank angle.

    It is in units of 9.80665 m/s2. It is zero where the flight-path angle would not change
    at that bank angle, negative below this altitude, in denser air, and positive above it.
    With the limit 0 a vehicle at that bank can always stop its path from bending down. For
    a small flight-path angle over a planet at rest, zero means
    lift * cos(bank) = g - V^2 / r.

    Reference: D.-W. Lee, K.-R. Cho, H. Yan, "Re-Entry Trajectory Tracking Via an Inverse
    Dynamics Method", 2004, equation (8), for zero bank.
    """

    bank_angle: Scalar = scalar(0.0, unit="rad")
    limit: Scalar | None = optional_scalar()
    unit = "1"
    shown_unit = "g"

    def value(self, point: PathPoint) -> Scalar:
        angle_of_attack = point.controls.angle_of_attack
        controls = Controls.from_bank(self.bank_angle, angle_of_attack)
        rates = point.dynamics.rates(point.planet, point.vehicle, point.state, controls)
        return -point.state.velocity * rates.flight_path_angle / standard_gravity


def _heat_rate(point: PathPoint) -> Scalar:
    planet = point.planet
    return convective_heat_rate(
        point.air.density,
        point.air.airspeed,
        point.vehicle.nose_radius,
        planet.heating_coefficient,
        planet.heating_exponent,
    )


Constraints = dict[str, AbstractPathConstraint]
"""The path constraints of a scenario, by name"""


def usual_constraints() -> Constraints:
    """Drag, dynamic pressure, heat rate and load factor, without limits."""
    return {
        "drag": Drag(),
        "dynamic_pressure": DynamicPressure(),
        "heat_rate": HeatRate(),
        "load_factor": LoadFactor(),
    }


@jax.tree_util.register_pytree_with_keys_class
class ConstraintValues(Mapping[str, Any]):
    """Numbers of path constraints by name, `values["drag"]` or `values.drag`."""

    def __init__(
        self, values: Mapping[str, Any], units: Mapping[str, str] | None = None
    ):
        """`units` are the units of the values, by name."""
        self._values = {name: values[name] for name in sorted(values)}
        known = units or {}
        self._units = {name: known[name] for name in self._values if name in known}

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self._values:
            raise AttributeError(
                f"no path constraint {name!r} in this scenario, which has "
                f"{', '.join(self.__dict__.get('_values', ())) or 'none'}: add it to "
                "`Scenario.constraints`"
            )
        return self._values[name]

    def __repr__(self) -> str:
        return f"ConstraintValues({self._values})"

    __str__ = as_text

    def tree_flatten_with_keys(self):
        keys = (jax.tree_util.GetAttrKey(name) for name in self._values)
        children = zip(keys, self._values.values(), strict=True)
        return tuple(children), (tuple(self._values), tuple(self._units.items()))

    @classmethod
    def tree_unflatten(cls, described, children):
        names, units = described
        return cls(dict(zip(names, children, strict=True)), dict(units))


def constraint_values(
    constraints: Constraints, point: PathPoint, integrals: Mapping[str, Scalar]
) -> ConstraintValues:
    """The constrained quantities at a point; `integrals` are those up to this point."""
    return ConstraintValues(
        {
            name: constraint.value(point)
            if isinstance(constraint, AbstractConstraint)
            else integrals[name]
            for name, constraint in constraints.items()
        },
        {name: each.shown_unit or each.unit for name, each in constraints.items()},
    )


def limit_of(constraints: Constraints, kind: type) -> Scalar | None:
    """The limit on a quantity: the smallest limit of the constraints of a class.

    It is None if no constraint of the class has a limit. A law obtains here the limits
    that it must respect:

        limit_of(measurement.constraints, HeatRate)
    """
    limits = [
        each.limit
        for each in constraints.values()
        if isinstance(each, kind) and each.limit is not None
    ]
    return functools.reduce(jnp.minimum, limits) if limits else None


def integrals_of(constraints: Constraints) -> dict[str, AbstractIntegral]:
    """Path constraints that are integrated along with the motion, by name."""
    return {n: c for n, c in constraints.items() if isinstance(c, AbstractIntegral)}


def tightened(constraints: Constraints, share: float) -> Constraints:
    """The path constraints that have a limit, with positive limits lower by a share.

    For a cost that begins before the limit: with a cost of the excess alone a law flies at
    the limit.
    """
    lower = {}
    for name, each in constraints.items():
        if each.limit is None:
            continue
        factor = jnp.where(each.limit > 0.0, 1.0 - share, 1.0)
        lower[name] = dataclasses.replace(each, limit=factor * each.limit)
    return lower


def excesses(constraints: Constraints, values: ConstraintValues) -> ConstraintValues:
    """Excess of the values of one flight over each limit; see `excess`.

    Constraints without a limit are left out. The excesses of peaks serve as a penalty in a
    loss:

        outputs = lambda scenario, flight: (
            misses(scenario, flight), excesses(scenario.constraints, flight.peaks)
        )
    """
    return ConstraintValues(
        {n: c.excess(values[n]) for n, c in constraints.items() if c.limit is not None}
    )
