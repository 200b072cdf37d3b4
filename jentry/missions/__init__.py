"""Floor 9: the missions, a folder each."""

from ..addresses import nearest
from .cav_h import MISSION as CAV_H
from .mars.drag_tracking import MISSION as DRAG_TRACKING
from .mars.range_tracking import MISSION as RANGE_TRACKING
from .mission import Mission as Mission, PublishedValue as PublishedValue


ALL = {mission.name: mission for mission in (DRAG_TRACKING, RANGE_TRACKING, CAV_H)}
"""Every mission by its name."""


def find_mission(name: str) -> Mission:
    """A mission by its name. Raises `ValueError` with the nearest names otherwise."""
    if name not in ALL:
        raise ValueError(f"no mission {name!r}; {nearest(name, ALL)}")
    return ALL[name]
