"""Files from which a run resumes: its arrays, beside the description of the run."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._files import read_sealed, write_sealed
from .description import first_difference


_DESCRIPTION = "description"
"""Name of the array that has the description"""


def write_with_description(
    path: Path, arrays: Mapping[str, np.ndarray], description: Any, kind: str
) -> None:
    """Write arrays by name and the description of a run. The file is replaced as a whole.

    **Arguments:**

    - `description`: plain values, which can be written as JSON.
    - `kind`: kind of the file and its version.
    """
    described = {_DESCRIPTION: np.array(json.dumps(description))}
    write_sealed(path, {**described, **arrays}, kind)


def read_with_description(
    path: Path, description: Any, kind: str, run: str
) -> dict[str, np.ndarray]:
    """The arrays of a file of this run, by name.

    **Arguments:**

    - `description`, `kind`: as they were written.
    - `run`: what the run is, for messages, such as "tuning run".

    **Raises:** `ValueError` for a file that is no record of such a run, or that belongs to
    another one. The message names the first difference.
    """
    try:
        arrays = read_sealed(path, kind)
        known = json.loads(str(arrays.pop(_DESCRIPTION)))
    except (ValueError, KeyError) as error:
        raise ValueError(
            f"{path} is no record of a {run}: {error}; remove it, and the run begins again"
        ) from None
    difference = first_difference(known, json.loads(json.dumps(description)))
    if difference:
        raise ValueError(
            f"{path} holds another {run}: {difference}; choose another place, or remove it"
        )
    return arrays


def part_of(arrays: Mapping[str, np.ndarray], name: str) -> dict[str, np.ndarray]:
    """The arrays whose names begin with a name and a stroke, by the rest of their names."""
    prefix = f"{name}/"
    return {
        each.removeprefix(prefix): array
        for each, array in arrays.items()
        if each.startswith(prefix)
    }
