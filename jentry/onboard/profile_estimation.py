"""Factors of lift and drag as functions of the altitude, learnt on the way down.

What the vehicle has sensed where it was says something of the air below. How much is told
by a prior: a constant, a slope and waves, each with a standard deviation. The estimate is
that of linear least squares with this prior, which for waves laid by a correlation length
is the regression of a Gaussian process.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._math import safe_sqrt, sincos
from ..fields import NOT_NEGATIVE, Scalar, Vector, scalar, table
from .estimation import (
    AbstractFactorEstimate,
    AbstractFactorEstimator,
    AbstractFactors,
    FactorEstimate,
    FactorEstimator,
    Factors,
)


_LEAST_FACTOR = 0.2
"""Below it a factor is not believed, so that no drag becomes negative"""
_SPECTRUM = 1e-4
"""Share of the variance that the waves of a correlation length leave out"""


class Departure(eqx.Module):
    """What a factor may be, before anything is sensed: one, and a random departure.

    A constant, a slope and waves over the altitude, with independent normal amplitudes.
    """

    wavelengths: Vector = table(unit="m", positive=True)
    amplitudes: Vector = table()
    """Standard deviation of the sine, and of the cosine, of each wavelength: a wave whose
    amplitude is known and whose phase is not has its amplitude over the square root of 2"""
    constant: Scalar = scalar(0.1, range=NOT_NEGATIVE)
    """Standard deviation, in shares as all of them"""
    slope: Scalar = scalar(0.0, unit="1/m", range=NOT_NEGATIVE)
    """Standard deviation of the slope over the altitude"""
    pivot: Scalar = scalar(0.0, unit="m")
    """Altitude at which the slope adds nothing"""

    def __check_init__(self):
        shapes = jnp.shape(self.wavelengths), jnp.shape(self.amplitudes)
        if shapes[0] != shapes[1] or len(shapes[0]) != 1:
            raise ValueError(
                f"wavelengths and amplitudes have the shapes {shapes[0]} and {shapes[1]}: "
                "they must be two lists of one length"
            )

    @classmethod
    def correlated(
        cls,
        length: float,
        deviation: float,
        low: float,
        high: float,
        *,
        constant: float = 0.1,
        slope: float = 0.0,
    ) -> "Departure":
        """A departure that is known by a correlation length alone.

        Its correlation over a distance d is exp(-d^2 / (2 length^2)), but for a share of
        1e-4: between two altitudes, beyond which it repeats itself.

        **Arguments:**

        - `length`: m.
        - `deviation`: standard deviation, everywhere.
        - `low`, `high`: altitudes that are flown through, m.
        - `constant`, `slope`: of what does not vary, or not by itself.

        **Raises:** `ValueError` for a length that is not positive and finite, or not below
        the distance between the altitudes.
        """
        if not 0.0 < length < high - low:
            raise ValueError(
                f"length is {length} m: it must be positive, and below the "
                f"{high - low} m between low and high"
            )
        # On a circle twice as long the two ends know nothing of each other.
        around = 2.0 * (high - low)
        shares = [math.sqrt(2.0 * math.pi) * length / around]
        wavelengths: list[float] = []
        while sum(shares) < 1.0 - _SPECTRUM:
            order = len(shares)
            decay = 0.5 * (2.0 * math.pi * order * length / around) ** 2
            shares.append(2.0 * shares[0] * math.exp(-decay))
            wavelengths.append(around / order)
        return cls(
            wavelengths=jnp.asarray(wavelengths),
            amplitudes=deviation * jnp.sqrt(jnp.asarray(shares[1:])),
            constant=math.hypot(constant, deviation * math.sqrt(shares[0])),
            slope=slope,
            pivot=0.5 * (low + high),
        )

    def basis(self, altitude: Scalar) -> Float[Array, " weights"]:
        """Functions whose weights are normal, of mean 0 and variance 1, at an altitude."""
        turns = altitude / self.wavelengths
        sine, cosine = jax.vmap(sincos)(2.0 * math.pi * turns)
        line = jnp.stack([self.constant, self.slope * (altitude - self.pivot)])
        return jnp.concatenate([line, self.amplitudes * sine, self.amplitudes * cosine])


class FactorProfile(AbstractFactors):
    """Factors over the altitude: one, and a departure with weights."""

    departure: Departure
    lift: Float[Array, " weights"]
    drag: Float[Array, " weights"]

    def at(self, altitude: Scalar) -> Factors:
        basis = self.departure.basis(altitude)
        found = (1.0 + jnp.sum(basis * weights) for weights in (self.lift, self.drag))
        return Factors(*(jnp.maximum(factor, _LEAST_FACTOR) for factor in found))


class ProfileEstimate(AbstractFactorEstimate):
    """The factors where the vehicle is, and those over the altitude with covariances."""

    here: FactorEstimate
    profile: FactorProfile
    lift_covariance: Float[Array, "weights weights"]
    drag_covariance: Float[Array, "weights weights"]

    @property
    def factors(self) -> Factors:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.here.factors

    @property
    def ahead(self) -> FactorProfile:
        return self.profile

    def deviations(self, altitude: Scalar) -> Factors:
        """Standard deviations of the factors at an altitude (m), as the estimate has it."""
        basis = self.profile.departure.basis(altitude)
        both = self.lift_covariance, self.drag_covariance
        return Factors(*(safe_sqrt(basis @ covariance @ basis) for covariance in both))


class ProfileEstimator(AbstractFactorEstimator[ProfileEstimate]):
    """Recursive least squares of a departure over the altitude, for each axis.

    What is sensed where the vehicle is goes by `here`, as without a profile: a loop that
    is closed about the present force needs the last sample, and not a fit. The profile is
    for what is ahead.
    """

    departure: Departure
    noise: Scalar = scalar(1e-3, unit="m/s2", positive=True)
    """Standard deviation of a sample of lift, or of drag"""
    misfit: Scalar = scalar(1e-3, positive=True)
    """Standard deviation of what the departure cannot be, in shares"""
    here: FactorEstimator = eqx.field(default_factory=FactorEstimator)

    def start(self, like: Scalar) -> ProfileEstimate:
        nothing = 0.0 * like
        basis = self.departure.basis(nothing)
        weights = 0.0 * basis
        covariance = jnp.eye(basis.shape[0]) + nothing
        profile = FactorProfile(self.departure, weights, weights)
        return ProfileEstimate(self.here.start(like), profile, covariance, covariance)

    def update(
        self,
        estimate: ProfileEstimate,
        altitude: Scalar,
        sensed: tuple[Scalar, Scalar],
        expected: tuple[Scalar, Scalar],
        elapsed: Scalar,
    ) -> ProfileEstimate:
        here = self.here.update(estimate.here, altitude, sensed, expected, elapsed)
        basis, profile = self.departure.basis(altitude), estimate.profile

        def refined(weights, covariance, axis):
            force = expected[axis]
            row = force * basis
            spread = covariance @ row
            error = self.noise * self.noise + (self.misfit * force) ** 2
            per_variance = 1.0 / (jnp.sum(row * spread) + error)
            surprise = sensed[axis] - force - jnp.sum(row * weights)
            weights = weights + spread * (per_variance * surprise)
            return weights, covariance - per_variance * jnp.outer(spread, spread)

        lift, lift_covariance = refined(profile.lift, estimate.lift_covariance, 0)
        drag, drag_covariance = refined(profile.drag, estimate.drag_covariance, 1)
        learnt = FactorProfile(self.departure, lift, drag)
        return ProfileEstimate(here, learnt, lift_covariance, drag_covariance)
