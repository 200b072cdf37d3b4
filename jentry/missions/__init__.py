"""Floor 9: the missions, one folder for each."""

from collections.abc import Iterator
from pathlib import Path

from ..addresses import nearest
from .apollo_10 import MISSION as APOLLO_10
from .cav_h import MISSION as CAV_H
from .cav_h_glide import MISSION as CAV_H_GLIDE
from .mars.drag_tracking_mission import MISSION as DRAG_TRACKING
from .mars.range_tracking import MISSION as RANGE_TRACKING
from .mars_aerocapture import MISSION as MARS_AEROCAPTURE
from .mission import Mission as Mission, PublishedValue as PublishedValue
from .msl import MISSION as MSL
from .neptune_aerocapture import MISSION as NEPTUNE_AEROCAPTURE
from .own import (
    is_file,
    mission_in_file,
    mission_of_package,
    packaged_missions,
    where_from,
)
from .rlv import MISSION as RLV
from .shuttle import MISSION as SHUTTLE
from .sx_2 import MISSION as SX_2
from .x_33 import MISSION as X_33


ALL = {
    mission.name: mission
    for mission in (
        DRAG_TRACKING,
        RANGE_TRACKING,
        CAV_H,
        SX_2,
        RLV,
        X_33,
        SHUTTLE,
        APOLLO_10,
        CAV_H_GLIDE,
        MSL,
        MARS_AEROCAPTURE,
        NEPTUNE_AEROCAPTURE,
    )
}
"""Every mission of jentry by its name."""


def find_mission(name: str | Path) -> Mission:
    """A mission by its name, or one of your own by its file.

    A name is that of one of jentry's missions, or of a mission that an installed package
    offers in the entry-point group `jentry.missions`. A file is a path that ends in `.py`.
    It defines `MISSION`, and may import other files of its folder.

    **Raises:** `ValueError` for an unknown name, with the nearest names; for a file that
    cannot be imported, with the line; for a file that defines no mission; and for a name
    that two missions have.

        find_mission("mars-drag-tracking")
        find_mission("missions/my_lander.py")
    """
    if is_file(str(name)):
        mission = mission_in_file(Path(name))
        rivals = _places(mission.name)
        if rivals:
            raise ValueError(
                f"MISSION of {name} is named {mission.name!r}, which is also the name of "
                f"{rivals[0]}: give yours another name"
            )
        return mission
    packaged = packaged_missions()
    places = _places(str(name))
    if len(places) > 1:
        raise ValueError(f"{' and '.join(places)} have the same name, {name!r}")
    if name in packaged:
        return mission_of_package(packaged[str(name)][0])
    if name not in ALL:
        file = Path(f"{name}.py")
        beside = f"; did you mean {file}?" if file.exists() else ""
        known = nearest(str(name), {**ALL, **packaged})
        raise ValueError(f"no mission {name!r}; {known}{beside}")
    return ALL[str(name)]


def every_mission() -> Iterator[Mission | ValueError]:
    """Every mission of jentry and of installed packages, or the error of its import."""
    for name in dict.fromkeys((*ALL, *packaged_missions())):
        try:
            yield find_mission(name)
        except ValueError as error:
            yield error


def _places(name: str) -> list[str]:
    """Descriptions of all missions with a name."""
    own = [f"the mission {name} of jentry"] if name in ALL else []
    return own + sorted(map(where_from, packaged_missions().get(name, ())))
