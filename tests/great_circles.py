"""Ranges on a sphere by the formulas of textbooks, in numpy."""

import numpy as np


def by_trigonometry(radius, origin, place):
    """Along and across the great circle through the origin in its heading, in m.

    By distance and bearing on the sphere, and the right triangle that they make; angles
    in rad, origin with a heading.
    """
    (east0, north0, heading), (east, north) = origin, place
    turn = east - east0
    half = np.sin((north - north0) / 2) ** 2
    half += np.cos(north0) * np.cos(north) * np.sin(turn / 2) ** 2
    distance = 2 * np.arctan2(np.sqrt(half), np.sqrt(1 - half))
    bearing = np.arctan2(
        np.sin(turn) * np.cos(north),
        np.cos(north0) * np.sin(north) - np.sin(north0) * np.cos(north) * np.cos(turn),
    )
    off = bearing - heading
    across = np.arcsin(np.sin(distance) * np.sin(-off))
    along = np.arctan2(np.sin(distance) * np.cos(off), np.cos(distance))
    return radius * along, radius * across


def place_of(state, *, heading=False):
    names = ("longitude", "latitude", *(["heading"] if heading else []))
    return tuple(np.asarray(getattr(state, name)) for name in names)
