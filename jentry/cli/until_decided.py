"""How many runs are flown before requirements are judged again."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..statistics.acceptance import Decision, Requirement, judged


if TYPE_CHECKING:
    import xarray


_GROWTH = 2.0
"""Largest ratio of the runs at one look to the runs at the look before"""


def further_runs(
    requirements: Sequence[Requirement], results: "xarray.Dataset", most: int
) -> int:
    """Runs to fly before the next look; 0 if all is decided or `most` is reached.

    The number is what the nearest decision takes at the present rate of failures, but at
    most as many as there are already. The sequential test allows looks at any time.

    **Arguments:**

    - `most`: runs in all.
    """
    runs = results.sizes["run"]
    verdicts = [judged(results, r, sequential=True) for r in requirements]
    if any(verdict.decision is Decision.FAILS for verdict in verdicts):
        return 0
    open_ = [v for v in verdicts if v.decision is Decision.NOT_ENOUGH_RUNS]
    if not open_ or runs >= most:
        return 0
    growth = math.ceil((_GROWTH - 1.0) * runs)
    told = (v.more_runs_at_this_rate or v.more_runs or growth for v in open_)
    return min(max(1, min(growth, *told)), most - runs)
