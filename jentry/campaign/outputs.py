"""What the outputs of flights are called in results, and how people read them."""

from typing import TYPE_CHECKING, Any

from ..units import edge_unit


if TYPE_CHECKING:
    import xarray


MISS_DISTANCE = "miss_distance"


def at_end(name: str) -> str:
    """Name in the results of a component of the state, or of the time, at the end."""
    return f"end_{name}"


def error_of(miss: str) -> str:
    """Name in the results of a field of `Misses`, or of its `distance`."""
    return MISS_DISTANCE if miss == "distance" else f"{miss}_error"


def peak_of(constraint: str) -> str:
    """Name in the results of the peak of a path constraint."""
    return f"peak_{constraint}"


def is_error(name: str) -> bool:
    """Whether a variable of a result is a difference, actual minus desired."""
    return "." not in name and name.endswith(error_of(""))


def is_output(name: str) -> bool:
    """Whether a variable of a result tells how the flight ended, or a peak of it."""
    begins = at_end(""), peak_of(""), MISS_DISTANCE
    return "." not in name and (name.startswith(begins) or is_error(name))


def shown(variable: "xarray.DataArray") -> tuple[Any, str]:
    """Values of a variable of a result as people read them, and their unit."""
    unit, size = edge_of(variable, variable.values)
    return variable.values / size, unit


def unit_size(variable: "xarray.DataArray") -> float:
    """SI value of the unit in which people read a variable of a result."""
    return edge_of(variable, variable.values)[1]


def edge_of(variable: "xarray.DataArray", values: Any) -> tuple[str, float]:
    """The unit in which people read values that are of a variable of a result, such as
    differences of it, and its SI value."""
    attributes = variable.attrs
    unit, named = attributes.get("units", "1"), attributes.get("shown_units")
    return edge_unit(unit, values, named)
