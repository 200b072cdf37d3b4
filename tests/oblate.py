"""Flight about an oblate planet in vectors, written in numpy without jentry.

Position (m) and velocity (m/s) are in axes that do not turn, x through the meridian of
longitude zero at time zero, z through the north pole.
"""

import dataclasses

import numpy as np
from scipy.integrate import solve_ivp


@dataclasses.dataclass
class Body:
    """Numbers of a planet, and its air."""

    parameter: float
    reference_radius: float
    harmonics: dict
    """Coefficients by degree, 2 to 4"""
    rotation_rate: float
    equatorial_radius: float
    flattening: float

    def potential(self, position):
        """Potential energy per unit mass, from the polynomials as books print them."""
        r = np.sqrt((position * position).sum())
        s = position[2] / r
        legendre = {
            2: (3 * s**2 - 1) / 2,
            3: (5 * s**3 - 3 * s) / 2,
            4: (35 * s**4 - 30 * s**2 + 3) / 8,
        }
        total = 1.0
        for degree, coefficient in self.harmonics.items():
            share = coefficient * (self.reference_radius / r) ** degree
            total = total - share * legendre[degree]
        return -self.parameter / r * total

    def gravity(self, position):
        """Minus the gradient of the potential, by steps along the imaginary axis."""
        steps = position + 1e-20j * np.eye(3)
        return -np.array([self.potential(each).imag for each in steps]) / 1e-20

    def geodetic(self, position):
        """Geodetic altitude and latitude by the iteration of the textbooks."""
        square = self.flattening * (2 - self.flattening)
        out, up = np.hypot(*position[:2]), position[2]
        latitude = np.arctan2(up, out * (1 - square))
        for _ in range(12):
            sine = np.sin(latitude)
            normal = self.equatorial_radius / np.sqrt(1 - square * sine**2)
            latitude = np.arctan2(up + square * normal * sine, out)
        sine, cosine = np.sin(latitude), np.cos(latitude)
        root = np.sqrt(1 - square * sine**2)
        return out * cosine + up * sine - self.equatorial_radius * root, latitude

    def from_geodetic(self, altitude, longitude, latitude, east, north, up):
        """Position and velocity at time zero; the velocity is relative to the planet."""
        square = self.flattening * (2 - self.flattening)
        sine, cosine = np.sin(latitude), np.cos(latitude)
        normal = self.equatorial_radius / np.sqrt(1 - square * sine**2)
        along = np.array([np.cos(longitude), np.sin(longitude), 0.0])
        to_east = np.array([-along[1], along[0], 0.0])
        pole = np.array([0.0, 0.0, 1.0])
        position = (normal + altitude) * cosine * along
        position = position + ((1 - square) * normal + altitude) * sine * pole
        velocity = east * to_east + north * (cosine * pole - sine * along)
        velocity = velocity + up * (cosine * along + sine * pole)
        return position, velocity + np.cross(self.rotation_rate * pole, position)


EARTH = Body(
    # WGS 84 (NIMA TR8350.2) and EGM96, without normalisation.
    3.986004418e14,
    6378137.0,
    {2: 1.08262668e-3, 3: -2.53266e-6, 4: -1.61962e-6},
    7.292115e-5,
    6378137.0,
    1 / 298.257223563,
)


def flown(body, position, velocity, duration, drag, lift=None, bank=0.0, wind=None):
    """Position and velocity after a duration, s.

    `drag` and `lift` are functions of geodetic altitude (m) and airspeed (m/s), in m/s2.
    The bank is about the velocity over the air, from the plane through the centre. `wind`
    is towards geodetic east, north and up, m/s.
    """
    spin = np.array([0.0, 0.0, body.rotation_rate])

    def rate(_, y):
        position, velocity = y[:3], y[3:]
        altitude, latitude = body.geodetic(position)
        over_air = velocity - np.cross(spin, position)
        if wind is not None:
            along = np.array([*position[:2], 0.0]) / np.hypot(*position[:2])
            to_east = np.array([-along[1], along[0], 0.0])
            pole, sine, cosine = spin / spin[2], np.sin(latitude), np.cos(latitude)
            axes = [to_east, cosine * pole - sine * along, cosine * along + sine * pole]
            over_air = over_air - np.tensordot(wind, np.array(axes), 1)
        airspeed = np.linalg.norm(over_air)
        force = -drag(altitude, airspeed) * over_air / airspeed
        if lift is not None:
            right = np.cross(over_air, position)
            right = right / np.linalg.norm(right)
            above = np.cross(right, over_air) / airspeed
            turned = np.cos(bank) * above + np.sin(bank) * right
            force = force + lift(altitude, airspeed) * turned
        return np.concatenate([velocity, body.gravity(position) + force])

    y = np.concatenate([position, velocity])
    options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-9}
    end = solve_ivp(rate, (0.0, duration), y, **options).y[:, -1]
    return end[:3], end[3:]


def as_vectors(body, radius, state, time):
    """Position and velocity of an entry state over a sphere of a radius, at a time, s."""
    longitude = float(state.longitude) + body.rotation_rate * time
    latitude, distance = float(state.latitude), radius + float(state.altitude)
    along = np.array([np.cos(longitude), np.sin(longitude), 0.0])
    pole = np.array([0.0, 0.0, 1.0])
    up = np.cos(latitude) * along + np.sin(latitude) * pole
    north = np.cos(latitude) * pole - np.sin(latitude) * along
    east = np.array([-along[1], along[0], 0.0])
    heading, path = float(state.heading), float(state.flight_path_angle)
    level = np.sin(heading) * east + np.cos(heading) * north
    velocity = float(state.velocity) * (np.cos(path) * level + np.sin(path) * up)
    position = distance * up
    return position, velocity + np.cross(body.rotation_rate * pole, position)
