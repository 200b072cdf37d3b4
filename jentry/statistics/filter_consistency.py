"""Is a navigation filter as good as it says? Its normalised error against chi-square."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..campaign.outputs import NORMALISED, at_end
from ..campaign.populations import finite_flights
from ..onboard.error_covariance import MOTION


if TYPE_CHECKING:
    import xarray


class Consistency(NamedTuple):
    """Average normalised error squared of many flights, with the bounds that it must keep
    if the filter is consistent."""

    average: float
    lower: float
    upper: float
    runs: int
    confidence: float = 0.99
    """Probability that the average of a consistent filter is within the bounds"""
    size: int = MOTION
    """Number of errors of a flight, the expected average of a consistent filter"""
    not_positive: int = 0
    """Number of flights that are left out, since their covariance is not positive"""

    @property
    def holds(self) -> bool:
        """Whether the average is within its bounds, and every covariance is positive."""
        return self.lower <= self.average <= self.upper and not self.not_positive

    @property
    def words(self) -> str:
        """Text that says whether the filter is consistent, too sure or too careful."""
        average, lower, upper = (x / self.size for x in self[:3])
        place, judgement = "within", "consistent"
        if average > upper:
            place, judgement = "above", "too sure: its errors are larger than it says"
        elif average < lower:
            place = "below"
            judgement = "too careful: its errors are smaller than it says"
        if self.not_positive:
            count = self.not_positive
            flights = "1 flight" if count == 1 else f"{count} flights"
            judgement = f"wrong: its covariance of {flights}, left out, is not positive"
        words = f"the navigation filter is {judgement}"
        if not self.runs:
            return words
        return (
            f"{words}. Mean of the normalised error squared at the end, over its "
            f"{self.size} components: {average:.4g}, {place} the chi-square bounds "
            f"{lower:.4g} and {upper:.4g} ({100.0 * self.confidence:.10g} % of sets of "
            f"{self.runs} runs)"
        )

    def plain(self) -> dict[str, Any]:
        """Dictionary of plain values."""
        return self._asdict() | {"consistent": self.holds}


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
    lower, upper = map(float, bounds)
    return Consistency(float(values.mean()), lower, upper, runs, confidence, size)


def consistency_of(
    results: "xarray.Dataset", confidence: float = 0.99
) -> Consistency | None:
    """Test of the navigation filter of a campaign by `consistency`, at the ends of flights.

    It takes the flights that count in statistics: they have an end, and all outputs are
    finite. Those whose covariance is not positive are left out and counted. None without a
    filter, or without such a flight.

    **Arguments:**

    - `results`: runs, as returned by `open_campaign` or `Campaign.to_xarray`.
    - `confidence`: as for `consistency`.

    **Raises:** `ValueError` for a confidence that is not between 0 and 1.

        print(consistency_of(open_campaign("results/mars-range-tracking")).words)
    """
    name = at_end(NORMALISED)
    if name not in results:
        return None
    values = finite_flights(results)[name].values
    if not values.size:
        return None
    positive = values[values >= 0.0]
    if positive.size:
        found = consistency(positive, confidence)
    else:
        found = Consistency(np.nan, np.nan, np.nan, 0, confidence)
    return found._replace(not_positive=values.size - positive.size)
