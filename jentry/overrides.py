"""Overrides of a mission: from `--set ADDRESS=VALUE` and from TOML files.

    variant = "energy-index"

    [set]
    "initial_state.flight_path_angle" = "-14.2 deg"
    "guidance.reference.cos_bank.coefficients" = [0.6, 0.05, 0.0]

    [dispersions.density]
    address = "planet.density_scale"
    distribution = "uniform"
    lower = 0.7
    upper = 1.3

A `[dispersions]` table takes the place of the mission's own; `dispersions =
"independent"` chooses one of the mission's readings.
"""

import dataclasses
import json
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ._addresses import leaves_by_address, nearest, replace_leaves, require_address
from ._files import write_whole
from .campaign.dispersions import (
    Dispersion,
    Normal,
    TruncatedNormal,
    Uniform,
    add,
    multiply,
    replace,
)
from .flight.scenario import Scenario
from .units import parse_quantity


_DISTRIBUTIONS = {
    "normal": (Normal, ("mean", "standard_deviation")),
    "uniform": (Uniform, ("lower", "upper")),
    "truncated_normal": (
        TruncatedNormal,
        ("mean", "standard_deviation", "lower", "upper"),
    ),
}
_APPLY = {"replace": replace, "add": add, "multiply": multiply}


@dataclasses.dataclass(frozen=True)
class AtAddresses:
    """A lens made of addresses; two of the same addresses are equal."""

    addresses: tuple[str, ...]

    def __call__(self, tree: Any) -> Any:
        return tuple(_at(tree, address) for address in self.addresses)


def _at(tree: Any, address: str) -> Any:
    for step in address.split("."):
        if isinstance(tree, Mapping):
            tree = tree[step]
        elif isinstance(tree, list | tuple):
            tree = tree[int(step)]
        else:
            tree = getattr(tree, step)
    return tree


@dataclasses.dataclass(frozen=True)
class Overrides:
    """What a user changes of a mission."""

    variant: str | None = None
    reading: str | None = None
    """Of the mission's dispersions"""
    values: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """SI values by address: numbers, and lists of them for the leaves that are tables"""
    dispersions: Mapping[str, Dispersion] | None = None
    written: Mapping[str, Any] | None = None
    """The table of dispersions as the file has it"""


def read_overrides(path: Path | None, assignments: Iterable[str] = ()) -> Overrides:
    """Overrides of a TOML file and of assignments `ADDRESS=VALUE`, which come last.

    **Raises:** `ValueError` for an unknown key, with the nearest known, and for a value
    that is no number.
    """
    contents = _read_toml(path) if path is not None else {}
    _require_keys(contents, ("variant", "dispersions", "set"), "")
    values = {
        address: _numbers(value, f"set.{address}")
        for address, value in _flat(contents.get("set", {})).items()
    }
    for assignment in assignments:
        address, equals, value = assignment.partition("=")
        if not equals:
            raise ValueError(f"--set {assignment!r}: write ADDRESS=VALUE")
        values[address.strip()] = _number(value, f"--set {address.strip()}")
    dispersed = contents.get("dispersions")
    table = None
    if isinstance(dispersed, Mapping):
        table = {name: _dispersion(name, entry) for name, entry in dispersed.items()}
    variant = contents.get("variant")
    for name, value in (("variant", variant), ("dispersions", dispersed)):
        if value is not None and not isinstance(value, str | Mapping):
            raise ValueError(f"{name} is {value!r}: it must be a name")
    return Overrides(
        variant=variant,
        reading=dispersed if isinstance(dispersed, str) else None,
        values=values,
        dispersions=table,
        written=dispersed if isinstance(dispersed, Mapping) else None,
    )


def apply_values(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """The scenario with other values. Refuses unknown addresses, with the nearest."""
    known = leaves_by_address(scenario)
    for address, value in values.items():
        require_address(known, address)
        wanted, given = known[address].shape, np.shape(value)
        if wanted != () and given == ():
            raise ValueError(
                f"{address} is a table of shape {wanted}: it cannot be set to one number"
            )
        if wanted != given:
            raise ValueError(
                f"{address} has shape {wanted} and was given a list of shape {given}"
            )
    return replace_leaves(scenario, values)


def require_addresses(
    scenario: Scenario, dispersions: Mapping[str, Dispersion]
) -> None:
    """Refuse a dispersion by address that reaches no leaf, with the nearest names."""
    known = leaves_by_address(scenario)
    for name, dispersion in dispersions.items():
        if isinstance(dispersion.where, AtAddresses):
            for address in dispersion.where.addresses:
                try:
                    require_address(known, address)
                except ValueError as error:
                    raise ValueError(f"dispersions.{name}.address: {error}") from None


def write_overrides(
    path: Path,
    comment: str,
    variant: str,
    values: Mapping[str, Any],
    dispersions: str | Mapping[str, Any],
) -> None:
    """A configuration file that `read_overrides` reads back, to the last digit.

    **Arguments:**

    - `comment`: what the file is, in lines.
    - `dispersions`: a reading of the mission, or the `[dispersions]` table of another
      configuration file.
    """
    lines = [f"# {line}" for line in comment.splitlines()]
    lines += [f"variant = {json.dumps(variant)}"]
    if isinstance(dispersions, str):
        lines += [f"dispersions = {json.dumps(dispersions)}"]
    lines += ["", "[set]"]
    for address, value in values.items():
        # Finite floats, and lists of them of any depth, are alike in JSON and in TOML.
        numbers = np.asarray(value, float).tolist()
        lines += [f"{json.dumps(address)} = {json.dumps(numbers, allow_nan=False)}"]
    if not isinstance(dispersions, str):
        for name, entry in dispersions.items():
            lines += ["", f"[dispersions.{json.dumps(name)}]"]
            lines += [f"{key} = {json.dumps(value)}" for key, value in entry.items()]
    write_whole(path, ("\n".join(lines) + "\n").encode())


def read_inputs(path: Path) -> dict[str, np.ndarray]:
    """Inputs of a Monte Carlo from a csv file: addresses in the first line, SI values."""
    try:
        # Spreadsheets begin a file with a mark of its encoding, which "-sig" leaves out.
        first, *lines = path.read_text(encoding="utf-8-sig").splitlines() or [""]
        rows = [line for line in lines if line.strip()]
        if not rows:
            raise ValueError("there are no rows: give each run a line")
        table = np.loadtxt(rows, delimiter=",", ndmin=2, comments=None)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    header = [name.strip() for name in first.split(",")]
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise ValueError(f"{path} has {', '.join(twice)} twice in its first line")
    if table.shape[1] != len(header):
        raise ValueError(
            f"{path} has {len(header)} addresses in its first line and "
            f"{table.shape[1]} columns"
        )
    return dict(zip(header, table.T, strict=True))


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is no valid TOML: {error}") from None


def _require_keys(table: Mapping[str, Any], known: Iterable[str], place: str) -> None:
    known = list(known)
    for key in table:
        if key not in known:
            where = f" in [{place}]" if place else ""
            raise ValueError(f"unknown key {key!r}{where}; {nearest(key, known)}")


def _flat(table: Any, prefix: str = "") -> dict[str, Any]:
    """Nested tables as dotted addresses: both spellings are the same in TOML."""
    if not isinstance(table, Mapping):
        raise ValueError(f"set is {table!r}: write a table, [set]")
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _number(value: Any, place: str) -> float:
    if isinstance(value, str):
        try:
            return parse_quantity(value)
        except ValueError as error:
            raise ValueError(f"{place}: {error}") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{place} is {value!r}: it must be a number")
    return float(value)


def _numbers(value: Any, place: str) -> Any:
    """A number, or lists of numbers that make a table."""
    if not isinstance(value, list):
        return _number(value, place)
    rows = [_numbers(item, f"{place}[{i}]") for i, item in enumerate(value)]
    if len({np.shape(row) for row in rows}) > 1:
        raise ValueError(f"{place} has rows of unequal length")
    return rows


def _dispersion(name: str, entry: Any) -> Dispersion:
    place = f"dispersions.{name}"
    if not isinstance(entry, Mapping):
        raise ValueError(f"{place} is {entry!r}: write a table, [{place}]")
    kind = entry.get("distribution")
    if not isinstance(kind, str) or kind not in _DISTRIBUTIONS:
        raise ValueError(
            f"{place}.distribution is {kind!r}: choose from {', '.join(_DISTRIBUTIONS)}"
        )
    distribution, parameters = _DISTRIBUTIONS[kind]
    _require_keys(entry, ("address", "distribution", "apply", *parameters), place)
    missing = [p for p in ("address", *parameters) if p not in entry]
    if missing:
        raise ValueError(f"[{place}] lacks {', '.join(missing)}")
    addresses = entry["address"]
    addresses = [addresses] if isinstance(addresses, str) else addresses
    if not isinstance(addresses, list) or not all(
        isinstance(address, str) for address in addresses
    ):
        raise ValueError(
            f"{place}.address is {addresses!r}: write one, or a list of them"
        )
    apply = entry.get("apply", "replace")
    if not isinstance(apply, str) or apply not in _APPLY:
        raise ValueError(f"{place}.apply is {apply!r}: choose from {', '.join(_APPLY)}")
    numbers = {p: _number(entry[p], f"{place}.{p}") for p in parameters}
    where = AtAddresses(tuple(addresses))
    return Dispersion(where, distribution(**numbers), _APPLY[apply])
