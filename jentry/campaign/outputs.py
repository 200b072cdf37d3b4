"""Names of the outputs of flights in results, and the units in which they are shown."""

from typing import TYPE_CHECKING, Any

from ..units import edge_unit


if TYPE_CHECKING:
    import xarray


MISS_DISTANCE = "miss_distance"

VELOCITY_INCREMENT = "velocity_increment"

_NAMED = {"distance": MISS_DISTANCE, VELOCITY_INCREMENT: VELOCITY_INCREMENT}
"""Names of misses that have no sign, and are no errors"""

NORMALISED = "normalised_error_squared"
"""Name of the error of the navigation, normalised by the covariance of its filter"""


def at_end(name: str) -> str:
    """Name in results of a component of the state, or of the time, at the end."""
    return f"end_{name}"


def navigated(name: str) -> str:
    """Name in results of a component of the state that the vehicle believes."""
    return f"navigated_{name}"


def error_of(miss: str) -> str:
    """Name in results of a field of `Misses`, or of its `distance`."""
    return _NAMED.get(miss, f"{miss}_error")


_BELIEVED, _NAVIGATION = "believed_", "navigation_"


def believed(error: str) -> str:
    """Name in results of an error that the vehicle believes to have."""
    return f"{_BELIEVED}{error}"


def navigation_error_of(component: str) -> str:
    """Name in results of an error of the navigation at the end, believed minus actual."""
    return f"{_NAVIGATION}{error_of(component)}"


def navigation_deviation_of(component: str) -> str:
    """Name in results of a standard deviation of the navigation filter over time."""
    return f"{_NAVIGATION}{component}_deviation"


def measured_by(sensor: str) -> str:
    """Name in results of the number of values that a sensor of the filter measured."""
    return f"{sensor}_measured"


def peak_of(constraint: str) -> str:
    """Name in results of the peak of a path constraint."""
    return f"peak_{constraint}"


def is_error(name: str) -> bool:
    """Whether a variable of results is an error, which has a sign: see `difference_of`."""
    return "." not in name and name.endswith(error_of(""))


def is_of_navigation(name: str) -> bool:
    """Whether an error in results is one of `believed` or of `navigation_error_of`."""
    return "." not in name and name.startswith((_BELIEVED, _NAVIGATION))


def difference_of(error: str) -> str:
    """Text that says of which two values an error in results is the difference."""
    if error.startswith(_BELIEVED):
        return "believed minus desired"
    if error.startswith(_NAVIGATION):
        return "believed minus actual"
    return "actual minus desired"


def is_output(name: str) -> bool:
    """Whether a variable of results belongs to the end of a flight or is a peak."""
    unsigned = *_NAMED.values(), *map(believed, _NAMED.values())
    begins = at_end(""), peak_of(""), *unsigned
    return "." not in name and (name.startswith(begins) or is_error(name))


def shown(variable: "xarray.DataArray") -> tuple[Any, str]:
    """Values of a variable of results in the unit in which they are shown, and the unit."""
    unit, size = edge_of(variable, variable.values)
    return variable.values / size, unit


def unit_size(variable: "xarray.DataArray") -> float:
    """SI value of the unit in which a variable of results is shown."""
    return edge_of(variable, variable.values)[1]


def edge_of(variable: "xarray.DataArray", values: Any) -> tuple[str, float]:
    """The unit in which values of a variable of results are shown, and its SI value.

    The values may be differences of the variable.
    """
    attributes = variable.attrs
    unit, named = attributes.get("units", "1"), attributes.get("shown_units")
    return edge_unit(unit, values, named)
