"""A vehicle and its case as a TOML file, for programs and people without jentry."""

import dataclasses
import enum
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from .._files import write_toml
from .._printed import sentence
from ..addresses import addresses_of, leaves_by_address, with_leaves
from ..campaign.dispersions import Dispersion, unit_of_draw
from ..campaign.distributions import static_fields
from ..fields import units_of
from ..flight.scenario import Scenario
from .choice import Choice
from .mission import Mission


PARTS = (
    "planet",
    "vehicle",
    "initial_state",
    "target",
    "termination",
    "constraints",
    "attitude",
    "dynamics",
    "accelerometers",
    "angle_of_attack_error",
    "flow_sensors",
    "navigation",
)
"""Parts of a scenario in the file, by their addresses. A law is a program, and not data"""

_CONVENTIONS = """\
Numbers are in the SI units that `units` names; angles are in radians. A part has its kind,
and a sentence about this kind. The state: altitude above the sphere of planet.radius,
longitude positive to the east, geocentric latitude, velocity relative to the rotating
planet, flight-path angle positive upwards, heading clockwise from north. Downrange and
crossrange are arcs on this sphere, from the origin of the target or, without one, from
the initial state; crossrange is positive to the left."""


def write_mission_data(
    path: Path | str,
    mission: Mission,
    choice: Choice = Choice(),
    scenario: Scenario | None = None,
) -> None:
    """Write planet, vehicle, entry, target, ends, limits and dispersions as TOML.

    Numbers are written to the last digit. The law is left out.

    **Arguments:**

    - `path`: file to write, completely or not at all.
    - `mission`: its `source` names the paper.
    - `choice`: case and worlds. Those dispersions that go with the law are written.
    - `scenario`: the scenario of the choice if numbers of it have been changed.

    **Raises:** `ValueError` for an unknown name of the choice.
    """
    write_toml(path, _CONVENTIONS, mission_data(mission, choice, scenario))


def mission_data(
    mission: Mission, choice: Choice = Choice(), scenario: Scenario | None = None
) -> dict[str, Any]:
    """The contents of the file of `write_mission_data`, as plain values."""
    choice = mission.complete(choice)
    scenario = mission.scenario_of(choice) if scenario is None else scenario
    named = {
        "mission": mission.name,
        "title": mission.title,
        "source": mission.source,
        "law": choice.law,
        "case": choice.case,
        "worlds": list(choice.worlds),
        "written_by": f"jentry {version('jentry')}",
    }
    parts = {part: _described(getattr(scenario, part)) for part in PARTS}
    units = {
        name: unit
        for name, unit in units_of(Scenario).items()
        if parts.get(name) is not None
    }
    tables, left_out = {}, {}
    for name in mission.dispersions:
        try:
            tables[name] = {
                each: _dispersion(scenario, each, dispersion)
                for each, dispersion in mission.dispersion_table(name).items()
            }
        except (ValueError, AttributeError) as error:  # for another law or world
            left_out[name] = str(error)
    found = named | {"units": units} | parts
    found |= {"dispersions": tables, "dispersions_left_out": left_out}
    return {name: x for name, x in found.items() if x not in (None, "", [], {})}


def _described(value: Any) -> Any:
    """Plain values of a part; None is left out."""
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if value is None or isinstance(value, bool | str):
        return value
    if dataclasses.is_dataclass(value):
        kind = {"kind": type(value).__name__, "about": sentence(type(value))}
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
        units = {
            name: unit
            for name, unit in units_of(type(value)).items()
            if eqx.is_array_like(fields.get(name))
        }
        return kind | _each_described(fields) | ({"units": units} if units else {})
    if isinstance(value, Mapping):
        return _each_described(value)
    if isinstance(value, list | tuple):
        return [_described(each) for each in value if each is not None]
    if eqx.is_array_like(value):
        return np.asarray(value).tolist()
    return getattr(value, "__name__", type(value).__name__)


def _each_described(values: Mapping[str, Any]) -> dict[str, Any]:
    described = {str(name): _described(value) for name, value in values.items()}
    return {name: each for name, each in described.items() if each is not None}


def _dispersion(
    scenario: Scenario, name: str, dispersion: Dispersion
) -> dict[str, Any]:
    """What is drawn, and which numbers of the scenario it changes, and how."""
    changed = addresses_of(scenario, dispersion.where)
    drawn = leaves_by_address(with_leaves(dispersion.distribution))
    stream = {} if dispersion.stream is None else {"stream": dispersion.stream}
    return {
        "changes": changed,
        "how": sentence(dispersion.apply),
        "unit": unit_of_draw(scenario, name, changed, dispersion.apply),
        "distribution": type(dispersion.distribution).__name__,
        "about": sentence(type(dispersion.distribution)),
        **static_fields(dispersion.distribution),
        **{name: np.asarray(leaf).tolist() for name, leaf in drawn.items()},
        **stream,
    }
