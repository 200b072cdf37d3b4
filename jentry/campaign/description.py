"""The description of a campaign in plain values.

It is stored beside the results, and compared when the campaign is resumed.
"""

import base64
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

import numpy as np

from .._setup import xla_options
from ..addresses import addresses_of, leaves_by_address, unit_of, with_leaves
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from .dispersions import Dispersion
from .distributions import static_fields
from .samplers import AbstractSampler, described
from .users_code import own_code


_LONG = 100
"""Largest number of values of a table that are written in digits"""

_PACKAGES = ("jentry", "jax", "equinox", "diffrax", "numpy")


def describe(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion] | None,
    seed: int,
    solver: AbstractSolver,
    history: float | None,
    inputs: Mapping[str, Any] | None = None,
    sampler: AbstractSampler | None = None,
    **labels: Any,
) -> dict[str, Any]:
    """A campaign as plain values. Campaigns with equal values fly the same runs."""
    leaves = leaves_by_address(scenario)
    code = own_code(
        scenario,
        solver,
        sampler,
        *((each.distribution, each.apply) for each in (dispersions or {}).values()),
    )
    return {
        **labels,
        "seed": seed,
        **described(sampler),
        "history_interval": None if history is None else float(history),
        "solver": repr(solver),
        "xla_options": xla_options(),
        "structure": repr(scenario),
        "dispersions": {
            name: {
                "order": place,
                "addresses": addresses_of(scenario, dispersion.where),
                "distribution": type(dispersion.distribution).__name__,
                **static_fields(dispersion.distribution),
                **{
                    field: _plain(value)
                    for field, value in leaves_by_address(
                        with_leaves(dispersion.distribution)
                    ).items()
                },
                "apply": _name(dispersion.apply),
                **({} if dispersion.stream is None else {"stream": dispersion.stream}),
            }
            for place, (name, dispersion) in enumerate((dispersions or {}).items())
        },
        "inputs": {
            address: np.asarray(values, dtype=float).tolist()
            for address, values in (inputs or {}).items()
        },
        "scenario": {
            address: {"value": _plain(leaf), "unit": unit_of(scenario, address)}
            for address, leaf in leaves.items()
        },
        **({"own_code": code} if code else {}),
        "versions": {name: version(name) for name in _PACKAGES},
    }


def _plain(leaf: Any) -> Any:
    """Numbers for JSON. A long table is encoded in base 64, since digits take seconds."""
    values = np.asarray(leaf)
    if values.size <= _LONG:
        return values.tolist()
    little_endian = values.astype(values.dtype.newbyteorder("<"))
    return {
        "shape": list(values.shape),
        "type": values.dtype.name,
        "base64": base64.b64encode(little_endian.tobytes()).decode(),
    }


def leaf_of(plain: Any) -> np.ndarray:
    """The numbers of a leaf of a description, equal to the last bit."""
    if not isinstance(plain, dict):
        return np.asarray(plain)
    little_endian = np.dtype(plain["type"]).newbyteorder("<")
    stored = np.frombuffer(base64.b64decode(plain["base64"]), little_endian)
    return stored.reshape(plain["shape"]).astype(plain["type"])


def scalars_of(description: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of a described scenario by address, without its tables."""
    return {
        address: leaf
        for address, leaf in description["scenario"].items()
        if not isinstance(leaf["value"], list | dict)
    }


def _name(function: Callable) -> str:
    """Full name of a function. Raises `ValueError` if it has none."""
    name = getattr(function, "__qualname__", "<lambda>")
    if "<lambda>" in name:
        raise ValueError(
            "a stored campaign needs a named function to apply a dispersion, not a "
            "lambda: replace, add, multiply or one of your own"
        )
    return f"{function.__module__}.{name}"


def first_difference(known: Any, wanted: Any, place: str = "") -> str | None:
    """Text for the first difference of two descriptions, or None if they are equal."""
    if isinstance(known, dict) and isinstance(wanted, dict):
        if "base64" in known and known != wanted:
            return f"{place.removesuffix('.value')} differs"
        for name in [*known, *(n for n in wanted if n not in known)]:
            inner = f"{place}.{name}" if place else name
            if name not in known or name not in wanted:
                where = "there" if name in known else "now"
                return f"{inner} is given only {where}"
            difference = first_difference(known[name], wanted[name], inner)
            if difference:
                return difference
        return None
    if known == wanted:
        return None
    if isinstance(known, list) or len(str(known)) > 60:
        return f"{place} differs"
    return f"{place} is {known} there and {wanted} now"
