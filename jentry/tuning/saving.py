"""Writes tuned values as a configuration file that the command line reads."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._files import write_toml
from ..addresses import field_metadata, leaves_by_address, unit_of
from .judgement import Judgement


if TYPE_CHECKING:
    from .tuning import Tuned


def write_tuned(
    path: Path | str,
    tuned: "Tuned",
    head: Mapping[str, Any],
    values: Mapping[str, Any],
    comment: str,
) -> None:
    """Write the configuration file of a tuned scenario; see `Tuned.save`."""
    leaves = leaves_by_address(tuned.scenario)
    set_to = {**values, **{address: leaves[address] for address in tuned.moved}}
    dispersions = head["dispersions"]
    contents = {
        **{axis: head[axis] for axis in ("law", "case", "world")},
        # TOML has plain values before tables.
        "dispersions": dispersions if isinstance(dispersions, str) else None,
        "set": {a: with_unit(x, unit_of(tuned.scenario, a)) for a, x in set_to.items()},
        "tuned": _what_was_tuned(tuned),
    }
    if isinstance(dispersions, Mapping):
        contents["dispersions"] = dict(dispersions)
    write_toml(path, comment, contents)


def with_unit(value: Any, unit: str) -> Any:
    """A number with its unit as in a configuration file: `"0.5 rad"`. Arrays give lists."""
    if np.ndim(value):
        return [with_unit(item, unit) for item in value]
    number = float(value)
    # A unit such as 1/s cannot be told apart from the number before it.
    return number if unit[:1] == "1" else f"{number!r} {unit}"


def _what_was_tuned(tuned: "Tuned") -> dict[str, Any]:
    first, best = tuned.course[0], tuned.course[tuned.best]
    start = tuned.parameters

    def parameter(address: str, value: Any) -> dict[str, Any]:
        unit = field_metadata(start, address).get("unit", "1")
        return {
            "start": with_unit(first.values[address], unit),
            "value": with_unit(value, unit),
            "gradient_share": best.gradient_shares[address],
        }

    return {
        "stopped": tuned.stopped,
        "steps": len(tuned.course),
        "best_step": tuned.best + 1,
        "loss_at_start": first.loss,
        "loss": best.loss,
        **(
            {}
            if tuned.penalties is None
            else {"penalty_at_start": tuned.penalties[0], "penalty": tuned.penalties[1]}
        ),
        "remarks": list(tuned.remarks),
        "parameters": {a: parameter(a, x) for a, x in tuned.values.items()},
        "judgement": _told(tuned.judgement),
    }


def _told(judgement: Judgement) -> dict[str, Any]:
    return {
        "runs": judgement.runs,
        "not_finite_before": judgement.not_finite_before,
        "not_finite_after": judgement.not_finite_after,
        "comparisons": [
            {
                "quantity": comparison.quantity,
                "statistic": comparison.statistic,
                "before": comparison.before.value,
                "after": comparison.after.value,
                "change": comparison.change.value,
                "interval": [comparison.change.low, comparison.change.high],
            }
            for comparison in judgement.comparisons
        ],
    }
