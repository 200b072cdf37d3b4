"""Factors of lift and drag as functions of the altitude, estimated during the entry.

Forces sensed at the vehicle carry information on the air below. A prior defines how much:
a constant, a slope and waves, each with a standard deviation. The estimate is that of
linear least squares with this prior. With waves for a correlation length this is the
regression of a Gaussian process.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._math import safe_sqrt, sincos
from ..fields import NOT_NEGATIVE, Scalar, Vector, optional_scalar, scalar, table
from .estimation import (
    AbstractFactorEstimate,
    AbstractFactorEstimator,
    AbstractFactors,
    FactorEstimate,
    FactorEstimator,
    Factors,
)


_LEAST_FACTOR = 0.2
"""Lower bound of a factor, so that no drag becomes negative"""
_SURPRISE = 4.0
"""Standard deviations beyond which a sample contradicts the prior"""
_SPECTRUM = 1e-4
"""Share of the variance that the waves for a correlation length leave out"""


class FactorPrior(eqx.Module):
    """Prior of a factor: one, plus a random departure.

    The departure is a constant, a slope and waves over the altitude, with independent
    normal amplitudes.
    """

    wavelengths: Vector = table(unit="m", positive=True)
    amplitudes: Vector = table()
    """Standard deviation of the sine, and of the cosine, of each wavelength. For a wave of
    known amplitude and unknown phase it is the amplitude over the square root of 2"""
    constant: Scalar = scalar(0.1, range=NOT_NEGATIVE)
    """Standard deviation of the constant; a share, like all of them"""
    slope: Scalar = scalar(0.0, unit="1/m", range=NOT_NEGATIVE)
    """Standard deviation of the slope over the altitude"""
    pivot: Scalar = scalar(0.0, unit="m")
    """Altitude at which the slope contributes zero"""

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
    ) -> "FactorPrior":
        """A departure that is defined by a correlation length.

        Its correlation over a distance d is exp(-d^2 / (2 length^2)), with an error of
        1e-4 of the variance. This holds between two altitudes; beyond them the departure
        is periodic.

        **Arguments:**

        - `length`: m.
        - `deviation`: standard deviation, at all altitudes.
        - `low`, `high`: range of altitudes of the flight, m; five lengths apart or more.
        - `constant`, `slope`: standard deviations of an additional constant and slope.

        **Raises:** `ValueError` for numbers outside of these ranges, or not finite.
        """
        if not 0.0 < 5.0 * length <= high - low < math.inf:
            raise ValueError(
                f"length is {length} m, and the altitudes are {low} and {high} m: the "
                "length must be positive, and at most a fifth of the way between them"
            )
        if not 0.0 <= deviation < math.inf:
            raise ValueError(
                f"deviation is {deviation}: it must be zero or positive, and finite"
            )
        # On a circle twice as long the two ends are uncorrelated.
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
        """Functions at an altitude whose weights are normal, of mean 0 and variance 1."""
        turns = altitude / self.wavelengths
        sine, cosine = jax.vmap(sincos)(2.0 * math.pi * turns)
        line = jnp.stack([self.constant, self.slope * (altitude - self.pivot)])
        return jnp.concatenate([line, self.amplitudes * sine, self.amplitudes * cosine])


class Learnt(eqx.Module):
    """Weights of a departure along one axis, with their covariance."""

    weights: Float[Array, " weights"]
    covariance: Float[Array, "weights weights"]

    def refined(
        self,
        row: Float[Array, " weights"],
        departed: Scalar,
        variance: Scalar,
    ) -> tuple["Learnt", Scalar]:
        """Estimate after a sample, and how surprising the sample was.

        The surprise is the innovation in standard deviations of the prediction and the
        sample, whose variance is `variance`. `departed` is the sampled value minus that
        for weights of zero. `row` is the change of the value per unit of each weight.
        """
        spread = self.covariance @ row
        per_variance = 1.0 / (jnp.sum(row * spread) + variance)
        surprise = departed - jnp.sum(row * self.weights)
        weights = self.weights + spread * (per_variance * surprise)
        covariance = self.covariance - per_variance * jnp.outer(spread, spread)
        return Learnt(weights, covariance), jnp.abs(surprise) * safe_sqrt(per_variance)


class FactorProfile(AbstractFactors):
    """Factors over the altitude: one, plus a departure with estimated weights."""

    departure: FactorPrior
    lift: Learnt
    drag: Learnt
    caution: Scalar | None
    """Standard deviations by which the factors are reduced"""

    def at(self, altitude: Scalar) -> Factors:
        basis = self.departure.basis(altitude)

        def factor(learnt: Learnt) -> Scalar:
            found = 1.0 + jnp.sum(basis * learnt.weights)
            if self.caution is not None:
                found = found - self.caution * _deviation(basis, learnt)
            return jnp.maximum(found, _LEAST_FACTOR)

        return Factors(factor(self.lift), factor(self.drag))

    def deviations(self, altitude: Scalar) -> Factors:
        """Standard deviations of the factors at an altitude (m), by the estimate."""
        basis = self.departure.basis(altitude)
        return Factors(_deviation(basis, self.lift), _deviation(basis, self.drag))


def _deviation(basis: Float[Array, " weights"], learnt: Learnt) -> Scalar:
    # By rounding it may become negative where the uncertainty is zero.
    return safe_sqrt(basis @ learnt.covariance @ basis)


class ProfileEstimate(AbstractFactorEstimate):
    """The factors at the vehicle, and those over the altitude."""

    here: FactorEstimate
    profile: FactorProfile
    samples: Scalar
    """Number of samples so far"""
    surprises: Scalar
    """Number of samples that the prior and the earlier samples make improbable"""

    @property
    def factors(self) -> Factors:
        return self.here.factors

    @property
    def ahead(self) -> FactorProfile:
        return self.profile

    def caveats(self) -> dict[str, Scalar]:
        share = self.surprises / jnp.maximum(self.samples, 1.0)
        return {"surprising_samples": share}


class ProfileEstimator(AbstractFactorEstimator[ProfileEstimate]):
    """Recursive least squares of a departure over the altitude, for each axis.

    The factors at the vehicle are those of `here`, as without a profile: a loop that is
    closed about the present force needs the last sample, and not a fit. The profile is
    for predictions.

    A prior that is too smooth for the air is worse than none, since it extrapolates with
    false confidence. The samples then contradict it. `Flight.caveats` has the share of
    samples beyond four standard deviations, `surprising_samples`.
    """

    departure: FactorPrior
    noise: Scalar = scalar(1e-3, unit="m/s2", positive=True)
    """Standard deviation of a sample of lift, or of drag"""
    misfit: Scalar = scalar(2e-3, positive=True)
    """Standard deviation of what the departure cannot represent, as a share"""
    caution: Scalar | None = optional_scalar()
    """Standard deviations by which the predicted forces are reduced; None for no
    reduction. For a law to which too much velocity is worse than too little"""
    here: FactorEstimator = eqx.field(default_factory=FactorEstimator)

    def start(self, like: Scalar) -> ProfileEstimate:
        nothing = 0.0 * like
        weights = 0.0 * self.departure.basis(nothing)
        learnt = Learnt(weights, jnp.eye(weights.shape[0]) + nothing)
        profile = FactorProfile(self.departure, learnt, learnt, self.caution)
        return ProfileEstimate(self.here.start(like), profile, nothing, nothing)

    def update(
        self,
        estimate: ProfileEstimate,
        altitude: Scalar,
        sensed: tuple[Scalar, Scalar],
        expected: tuple[Scalar, Scalar],
        elapsed: Scalar,
    ) -> ProfileEstimate:
        here = self.here.update(estimate.here, altitude, sensed, expected, elapsed)
        basis = self.departure.basis(altitude)
        profile = estimate.profile

        def refined(learnt: Learnt, axis: int) -> tuple[Learnt, Scalar]:
            variance = self.noise * self.noise + (self.misfit * expected[axis]) ** 2
            departed = sensed[axis] - expected[axis]
            return learnt.refined(expected[axis] * basis, departed, variance)

        lift, by_lift = refined(profile.lift, 0)
        drag, by_drag = refined(profile.drag, 1)
        # NaN is a surprise.
        expected_so = jnp.maximum(by_lift, by_drag) <= _SURPRISE
        return ProfileEstimate(
            here,
            FactorProfile(self.departure, lift, drag, self.caution),
            estimate.samples + 1.0,
            estimate.surprises + jnp.where(expected_so, 0.0, 1.0),
        )
