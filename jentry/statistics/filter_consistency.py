"""Is a navigation filter as good as it says? Its normalised error against chi-square."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..onboard.error_covariance import MOTION


class Consistency(NamedTuple):
    """Average normalised error squared of many flights, with the bounds that it must keep
    if the filter is consistent."""

    average: float
    lower: float
    upper: float
    runs: int

    @property
    def holds(self) -> bool:
        """Whether the average is within its bounds."""
        return self.lower <= self.average <= self.upper


def consistency(
    normalised_error_squared: ArrayLike,
    confidence: float = 0.99,
    size: int = MOTION,
) -> Consistency:
    """Test of a navigation filter by the average normalised error squared of its flights.

    If the errors are normal with the covariance of the filter, the sum over the flights is
    distributed as chi-square. An average above the upper bound says that the filter
    believes too much of itself, one below the lower bound that it believes too little.

    Reference: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to
    Tracking and Navigation*, 2001, section 5.4.

    **Arguments:**

    - `normalised_error_squared`: array of the values of finished flights, such as those of
        `Flight.knowledge.normalised_error_squared`.
    - `confidence`: probability that the average of a consistent filter is within the
        bounds.
    - `size`: number of errors, 9 for position, velocity and attitude.

    **Raises:** `ValueError` without flights, for values that are negative or not finite,
    and for a confidence that is not between 0 and 1.
    """
    from scipy.stats import chi2

    values = np.asarray(normalised_error_squared, float).ravel()
    if not values.size:
        raise ValueError("there are no flights: give one value for each")
    wrong = np.flatnonzero(~(np.isfinite(values) & (values >= 0.0)))
    if wrong.size:
        raise ValueError(
            f"normalised_error_squared[{wrong[0]}] is {values[wrong[0]]}: it must be "
            "finite and not negative; leave out flights without an end"
        )
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence is {confidence}: it must be between 0 and 1")
    runs = values.size
    tail = 0.5 * (1.0 - confidence)
    bounds = chi2.ppf([tail, 1.0 - tail], size * runs) / runs
    return Consistency(float(values.mean()), float(bounds[0]), float(bounds[1]), runs)
