"""Places and velocities of an entry as vectors, by nothing of ours."""

import numpy as np


def axes(longitude, latitude):
    """Up, east and north, in the frame of the planet's axis."""
    (sa, ca), (sb, cb) = ((np.sin(x), np.cos(x)) for x in (longitude, latitude))
    up = np.array([cb * ca, cb * sa, sb])
    return up, np.array([-sa, ca, 0.0]), np.array([-sb * ca, -sb * sa, cb])


def velocity_of(frame, speed, path, heading):
    up, east, north = frame
    level = np.sin(heading) * east + np.cos(heading) * north
    return speed * (np.sin(path) * up + np.cos(path) * level)
