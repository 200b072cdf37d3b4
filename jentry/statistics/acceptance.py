"""Acceptance: whether the runs of a campaign demonstrate a requirement.

The number of runs that fail a requirement is binomial, whatever the distribution of the
quantity. The method is that of J. M. Hanson and B. B. Beard, "Applying Monte Carlo
Simulation to Launch Vehicle Design and Requirements Analysis", NASA/TP-2010-216447, 2010.
"""

import bisect
import dataclasses
import enum
import json
import math
import re
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from .._printed import in_words, quantity_in_words
from ..addresses import nearest
from ..campaign.outputs import difference_of, is_error
from ..campaign.results import output_names
from ..flight.closed_loop import caveat_names
from ..flight.scenario import Scenario
from ..flight.termination import Outcome, has_end
from ..units import Quantity, forgotten_unit, quantity
from .intervals import share_bound


if TYPE_CHECKING:
    import xarray


REACHED = "reached"
"""Name of the quantity in a requirement on the outcome"""

_MOST = 10**9
"""Limit of the search for a number of runs"""

_FORM = re.compile(
    r"(?P<what>[^<>=,]+?)\s*(?:(?P<sign><=|>=|<|>)\s*(?P<limit>[^<>=,]+?))?\s*,"
    r"\s*(?P<share>[^,%]+?)\s*%\s*at\s*(?P<confidence>[^,%]+?)\s*%"
)

EXAMPLE = "|downrange_error| < 10 km, 99 % at 90 %"
"""Example of a requirement, for help and messages"""


class Decision(enum.Enum):
    """Result of the test of a requirement."""

    PASSES = "passes"
    FAILS = "fails"
    NOT_ENOUGH_RUNS = "not enough runs"


@dataclasses.dataclass(frozen=True)
class Requirement:
    """A condition with the share of flights that must meet it, and a confidence.

    `|downrange_error| < 10 km, 99 % at 90 %` requires, with a confidence of 90 %, that the
    downrange error is less than 10 km in at least 99 % of all flights.
    `reached, 99 % at 90 %` requires that at least 99 % of them reach the end of guided
    flight.
    """

    quantity: str
    """Name of a variable of the results, or `reached`"""
    magnitude: bool
    """Whether the magnitude of the quantity is compared with the limit"""
    sign: str
    """Comparison with the limit: <, <=, > or >=; empty for `reached`"""
    limit: Quantity
    share: float
    """Smallest share of the flights that must meet the condition, between 0 and 1"""
    confidence: float

    @classmethod
    def of(cls, text: str) -> "Requirement":
        """Read a requirement from text.

        **Raises:** `ValueError` for text in another form, and for a share or a confidence
        that is not between 0 and 100 %.
        """
        found = _FORM.fullmatch(text.strip())
        if found is None:
            raise ValueError(
                f"requirement {text!r} is not understood: write it as in {EXAMPLE!r} or "
                f"'{REACHED}, 99 % at 90 %'"
            )
        what = found["what"].strip()
        magnitude = len(what) > 2 and what.startswith("|") and what.endswith("|")
        name = re.sub(r"[\s-]+", "_", what.strip("|").strip() if magnitude else what)
        if (name == REACHED) != (found["sign"] is None) or (
            name == REACHED and magnitude
        ):
            raise ValueError(
                f"requirement {text!r}: {REACHED} stands alone, and every other quantity "
                f"is compared with a limit, as in {EXAMPLE!r}"
            )
        limit = quantity(found["limit"]) if found["limit"] else quantity(0.0)
        if not math.isfinite(limit.number):
            raise ValueError(f"requirement {text!r}: the limit must be a finite number")
        if magnitude and limit.number < 0.0:
            raise ValueError(
                f"requirement {text!r}: a magnitude is never below zero; write a limit "
                f"that is not negative, or {name} without the bars for its sign"
            )
        return cls(
            quantity=name,
            magnitude=magnitude,
            sign=found["sign"] or "",
            limit=limit,
            share=_percentage(found["share"], "share of the flights", text),
            confidence=_percentage(found["confidence"], "confidence", text),
        )

    @property
    def text(self) -> str:
        """The requirement as text, which `of` reads."""
        bars = "|" if self.magnitude else ""
        limit = f" {self.sign} {self.limit.text}" if self.sign else ""
        return (
            f"{bars}{self.quantity}{bars}{limit}, {100.0 * self.share:.10g} % at "
            f"{100.0 * self.confidence:.10g} %"
        )

    @property
    def caution(self) -> str | None:
        """Warning that an error without bars has a sign, or None."""
        if is_error(self.quantity) and not self.magnitude:
            words = in_words(self.quantity)
            return (
                f"the {words} has a sign, {difference_of(self.quantity)}: "
                f"|{self.quantity}| asks about its magnitude"
            )
        return None


def _percentage(text: str, what: str, whole: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < 100.0:
        raise ValueError(
            f"requirement {whole!r}: the {what} is {text} %: it must be a number above 0 "
            "and below 100"
        )
    return value / 100.0


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Result of a requirement for the runs of a campaign."""

    requirement: Requirement
    runs: int
    failures: int
    """Runs that do not meet the condition, including those without an end"""
    without_end: int
    """Runs without an end, or with a quantity that is not finite. They count as failures"""
    decision: Decision
    bound: float
    """Upper bound of the probability of failure, with the confidence of the requirement"""
    more_runs: int | None
    """Additional runs needed to pass if none of them fails. None if it is decided, or
    if the search finds no number"""
    more_runs_at_this_rate: int | None
    """Additional runs needed to pass if the rate of failure remains. None if it is decided,
    if the rate is too high to pass, or if the search finds no number"""
    sequential: bool
    """Whether the test is valid for runs that were added until it was decided"""

    def plain(self) -> dict[str, Any]:
        """Dictionary of plain values."""
        return {
            "requirement": self.requirement.text,
            "decision": self.decision.value,
            "runs": self.runs,
            "failures": self.failures,
            "without_end": self.without_end,
            "bound_on_failure_probability": self.bound,
            "confidence": self.requirement.confidence,
            "more_runs": self.more_runs,
            "more_runs_at_this_rate": self.more_runs_at_this_rate,
            "sequential": self.sequential,
        }


def require_outputs(
    requirements: Iterable[Requirement], scenario: Scenario, inputs: Iterable[str]
) -> None:
    """Check before any flight that the results will have the quantities of requirements.

    **Arguments:**

    - `inputs`: addresses of the dispersed inputs.

    **Raises:** `ValueError`, with the nearest names, for any other quantity.
    """
    known, inputs = [*output_names(scenario), REACHED], set(inputs)
    asked = [r for r in requirements if r.quantity not in {*known, *inputs}]
    if asked:
        known += caveat_names(scenario)
    for each in asked:
        if each.quantity not in known:
            raise ValueError(
                f"requirement {each.text!r}: the results will have no {each.quantity}; "
                f"{nearest(each.quantity, known)}"
            )


def judged(
    results: "xarray.Dataset", requirement: Requirement, *, sequential: bool = False
) -> Verdict:
    """Test a requirement on the runs of a campaign.

    **Arguments:**

    - `results`: all runs, as returned by `open_campaign`. Runs without an end fail.
    - `sequential`: whether runs were added until the requirement was decided. The usual
      test is valid for one evaluation, at a number of runs that was chosen beforehand. If
      it is repeated as runs are added, it errs more often than its confidence states. The
      sequential test may be repeated after every run, and needs more runs.

    **Raises:** `ValueError` for a quantity that the results do not have, for a limit in a
    unit of another dimension, for a limit without a unit that was probably meant in another
    one than SI, for results without runs, and for runs that a sampler has
    spread evenly.
    """
    if "sampler" in json.loads(results.attrs.get("campaign", "{}")):
        raise ValueError(
            "these runs are spread evenly by a sampler, and a requirement is judged from "
            "independent runs: fly plain draws"
        )
    failed, without_end = _failed(requirement, results)
    runs, failures = len(failed), int(np.sum(failed))
    allowed, risk = 1.0 - requirement.share, 1.0 - requirement.confidence
    test = _SEQUENTIAL if sequential else _FIXED
    if test.passes(failures, runs, allowed, risk):
        decision = Decision.PASSES
    elif test.fails(failures, runs, allowed, risk):
        decision = Decision.FAILS
    else:
        decision = Decision.NOT_ENOUGH_RUNS
    more = at_rate = None
    if decision is Decision.NOT_ENOUGH_RUNS:
        more = _least(lambda n: test.passes(failures, n, allowed, risk), runs)
        rate = failures / runs
        if rate < allowed:
            at_rate = _least(lambda n: test.passes(rate * n, n, allowed, risk), runs)
    return Verdict(
        requirement=requirement,
        runs=runs,
        failures=failures,
        without_end=without_end,
        decision=decision,
        bound=test.bound(failures, runs, risk),
        more_runs=more,
        more_runs_at_this_rate=at_rate,
        sequential=sequential,
    )


def runs_needed(failures: int, share: float, confidence: float) -> int:
    """Smallest number of runs that demonstrates a share in spite of some failures.

    It is the smallest n with P(X <= failures) <= 1 - confidence, where X is binomial with n
    trials of probability 1 - share.

    **Raises:** `ValueError` if the search finds no number.
    """
    allowed, risk = 1.0 - share, 1.0 - confidence
    found = _least(lambda n: _FIXED.passes(failures, n, allowed, risk), failures)
    if found is None:
        raise ValueError(
            f"a share of {share:g} with a confidence of {confidence:g} takes more than "
            f"{_MOST:.0e} runs: ask for less"
        )
    return failures + found


def _failed(
    requirement: Requirement, results: "xarray.Dataset"
) -> tuple[np.ndarray, int]:
    """Which runs fail a requirement, and how many of them have no end or no number."""
    if results.sizes.get("run", 0) == 0:
        raise ValueError("there are no runs to judge: fly some")
    outcomes = results["outcome"].values
    ended = np.asarray(has_end(outcomes))
    if requirement.quantity == REACHED:
        return outcomes != int(Outcome.REACHED), int(np.sum(~ended))
    values, limit = _compared(requirement, results)
    told = ended & np.isfinite(values)
    if requirement.magnitude:
        values = np.abs(values)
    _require_unit(requirement, results, np.abs(values[told]), limit)
    with np.errstate(invalid="ignore"):
        kept = {
            "<": values < limit,
            "<=": values <= limit,
            ">": values > limit,
            ">=": values >= limit,
        }[requirement.sign]
    return ~(told & kept), int(np.sum(~told))


def _require_unit(
    requirement: Requirement,
    results: "xarray.Dataset",
    sizes: np.ndarray,
    limit: float,
) -> None:
    """Refuse a limit without a unit that was probably meant in another one than SI.

    It is compared with the median of the magnitudes: see `forgotten_unit`.
    """
    if requirement.limit.unit or not sizes.size:
        return
    unit = results[requirement.quantity].attrs.get("units", "1")
    middle = float(np.median(sizes))
    meant = forgotten_unit(limit, middle, unit)
    if meant:
        number = requirement.limit.text
        raise ValueError(
            f"requirement {requirement.text!r}: the limit is without a unit, and the "
            f"median of the runs is {quantity_in_words(middle, unit)}: did you mean "
            f"{number}{meant}? Write the unit, {number} {meant} or {number} {unit}"
        )


def _compared(
    requirement: Requirement, results: "xarray.Dataset"
) -> tuple[np.ndarray, float]:
    """Values of a quantity and its limit, in the same unit."""
    known = [
        str(name)
        for name, values in results.data_vars.items()
        if values.dims == ("run",) and "flag_values" not in values.attrs
    ]
    name = requirement.quantity
    if name not in known:
        outputs = [other for other in known if "." not in other]
        raise ValueError(
            f"requirement {requirement.text!r}: the results have no {name}; "
            f"{nearest(name, [*outputs, REACHED])}"
        )
    attributes = results[name].attrs
    unit = attributes.get("units", "1")
    if requirement.limit.unit and requirement.limit.unit == attributes.get(
        "shown_units"
    ):
        return results[name].values, requirement.limit.number
    try:
        return results[name].values, requirement.limit.si(unit)
    except ValueError as error:
        raise ValueError(f"requirement {requirement.text!r}: {error}") from None


def _least(passes: Callable[[int], bool], runs: int) -> int | None:
    """Smallest number of additional runs with which a test passes, or None."""
    most = 1
    while not passes(runs + most):
        most *= 2
        if most > _MOST:
            return None
    return bisect.bisect_left(range(most), True, key=lambda more: passes(runs + more))


class _FixedTest:
    """Exact binomial test, for a number of runs that was chosen beforehand.

    It uses the incomplete beta function, which is defined for fractional numbers of
    failures as well. Its limits for no failure and for failures only are 1.
    """

    # `scipy.stats.binomtest` takes whole numbers only. It decides alike, and takes 15 to 20
    # times as long for each of some 60 calls, and 0.4 s to import.

    def passes(
        self, failures: int | float, runs: int, allowed: float, risk: float
    ) -> bool:
        from scipy.special import betaincc

        at_most = betaincc(failures + 1.0, runs - failures, allowed)
        return bool(at_most <= risk)

    def fails(
        self, failures: int | float, runs: int, allowed: float, risk: float
    ) -> bool:
        from scipy.special import betainc

        at_least = betainc(failures, runs - failures + 1.0, allowed)
        return bool(at_least <= risk)

    def bound(self, failures: int, runs: int, risk: float) -> float:
        return share_bound(failures, runs, risk)


class _SequentialTest:
    """Sequential test by a mixture of likelihood ratios, for runs added until it decides.

    The statistic is a ratio. Its numerator is the likelihood of the runs, averaged over all
    probabilities of failure on one side of the allowed probability. Its denominator is
    their likelihood at the allowed probability. If the true probability is on the other
    side, the ratio ever exceeds 1 / risk with a probability of at most `risk`, however many
    runs are evaluated (J. Ville, 1939; H. Robbins, Annals of Mathematical Statistics 41(5),
    1970).
    """

    def passes(
        self, failures: int | float, runs: int, allowed: float, risk: float
    ) -> bool:
        return self._evidence(failures, runs, allowed, below=True) >= -math.log(risk)

    def fails(
        self, failures: int | float, runs: int, allowed: float, risk: float
    ) -> bool:
        return self._evidence(failures, runs, allowed, below=False) >= -math.log(risk)

    def bound(self, failures: int, runs: int, risk: float) -> float:
        # `scipy.optimize.brentq` saves 0.1 ms, and takes 0.1 s to import.
        low, high = failures / runs, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            if self.passes(failures, runs, middle, risk):
                high = middle
            else:
                low = middle
        return high

    def _evidence(
        self, failures: int | float, runs: int, allowed: float, below: bool
    ) -> float:
        """Logarithm of the averaged likelihood over that at the allowed probability."""
        from scipy.special import betainc, betaincc, betaln, xlog1py, xlogy

        a, b = failures + 1.0, runs - failures + 1.0
        side, width = (
            (betainc(a, b, allowed), allowed)
            if below
            else (betaincc(a, b, allowed), 1.0 - allowed)
        )
        if side == 0.0:
            return -math.inf
        averaged = betaln(a, b) + math.log(side) - math.log(width)
        exact = xlogy(failures, allowed) + xlog1py(runs - failures, -allowed)
        return float(averaged - exact)


_FIXED, _SEQUENTIAL = _FixedTest(), _SequentialTest()


def overall(verdicts: Iterable[Verdict]) -> Decision:
    """Decision on several requirements together.

    It fails if one of them fails, and passes if all of them pass or there is none.
    """
    decisions = {verdict.decision for verdict in verdicts}
    for decision in (Decision.FAILS, Decision.NOT_ENOUGH_RUNS):
        if decision in decisions:
            return decision
    return Decision.PASSES
