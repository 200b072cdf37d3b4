"""Acceptance: whether the runs of a campaign demonstrate what is required.

A requirement is demonstrated by order statistics: the number of runs that fail it is
binomial, whatever the distribution of the quantity. After J. M. Hanson and B. B. Beard,
"Applying Monte Carlo Simulation to Launch Vehicle Design and Requirements Analysis",
NASA/TP-2010-216447, 2010.
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

from .._printed import in_words
from ..addresses import nearest
from ..campaign.outputs import is_error
from ..campaign.results import output_names
from ..flight.closed_loop import caveat_names
from ..flight.scenario import Scenario
from ..flight.termination import Outcome, has_end
from ..units import Quantity, quantity


if TYPE_CHECKING:
    import xarray


REACHED = "reached"
"""The quantity of a requirement on the outcome"""

_MOST = 10**9
"""Runs; what takes more is not told in runs"""

_FORM = re.compile(
    r"(?P<what>[^<>=,]+?)\s*(?:(?P<sign><=|>=|<|>)\s*(?P<limit>[^<>=,]+?))?\s*,"
    r"\s*(?P<share>[^,%]+?)\s*%\s*at\s*(?P<confidence>[^,%]+?)\s*%"
)

EXAMPLE = "|downrange_error| < 10 km, 99 % at 90 %"


class Decision(enum.Enum):
    """What the runs say of a requirement."""

    PASSES = "passes"
    FAILS = "fails"
    NOT_ENOUGH_RUNS = "not enough runs"


@dataclasses.dataclass(frozen=True)
class Requirement:
    """That a share of all flights keeps a limit, with a confidence.

    `|downrange_error| < 10 km, 99 % at 90 %` wants that at least 99 % of the flights miss
    by less than 10 km, and that one is 90 % confident of it. `reached, 99 % at 90 %` wants
    that they reach the end of guided flight.
    """

    quantity: str
    """Name of a variable of the results, or `reached`"""
    magnitude: bool
    """Whether the magnitude of the quantity is asked about"""
    sign: str
    """How it is compared with the limit: <, <=, > or >="""
    limit: Quantity
    share: float
    """Of the flights, at least"""
    confidence: float

    @classmethod
    def of(cls, text: str) -> "Requirement":
        """A requirement as it is written.

        Raises `ValueError` for what has another form, and for shares and confidences that
        are not between 0 and 100 %.
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
        """As it is written."""
        bars = "|" if self.magnitude else ""
        limit = f" {self.sign} {self.limit.text}" if self.sign else ""
        return (
            f"{bars}{self.quantity}{bars}{limit}, {100.0 * self.share:.10g} % at "
            f"{100.0 * self.confidence:.10g} %"
        )

    @property
    def caution(self) -> str | None:
        """What a reader may take it for, and it is not."""
        if is_error(self.quantity) and not self.magnitude:
            words = in_words(self.quantity)
            return (
                f"the {words} has a sign, actual minus desired: |{self.quantity}| asks "
                "about its magnitude"
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
    """What the runs of a campaign say of a requirement."""

    requirement: Requirement
    runs: int
    failures: int
    """Runs that do not keep it, those without an end included"""
    without_end: int
    """Runs without an end, or whose quantity is not finite: they count as failures"""
    decision: Decision
    bound: float
    """The probability of failure is below this, with the requirement's confidence"""
    more_runs: int | None
    """How many more it takes to pass if none of them fails; None if it is decided"""
    more_runs_at_this_rate: int | None
    """How many more it takes to pass if they fail as often as those did; None if that is
    too often to pass ever, or if it is decided"""
    sequential: bool
    """Whether it holds for runs that were added until it was decided"""

    def plain(self) -> dict[str, Any]:
        """As plain values."""
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
    """Refuse requirements on what results of a scenario will not have, before any flight.

    **Arguments:**

    - `inputs`: addresses of what is dispersed.

    **Raises:** `ValueError` with the nearest names.
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
    requirement: Requirement, results: "xarray.Dataset", *, sequential: bool = False
) -> Verdict:
    """What the runs of a campaign say of a requirement.

    **Arguments:**

    - `results`: all runs, as `open_campaign` gives them. Runs without an end fail.
    - `sequential`: for runs that were added until it was decided. Looking again and again
      at a test that is meant for one look makes it wrong more often than it promises; the
      sequential one may be looked at after every run, and takes more of them.

    **Raises:** `ValueError` for a quantity that the results do not have, for a limit in a
    unit of another dimension, and for runs that a sampler has spread evenly.
    """
    if "sampler" in json.loads(results.attrs.get("campaign", "{}")):
        raise ValueError(
            "these runs are spread evenly by a sampler, and a requirement is judged of "
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
    """Runs of which so many may fail, and a share of successes is demonstrated.

    Smallest n with P(X <= failures) <= 1 - confidence for X binomial of n and 1 - share.
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
    """Which runs fail a requirement, and how many of them have no end."""
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
    with np.errstate(invalid="ignore"):
        kept = {
            "<": values < limit,
            "<=": values <= limit,
            ">": values > limit,
            ">=": values >= limit,
        }[requirement.sign]
    return ~(told & kept), int(np.sum(~told))


def _compared(
    requirement: Requirement, results: "xarray.Dataset"
) -> tuple[np.ndarray, float]:
    """Values of a quantity and its limit, both SI."""
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
    """How many runs more than these it takes until it passes."""
    most = 1
    while not passes(runs + most):
        most *= 2
        if most > _MOST:
            return None
    return bisect.bisect_left(range(most), True, key=lambda more: passes(runs + more))


class _FixedTest:
    """Of a number of runs that was chosen before they were looked at: exact binomial.

    By the incomplete beta function, which goes on between whole numbers of failures.
    """

    def passes(
        self, failures: int | float, runs: int, allowed: float, risk: float
    ) -> bool:
        from scipy.special import betaincc

        if failures >= runs:
            return False
        at_most = betaincc(failures + 1.0, runs - failures, allowed)
        return bool(at_most <= risk)

    def fails(
        self, failures: int | float, runs: int, allowed: float, risk: float
    ) -> bool:
        from scipy.special import betainc

        if failures == 0:
            return False
        at_least = betainc(failures, runs - failures + 1.0, allowed)
        return bool(at_least <= risk)

    def bound(self, failures: int, runs: int, risk: float) -> float:
        """Of Clopper and Pearson."""
        from scipy.special import betaincinv

        if failures == runs:
            return 1.0
        return float(betaincinv(failures + 1, runs - failures, 1.0 - risk))


class _SequentialTest:
    """Of runs that are added until it is decided: a mixture of likelihood ratios.

    The likelihood of the runs, averaged over all probabilities of failure on one side of
    the allowed one, over that of the allowed one. If the truth is on the other side, it
    exceeds 1 / risk with a probability of at most `risk`, at whatever number of runs one
    looks (J. Ville, 1939; H. Robbins, Annals of Mathematical Statistics 41(5), 1970).
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
        """Logarithm of the averaged likelihood over that of the allowed probability."""
        from scipy.special import betainc, betaincc, betaln

        a, b = failures + 1.0, runs - failures + 1.0
        side, width = (
            (betainc(a, b, allowed), allowed)
            if below
            else (betaincc(a, b, allowed), 1.0 - allowed)
        )
        if side == 0.0:
            return -math.inf
        averaged = betaln(a, b) + math.log(side) - math.log(width)
        exact = failures * math.log(allowed)
        if runs > failures:
            exact += (runs - failures) * math.log1p(-allowed)
        return float(averaged - exact)


_FIXED, _SEQUENTIAL = _FixedTest(), _SequentialTest()


def overall(verdicts: Iterable[Verdict]) -> Decision:
    """Of several requirements: fails if one fails, passes if all of them pass."""
    decisions = {verdict.decision for verdict in verdicts}
    for decision in (Decision.FAILS, Decision.NOT_ENOUGH_RUNS):
        if decision in decisions:
            return decision
    return Decision.PASSES
