"""An extended Kalman filter that corrects inertial navigation by measurements."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._batching import where_due
from ..fields import NOT_NEGATIVE, Flag, Scalar, as_float_array, scalar
from ..motion.axes import Components, cross
from ..motion.state import EntryState
from ..world.planet import Planet
from .error_covariance import (
    MOTION,
    ErrorCovariance,
    MeasuredValue,
    Rows,
    derivatives,
)
from .filter_checks import (
    check_assumed_noise,
    check_correlations,
    check_deviations,
)
from .inertial import (
    Gyroscopes,
    KnowledgeError,
    Navigated,
    Sensed,
    TrackError,
    added,
    believed_motion,
    difference,
    displaced,
    tilting,
    track_difference,
)
from .measurement import BodyAccelerometers
from .navigation_sensors import MOST_VALUES, AbstractNavigationSensor, Believed


_LONGEST = 10.0
"""Largest time for which the covariance stays where it is, s"""


class Estimate(eqx.Module):
    """All that the filter estimates: its numbers are the coordinates of the covariance."""

    navigated: Navigated
    accelerometers: BodyAccelerometers
    """Estimated errors"""
    gyroscopes: Gyroscopes
    """Estimated errors"""


class Aiding(eqx.Module):
    """What the filter holds from one update to the next."""

    accelerometers: BodyAccelerometers
    """Estimated errors"""
    gyroscopes: Gyroscopes
    """Estimated errors"""
    covariance: ErrorCovariance
    """Covariance of an `Estimate` minus what is, its numbers in their order: state, tilt in
    axes of the planet, and errors of the instruments"""
    slopes: Rows
    """Derivatives of the rates of the first nine of these errors, 1/s and so on"""
    updated_at: Scalar
    """Time of the last update, s"""
    measured: dict[str, Scalar]
    """Number of measured values so far, by sensor"""
    rejected: dict[str, Scalar]
    """Number of those that were rejected, by sensor"""


class Knowledge(eqx.Module):
    """The knowledge error of a flight, and what the filter says of it."""

    error: KnowledgeError
    """What the vehicle believes minus what is"""
    deviation: KnowledgeError | None = None
    """Standard deviations of the filter; None without one"""
    normalised_error_squared: Scalar | None = None
    """Square of the error of position, velocity and attitude, normalised by the covariance
    of the filter. Its mean over many flights is 9 if the filter is consistent: see
    `jentry.statistics.consistency`"""
    measured: dict[str, Scalar] = eqx.field(default_factory=dict)
    """Number of measured values so far, by sensor; empty without a filter"""
    rejected: dict[str, Scalar] = eqx.field(default_factory=dict)
    """Number of those that were rejected, by sensor; empty without a filter"""
    track_deviation: TrackError | None = None
    """Standard deviations of the filter along and across the track; None without one"""


def _by_name(sensors: Any) -> dict[str, Any]:
    if not isinstance(sensors, Mapping):
        raise ValueError(
            f"sensors is of {type(sensors).__name__}: give them by their names, such as "
            '{"altimeter": Altimeter(...)}'
        )
    return dict(sorted(sensors.items()))


class NavigationFilter(eqx.Module):
    """An extended Kalman filter on the errors of inertial navigation.

    It estimates the errors of position, velocity and attitude, and all those of
    `BodyAccelerometers` and `Gyroscopes`: 20 numbers. Their covariance follows the
    equations of the navigation, whose derivatives JAX takes. After each measurement the
    navigation is corrected. Each value of a measurement has a gate.

    The standard deviations are what the vehicle assumes. The actual errors are those of
    `InertialNavigation.knowledge`, its `gyroscopes` and `noise`, and of
    `Scenario.accelerometers`: disperse them by the same numbers, and the filter is
    consistent.

    Reference: A. Gelb (editor), *Applied Optimal Estimation*, 1974, section 6.1; for the
    errors, D. H. Titterton, J. L. Weston, *Strapdown Inertial Navigation Technology*,
    2nd edition, 2004, chapter 12.
    """

    knowledge: KnowledgeError
    """Standard deviations at the start; each must be positive"""
    sensors: Mapping[str, AbstractNavigationSensor] = eqx.field(converter=_by_name)
    """Sensors by name"""
    accelerometers: BodyAccelerometers = eqx.field(default_factory=BodyAccelerometers)
    """Standard deviations of their errors"""
    gyroscopes: Gyroscopes = eqx.field(default_factory=Gyroscopes)
    """Standard deviations of their drifts"""
    velocity_random_walk: Scalar = scalar(0.0, unit="m/s^1.5", range=NOT_NEGATIVE)
    """Assumed one of `InertialNoise`"""
    angle_random_walk: Scalar = scalar(0.0, unit="rad/s^0.5", range=NOT_NEGATIVE)
    """Assumed one of `InertialNoise`"""
    correlations: Any = eqx.field(
        default=None, converter=lambda c: None if c is None else as_float_array(c)
    )
    """Correlations of the knowledge at the start, of shape (9, 9) in the order of its
    fields; None if there are none"""
    cycle: float = eqx.field(default=1.0, static=True)
    """Time from one update to the next, s"""

    def __check_init__(self):
        if not 0.0 < self.cycle < math.inf:
            raise ValueError(f"cycle is {self.cycle} s: it must be positive and finite")
        for name, sensor in self.sensors.items():
            if not name.isidentifier():
                raise ValueError(
                    f"sensors has the name {name!r}: it must be a word that a column of "
                    "the results can have, such as altimeter"
                )
            if not isinstance(sensor, AbstractNavigationSensor):
                raise ValueError(
                    f"sensors.{name} is of {type(sensor).__name__}: it must be an "
                    "AbstractNavigationSensor, such as Altimeter(...)"
                )
            every = sensor.cycle / self.cycle
            if every < 1.0 - 1e-9 or abs(every - round(every)) > 1e-9:
                raise ValueError(
                    f"sensors.{name}.cycle is {sensor.cycle} s, and that of the filter "
                    f"{self.cycle} s: a sensor measures at updates of the filter, so take "
                    "a multiple"
                )
        self.check()

    def check(self) -> None:
        """Refuse a filter whose covariance is not positive, now or after a measurement.

        Numbers that are not known yet are not looked at.
        """
        check_deviations("knowledge", self.knowledge, positive=True)
        check_deviations("accelerometers", self.accelerometers)
        check_deviations("gyroscopes", self.gyroscopes)
        check_assumed_noise(self.sensors)
        check_correlations(self.correlations)

    def begin(self, planet: Planet, navigated: Navigated, sensed: Sensed) -> Aiding:
        """The filter before the first update."""
        state = navigated.state
        exact = jax.tree.map(jnp.zeros_like, self.knowledge)
        slopes = derivatives(lambda off: displaced(planet, state, off), exact)
        slopes = slopes * jnp.stack(jax.tree.leaves(self.knowledge))[None]
        alike = jnp.eye(MOTION) if self.correlations is None else self.correlations
        instruments = self.accelerometers, self.gyroscopes
        sizes = jnp.stack(jax.tree.leaves(instruments))
        count = MOTION + sizes.size
        covariance = jnp.zeros((count, count))
        covariance = covariance.at[:MOTION, :MOTION].set(slopes @ alike @ slopes.T)
        covariance = covariance.at[MOTION:, MOTION:].set(jnp.diag(sizes**2))
        zero = jnp.zeros_like(state.altitude)
        accelerometers, gyroscopes = jax.tree.map(jnp.zeros_like, instruments)
        aiding = Aiding(
            accelerometers,
            gyroscopes,
            ErrorCovariance.now(covariance),
            jnp.zeros((MOTION, count)),
            zero,
            dict.fromkeys(self.sensors, zero),
            dict.fromkeys(self.sensors, zero),
        )
        slopes = self._slopes(planet, navigated, aiding, sensed)
        return dataclasses.replace(aiding, slopes=slopes)

    def update(
        self,
        planet: Planet,
        navigated: Navigated,
        aiding: Aiding,
        sensed: Sensed,
        at: Scalar,
        due: Flag,
        drawn: Callable[[int], Scalar],
    ) -> tuple[Navigated, Aiding]:
        """Navigation and filter after the measurements at a time.

        **Arguments:**

        - `planet`: as known on board.
        - `at`: time, s, a multiple of the cycle.
        - `due`: whether there is an update; if not, nothing changes.
        - `drawn`: standard normal numbers of this time, by their axis.
        """
        slopes = self._slopes(planet, navigated, aiding, sensed)
        slopes = jnp.where(due, slopes, aiding.slopes)
        seconds = jnp.where(due, self.cycle, 0.0)
        aiding = dataclasses.replace(
            aiding,
            covariance=self._later(aiding, slopes, navigated.state, seconds),
            slopes=slopes,
            updated_at=jnp.where(due, at, aiding.updated_at),
        )
        cycle = jnp.round(at / self.cycle).astype(int)
        measures = {
            name: (cycle % round(sensor.cycle / self.cycle) == 0)
            & sensor.senses(sensed)
            & due
            for name, sensor in self.sensors.items()
        }

        def corrected(known: tuple[Navigated, Aiding]) -> tuple[Navigated, Aiding]:
            navigated, aiding = known
            covariance = aiding.covariance.moved()
            aiding = dataclasses.replace(aiding, covariance=covariance)
            if not self.sensors:
                return navigated, aiding
            given = planet, navigated, aiding, sensed
            taken = self._measured(*given, at, measures, drawn)
            return _corrected(navigated, aiding, taken)

        moves = due & (cycle % max(1, round(_LONGEST / self.cycle)) == 0)
        for made in measures.values():
            moves = moves | made
        return where_due(moves, corrected, (navigated, aiding))

    def knowledge_at(
        self,
        planet: Planet,
        actual: EntryState,
        navigated: Navigated,
        aiding: Aiding,
        at: Scalar,
    ) -> Knowledge:
        """The knowledge error of a flight at a time, s, up to one cycle after an update."""
        since, state = at - aiding.updated_at, navigated.state
        later = self._later(aiding, aiding.slopes, state, since)
        covariance = later.moved().matrix
        off = derivatives(lambda n: difference(planet, state, n), _level(navigated))
        spread = off @ covariance[:MOTION, :MOTION] @ off.T
        sizes = jnp.sqrt(jnp.diag(spread))
        along = derivatives(
            lambda n: track_difference(planet, state, n.state), _level(navigated)
        )
        error = difference(planet, actual, navigated)
        share = jnp.stack(jax.tree.leaves(error)) / sizes
        alike = spread / (sizes[:, None] * sizes[None])
        return Knowledge(
            error,
            KnowledgeError(*(sizes[i] for i in range(MOTION))),
            share @ jnp.linalg.solve(alike, share),
            aiding.measured,
            aiding.rejected,
            TrackError(
                *jnp.sqrt(jnp.diag(along @ covariance[:MOTION, :MOTION] @ along.T))
            ),
        )

    def caveats(self, aiding: Aiding) -> dict[str, Scalar]:
        """Share of the measured values that were rejected, by the name of the caveat."""
        return {
            f"{name}_rejected": jnp.where(
                aiding.measured[name] > 0.0,
                count / jnp.maximum(aiding.measured[name], 1.0),
                0.0,
            )
            for name, count in aiding.rejected.items()
        }

    def _slopes(
        self, planet: Planet, navigated: Navigated, aiding: Aiding, sensed: Sensed
    ) -> Rows:
        """Derivatives of the rates of position, velocity and attitude."""

        def rates(known: Estimate) -> Navigated:
            # The vehicle turns what it senses by the axes that it believes.
            tilts = navigated.tilt, known.navigated.tilt
            axes, felt = sensed.axes, sensed.corrected(known.accelerometers)
            force = _turned(axes.to_planet(*felt.sensed_force()), *tilts)
            drift = axes.to_planet(*sensed.sensed_drift(known.gyroscopes))
            drift = _turned(drift, *tilts)
            turning = -drift[0], -drift[1], -drift[2]
            return Navigated(
                believed_motion(planet, known.navigated.state, force),
                tilting(planet, turning, known.navigated.tilt),
            )

        return derivatives(rates, _estimate(navigated, aiding))

    def _later(
        self, aiding: Aiding, slopes: Rows, state: EntryState, seconds: Scalar | float
    ) -> ErrorCovariance:
        """The covariance with what happens in a time, s, in which the slopes change."""
        mean = 0.5 * (aiding.slopes + slopes)
        return aiding.covariance.later(mean * seconds, self._walk(state) * seconds)

    def _walk(self, state: EntryState) -> Float[Array, " nine"]:
        """Growth of the variances by the noise of the instruments, each per second."""
        per_velocity = 1.0 / state.velocity
        across = per_velocity / jnp.cos(state.flight_path_angle)
        velocity, angle = self.velocity_random_walk, self.angle_random_walk
        nothing = 0.0 * per_velocity
        sizes = (
            velocity,
            velocity * per_velocity,
            velocity * across,
            angle,
            angle,
            angle,
        )
        return jnp.square(jnp.stack([nothing, nothing, nothing, *sizes]))

    def _measured(
        self,
        planet: Planet,
        navigated: Navigated,
        aiding: Aiding,
        sensed: Sensed,
        at: Scalar,
        measures: Mapping[str, Flag],
        drawn: Callable[[int], Scalar],
    ) -> dict[str, list[MeasuredValue]]:
        """The values of each sensor; `measures` says which of them measure."""
        known, axes = _estimate(navigated, aiding), sensed.body_axes()
        angle, error = sensed.air.angle_of_attack, sensed.actual.angle_of_attack_error
        angle = angle if error is None else angle + error

        def believed(known: Estimate) -> Believed:
            seen = axes.turned(navigated.tilt).turned(known.navigated.tilt)
            off = known.accelerometers
            return Believed(planet, known.navigated.state, seen, off, angle)

        def values(name: str, place: int) -> list[MeasuredValue]:
            sensor = self.sensors[name]
            first = _FIRST_AXIS + MOST_VALUES * place
            measured = sensor.measured(sensed, lambda i: drawn(first + i), at)
            here = believed(known)
            expected, sizes = sensor.expected(here), sensor.deviations(here)
            if not len(measured) == len(expected) == len(sizes) <= MOST_VALUES:
                raise ValueError(
                    f"sensors.{name} gives {len(measured)} measured values, "
                    f"{len(expected)} expected ones and {len(sizes)} standard "
                    f"deviations: give as many of each, up to {MOST_VALUES}"
                )
            made = measures[name]
            rows = derivatives(lambda known: sensor.expected(believed(known)), known)
            return [
                MeasuredValue(
                    jnp.where(made, measured[i] - expected[i], 0.0),
                    jnp.where(made, rows[i], 0.0),
                    sizes[i],
                    sensor.gate,
                    made,
                )
                for i in range(len(measured))
            ]

        return {name: values(name, i) for i, name in enumerate(self.sensors)}


_FIRST_AXIS = 11
"""First noise axis, after those of the inertial noise: the noise differs for equal seeds"""


def _corrected(
    navigated: Navigated, aiding: Aiding, taken: Mapping[str, list[MeasuredValue]]
) -> tuple[Navigated, Aiding]:
    """Navigation and filter after the measured values of each sensor."""
    values = [value for own in taken.values() for value in own]
    together = jax.tree.map(lambda *x: jnp.stack(x), *values)
    covariance, shift, rejected = aiding.covariance.corrected(together)
    # The correction of the tilt adds to the actual one, of which a part remains.
    known = Estimate(navigated, aiding.accelerometers, aiding.gyroscopes)
    before, rebuilt = ravel_pytree(known)
    after = rebuilt(before + shift)
    made, refused = dict(aiding.measured), dict(aiding.rejected)
    first = 0
    for name, own in taken.items():
        made[name] = made[name] + sum(jnp.where(value.made, 1.0, 0.0) for value in own)
        refused[name] = refused[name] + jnp.sum(rejected[first : first + len(own)])
        first = first + len(own)
    held = Aiding(
        after.accelerometers,
        after.gyroscopes,
        covariance,
        aiding.slopes,
        aiding.updated_at,
        made,
        refused,
    )
    return after.navigated, held


def _level(navigated: Navigated) -> Navigated:
    """What the vehicle believes: it knows of no tilt."""
    zero = 0.0 * navigated.state.altitude
    return Navigated(navigated.state, (zero, zero, zero))


def _estimate(navigated: Navigated, aiding: Aiding) -> Estimate:
    return Estimate(_level(navigated), aiding.accelerometers, aiding.gyroscopes)


def _turned(vector: Components, *tilts: Components) -> Components:
    """A vector after small rotations, one after the other."""
    for tilt in tilts:
        vector = added(vector, cross(tilt, vector))
    return vector
