"""Overrides of a mission, from `--set ADDRESS=VALUE` and from TOML files.

    law = "energy-index"

    [set]
    "initial_state.flight_path_angle" = "-14.2 deg"
    "guidance.reference.cos_bank.coefficients" = [0.6, 0.05, 0.0]

    [dispersions.density]
    address = "planet.density_scale"
    distribution = "uniform"
    lower = 0.7
    upper = 1.3

A `[dispersions.NAME]` table replaces the mission's dispersion of that name, or is added
to the mission's dispersions. In `[dispersions]`, `base = "independent"` names the
mission's dispersions that are changed, and `replace = true` leaves out all of them.
`dispersions = "independent"` names them and changes nothing. A `normal` dispersion may
have correlations with others, by name: `correlation = { drag = 0.8 }`.
"""

import dataclasses
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._printed import quantity_in_words
from .._tables import read_columns
from ..addresses import (
    leaves_by_address,
    nearest,
    replace_leaves,
    require_address,
    unit_of,
)
from ..campaign.dispersions import (
    Dispersion,
    add,
    is_factor,
    multiply,
    replace,
    unit_of_draw,
)
from ..campaign.distributions import (
    AbstractDistribution,
    Discrete,
    LogNormal,
    Normal,
    TruncatedNormal,
    Uniform,
)
from ..flight.scenario import Scenario
from ..flight.scenario_checks import check_leaf
from ..missions.choice import AXES, Choice
from ..units import Quantity, forgotten_unit, quantity


_DISTRIBUTIONS = {
    "normal": (Normal, ("mean", "standard_deviation")),
    "uniform": (Uniform, ("lower", "upper")),
    "truncated_normal": (
        TruncatedNormal,
        ("mean", "standard_deviation", "lower", "upper"),
    ),
    "lognormal": (LogNormal, ("median", "deviation_of_logarithm")),
    "discrete": (Discrete, ("values", "probabilities")),
}
_LISTS = "values", "probabilities"
_MAY_LACK = ("probabilities",)
_PURE = "deviation_of_logarithm", "probabilities"
"""Parameters that are plain numbers, whatever the unit of the draw"""
_APPLY = {"replace": replace, "add": add, "multiply": multiply}


@dataclasses.dataclass(frozen=True)
class AtAddresses:
    """A lens made of addresses. Two lenses with equal addresses are equal."""

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
class Stated:
    """A dispersion as a file states it, before units are converted for a scenario."""

    distribution: type
    addresses: tuple[str, ...]
    numbers: Mapping[str, Any]
    """By parameter: a `Quantity`, or a list of them"""
    apply: Any
    correlation: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Coefficients with other dispersions, by their names"""


@dataclasses.dataclass(frozen=True)
class Overrides:
    """The changes of a user to a mission: as read, or `in_si` of a scenario."""

    choice: Choice = Choice()
    """Law, case and worlds of the mission"""
    base: str | None = None
    """Name of the mission's dispersions"""
    values: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """By address: a number, or lists of numbers for a leaf that is a table. Each number is
    a `Quantity` as read, and a float in SI"""
    dispersions: Mapping[str, Any] | None = None
    """By name: a `Stated` as read, and a `Dispersion` in SI"""
    correlations: Mapping[str, Mapping[str, float]] = dataclasses.field(
        default_factory=dict
    )
    """Coefficients by the names of both dispersions"""
    replaces: bool = False
    """Whether `dispersions` replace all of the mission's, or change and add some"""
    written: Mapping[str, Any] | None = None
    """The table of dispersions, unchanged from the file"""
    free_controls: Mapping[str, Any] | None = None
    """The table of splines that replace the law, see `free_controls_table`"""

    @property
    def disperses(self) -> bool:
        """Whether the overrides choose or change dispersions."""
        return self.dispersions is not None or self.base is not None

    def written_with(self, base: str) -> str | Mapping[str, Any]:
        """Entry `dispersions` of a file with these overrides, for the mission's dispersions
        of a name."""
        if self.written is None or self.dispersions is None:
            return base
        return self.written if self.replaces else {**self.written, "base": base}


def read_overrides(path: Path | None, assignments: Iterable[str] = ()) -> Overrides:
    """Overrides of a TOML file, and of assignments `ADDRESS=VALUE`, which prevail.

    **Raises:** `ValueError` for an unknown key, with the nearest known, and for a value
    that is not a number.
    """
    try:
        return _read_overrides(path, assignments)
    except RecursionError:
        raise ValueError(f"{path} is no configuration: it is nested too deep") from None


def _read_overrides(path: Path | None, assignments: Iterable[str]) -> Overrides:
    contents = read_toml(path) if path is not None else {}
    # These tables describe the origin of the numbers, for a reader only.
    contents.pop("tuned", None)
    contents.pop("optimized", None)
    require_keys(contents, (*AXES, "dispersions", "set", "free_controls"), "")
    values = {
        address: _quantities(value, f"set.{address}")
        for address, value in _flat(contents.get("set", {})).items()
    }
    assigned = {}
    for assignment in assignments:
        address, equals, value = assignment.partition("=")
        if not equals:
            raise ValueError(f"--set {assignment!r}: write ADDRESS=VALUE")
        address = address.strip()
        if address in assigned:
            raise ValueError(f"--set {address} is given twice: give it once")
        assigned[address] = one_quantity(value, f"--set {address}")
    free = contents.get("free_controls")
    if free is not None and not isinstance(free, Mapping):
        raise ValueError(f"free_controls is {free!r}: write a table, [free_controls]")
    choice = Choice.given(*(contents.get(axis) for axis in AXES))
    dispersed = contents.get("dispersions")
    if dispersed is not None and not isinstance(dispersed, str | Mapping):
        raise ValueError(f"dispersions is {dispersed!r}: it must be a name")
    if isinstance(dispersed, Mapping):
        table, base, replaces = _read_dispersions(dispersed)
    else:
        table, base, replaces = None, dispersed, False
    return Overrides(
        choice=choice,
        base=base,
        values=values | assigned,
        dispersions=table,
        correlations={n: d.correlation for n, d in (table or {}).items()},
        replaces=replaces,
        written=dispersed if isinstance(dispersed, Mapping) else None,
        free_controls=free,
    )


def _read_dispersions(
    dispersed: Mapping[str, Any],
) -> tuple[dict[str, Stated] | None, str | None, bool]:
    """Stated dispersions, the name of those that they change, whether they replace all."""
    # A table of one of these names is a dispersion like any other.
    settings = {
        key: value
        for key, value in dispersed.items()
        if key in ("base", "replace") and not isinstance(value, Mapping)
    }
    entries = {key: value for key, value in dispersed.items() if key not in settings}
    base, replaces = settings.get("base"), settings.get("replace", False)
    if not isinstance(replaces, bool):
        raise ValueError(
            f"dispersions.replace is {replaces!r}: it must be true or false"
        )
    if base is not None and not isinstance(base, str):
        raise ValueError(f"`base` of [dispersions] is {base!r}: it must be a name")
    if replaces and base is not None:
        raise ValueError(
            f"`base` of [dispersions] is {base!r}, and `replace` leaves out the "
            "dispersions of the mission: give one of them"
        )
    if not entries and base is None:
        raise ValueError(
            "[dispersions] is empty: leave it out for the mission's own, or write "
            "a table for each, [dispersions.NAME]"
        )
    table = {name: _stated(name, entry) for name, entry in entries.items()}
    return table or None, base, replaces


def in_si(overrides: Overrides, scenario: Scenario) -> Overrides:
    """The overrides with each number in the SI unit of its leaf.

    **Raises:** `ValueError` for an unknown address, with the nearest, for a unit of
    another dimension than that of the leaf, for a number without a unit that was probably
    meant in another one than SI, and for a number that cannot be flown.
    """
    known = leaves_by_address(scenario)
    values = {}
    for address, value in overrides.values.items():
        require_address(known, address)
        unit = unit_of(scenario, address)
        values[address] = si_of(value, unit, address)
        if isinstance(value, Quantity) and not np.ndim(known[address]):
            si, had_unit = np.asarray(values[address]), bool(value.unit)
            check_leaf(scenario, address, si, had_unit=had_unit)
            require_unit(value, values[address], known[address], unit, address)
    table = overrides.dispersions
    if table is not None:
        table = {name: _dispersion(name, d, scenario) for name, d in table.items()}
    return dataclasses.replace(overrides, values=values, dispersions=table)


def apply_values(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """The scenario with other values, SI.

    **Raises:** `ValueError` for an unknown address, with the nearest, and for a value of
    another shape than the leaf.
    """
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


def read_inputs(path: Path) -> dict[str, np.ndarray]:
    """Inputs of a campaign from a csv file: addresses in the first line, values in SI."""
    columns, _ = read_columns(path, (), None, rows=1)
    return columns


def read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:  # also for an integer of thousands of digits
        raise ValueError(f"{path} is no valid TOML: {error}") from None


def require_keys(table: Mapping[str, Any], known: Iterable[str], place: str) -> None:
    known = list(known)
    for key in table:
        if key not in known:
            where = f" in [{place}]" if place else ""
            raise ValueError(f"unknown key {key!r}{where}; {nearest(key, known)}")


def _flat(table: Any, prefix: str = "") -> dict[str, Any]:
    """Nested tables as dotted addresses: TOML allows both spellings."""
    if not isinstance(table, Mapping):
        raise ValueError(f"set is {table!r}: write a table, [set]")
    flat: dict[str, Any] = {}
    for key, value in table.items():
        inner = {f"{prefix}{key}": value}
        if isinstance(value, Mapping):
            inner = _flat(value, f"{prefix}{key}.")
        for address in inner:
            if address in flat:
                raise ValueError(f"set.{address} is given twice: give it once")
        flat |= inner
    return flat


def one_quantity(value: Any, place: str) -> Quantity:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"{place} is {value!r}: it must be a number")
    try:
        return quantity(value)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{place}: {error}") from None


def _quantities(value: Any, place: str) -> Any:
    """A number, or lists of numbers that make a table."""
    if not isinstance(value, list):
        return one_quantity(value, place)
    rows = [_quantities(item, f"{place}[{i}]") for i, item in enumerate(value)]
    if len({_shape(row) for row in rows}) > 1:
        raise ValueError(f"{place} has rows of unequal length")
    return rows


def _shape(rows: Any) -> tuple[int, ...]:
    if not isinstance(rows, list):
        return ()
    return (len(rows), *(_shape(rows[0]) if rows else ()))


def si_of(value: Any, unit: str, place: str) -> Any:
    if isinstance(value, list):
        return [si_of(item, unit, f"{place}[{i}]") for i, item in enumerate(value)]
    try:
        return value.si(unit)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from None


def require_unit(value: Any, si: Any, leaf: Any, unit: str, place: str) -> None:
    """Refuse a number without a unit that was probably meant in another one than SI.

    It is compared with the leaf that it replaces: see `forgotten_unit`. A number with its
    unit is always taken, and so are lists.

    **Arguments:**

    - `value`: the number as it was read.
    - `si`: the number in SI.
    - `leaf`, `unit`: what it replaces, in SI, and the SI unit.
    - `place`: where the number stands.
    """
    if not isinstance(value, Quantity) or value.unit or np.ndim(leaf):
        return
    present = float(leaf)
    meant = forgotten_unit(si, present, unit)
    if meant:
        raise ValueError(
            f"{place} is {value.text}, without a unit, in place of "
            f"{quantity_in_words(present, unit)}: did you mean {value.text}{meant}? Write "
            f"the unit, {value.text}{meant} or {value.text}{unit}"
        )


_OF_THE_SIZE = "mean", "median", "lower", "upper", "values"
"""Parameters of a distribution that are of the size of its draws"""


def _stated(name: str, entry: Any) -> Stated:
    place = f"dispersions.{name}"
    if not isinstance(entry, Mapping):
        raise ValueError(f"{place} is {entry!r}: write a table, [{place}]")
    kind = entry.get("distribution")
    if not isinstance(kind, str) or kind not in _DISTRIBUTIONS:
        raise ValueError(
            f"{place}.distribution is {kind!r}: choose from {', '.join(_DISTRIBUTIONS)}"
        )
    distribution, parameters = _DISTRIBUTIONS[kind]
    more = ("correlation",) if distribution is Normal else ()
    require_keys(entry, ("address", "distribution", "apply", *parameters, *more), place)
    missing = [
        p for p in ("address", *parameters) if p not in entry and p not in _MAY_LACK
    ]
    if missing:
        raise ValueError(f"[{place}] lacks {', '.join(missing)}")
    addresses = entry["address"]
    addresses = [addresses] if isinstance(addresses, str) else addresses
    if (
        not isinstance(addresses, list)
        or not addresses
        or not all(isinstance(address, str) for address in addresses)
    ):
        raise ValueError(
            f"{place}.address is {addresses!r}: write one, or a list of them"
        )
    apply = entry.get("apply", "replace")
    if not isinstance(apply, str) or apply not in _APPLY:
        raise ValueError(f"{place}.apply is {apply!r}: choose from {', '.join(_APPLY)}")
    numbers = {}
    for parameter in parameters:
        if parameter not in entry:
            continue
        value, at = entry[parameter], f"{place}.{parameter}"
        if parameter in _LISTS and not isinstance(value, list):
            raise ValueError(f"{at} is {value!r}: write a list, [1.0, 2.0]")
        read = _quantities if parameter in _LISTS else one_quantity
        numbers[parameter] = read(value, at)
    correlation = _coefficients(entry.get("correlation", {}), f"{place}.correlation")
    return Stated(distribution, tuple(addresses), numbers, _APPLY[apply], correlation)


def _require_units(
    stated: Stated,
    numbers: Mapping[str, Any],
    distribution: AbstractDistribution,
    leaf: Any,
    unit: str,
    place: str,
) -> None:
    """Refuse draws without a unit, in place of a leaf, as `require_unit` does."""
    if is_factor(distribution, leaf, unit):
        return  # see `check_dispersions`
    for parameter in filter(numbers.__contains__, _OF_THE_SIZE):
        values, si = stated.numbers[parameter], numbers[parameter]
        if parameter not in _LISTS:
            values, si = [values], [si]
        for each, number in zip(values, si, strict=True):
            require_unit(each, number, leaf, unit, f"{place}.{parameter}")


def _coefficients(table: Any, place: str) -> dict[str, float]:
    if not isinstance(table, Mapping):
        raise ValueError(f"{place} is {table!r}: write {{ NAME = 0.5 }}")
    found = {}
    for name, value in table.items():
        found[name] = one_quantity(value, f"{place}.{name}").si("1")
        if not -1.0 < found[name] < 1.0:
            raise ValueError(
                f"{place}.{name} is {found[name]:g}: it must be between -1 and 1"
            )
    return found


def _dispersion(name: str, stated: Stated, scenario: Scenario) -> Dispersion:
    place = f"dispersions.{name}"
    known = leaves_by_address(scenario)
    try:
        for address in stated.addresses:
            require_address(known, address)
    except ValueError as error:
        raise ValueError(f"{place}.address: {error}") from None
    unit = unit_of_draw(scenario, name, stated.addresses, stated.apply)
    numbers = {
        p: si_of(x, "1" if p in _PURE else unit, f"{place}.{p}")
        for p, x in stated.numbers.items()
    }
    try:
        distribution = stated.distribution(**numbers)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from None
    if stated.apply is replace:
        for address in stated.addresses:
            _require_units(stated, numbers, distribution, known[address], unit, place)
    return Dispersion(AtAddresses(stated.addresses), distribution, stated.apply)
