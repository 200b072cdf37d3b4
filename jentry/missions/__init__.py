"""Floor 8: the missions, one file each."""

from .._addresses import nearest
from .cav_h import MISSION as CAV_H
from .mars_drag_tracking import MISSION as MARS_DRAG_TRACKING
from .mars_range_tracking import MISSION as MARS_RANGE_TRACKING
from .mission import Mission as Mission, PublishedValue as PublishedValue


ALL = {
    mission.name: mission
    for mission in (MARS_DRAG_TRACKING, MARS_RANGE_TRACKING, CAV_H)
}
"""Every mission by its name."""


def find_mission(name: str) -> Mission:
    """A mission by its name. Raises `ValueError` with the nearest names otherwise."""
    if name not in ALL:
        raise ValueError(f"no mission {name!r}; {nearest(name, ALL)}")
    return ALL[name]
