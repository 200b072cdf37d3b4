"""SX-2 and its motion over the energy in numpy, from the paper and its notes.

An independent writing of what `jentry.guidance.feedback_linearization` differentiates. The
state is (r, theta, phi, V, gamma, chi), with the heading of the paper, from east to the
left, and its bank, positive to the left. Functions take complex numbers as well.
"""

import numpy as np
from scipy.interpolate import CubicSpline


FOOT, SLUG, DEGREE = 0.3048, 14.593902937206364, np.pi / 180.0
MU, R0 = 3.986004418e14, 6_378_137.0
MASS, AREA = 2558.277 * SLUG, 709.2 * FOOT**2
HEIGHT, RHO0 = 23_443 * FOOT, 2.3769e-3 * SLUG / FOOT**3

KNOTS = [0.0, 0.06, 0.15, 0.26, 0.38, 0.52, 0.66, 0.8, 0.92, 1.05]
BANKS = [21.72, 35.79, 44.74, 44.47, 45.9, 43.82, 44.02, 41.38, 29.36, 24.93]


def energy(r, v):
    return 0.5 * v**2 - MU / r


FIRST = energy(R0 + 200_000 * FOOT, 17_000 * FOOT)
LAST = energy(R0 + 84_000 * FOOT, 2647 * FOOT)
SPAN = FIRST - LAST


def share(r, v):
    """e: one at the start, zero at the end."""
    return (energy(r, v) - LAST) / SPAN


def reference_angle(e):
    x = (e - 0.05) / 0.55
    if np.real(x) <= 0.0 or np.real(x) >= 1.0:
        return DEGREE * (12.0 if np.real(x) <= 0.0 else 20.0)
    return DEGREE * (12.0 + 8.0 * (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5))


_SPLINE = CubicSpline(KNOTS, BANKS)


def reference_bank(e):
    """To the left, as in the paper."""
    piece = int(np.clip(np.searchsorted(KNOTS, np.real(e)) - 1, 0, len(KNOTS) - 2))
    way = e - KNOTS[piece]
    cubic = sum(c * way**k for k, c in enumerate(_SPLINE.c[::-1, piece]))
    return DEGREE * cubic * np.tanh((e - 0.345) / 0.014)


def gravity(r):
    return MU / r**2


def pressure(r, v):
    return 0.5 * RHO0 * np.exp(-(r - R0) / HEIGHT) * v**2


def drag(r, v, angle):
    coefficient = 3.7677 * angle**2 - 0.1427 * angle + 0.1971
    return pressure(r, v) * AREA * coefficient / MASS


def lift(r, v, angle):
    return pressure(r, v) * AREA * (2.5457 * angle - 0.0448) / MASS


def flow(x, above, left, d):
    """Equations (10) to (15), over the share of the energy."""
    r, _, phi, v, gamma, chi = x
    g, sin, cos = gravity(r), np.sin, np.cos
    rates = [
        -sin(gamma) / d,
        -cos(gamma) * cos(chi) / (d * r * cos(phi)),
        -cos(gamma) * sin(chi) / (d * r),
        (d + g * sin(gamma)) / (d * v),
        -(above - (g - v**2 / r) * cos(gamma)) / (d * v**2),
        -(left / cos(gamma) - v**2 * cos(gamma) * cos(chi) * np.tan(phi) / r)
        / (d * v**2),
    ]
    return SPAN * np.array(rates)


def small_flow(x, above, left, d):
    """Equations (28) to (32); V by the definition of the energy."""
    r, _, phi, v, gamma, chi = x
    g = gravity(r)
    rates = [
        -gamma / d,
        -1.0 / (r * d),
        -chi / (r * d),
        (1.0 + g * gamma / d) / v,
        (g - v**2 / r - above) / (d * v**2),
        -(-phi / r + left / v**2) / d,
    ]
    return SPAN * np.array(rates)


def along(function, x, direction):
    """Derivative of a function of the state along a direction, by a complex step."""
    step = 1e-30
    moved = np.asarray(x, complex) + 1j * step * np.asarray(direction)
    return np.imag(function(moved)) / step


def differences(function, x, direction, step=2e-5):
    """Likewise by Richardson's differences of fourth order."""

    def central(h):
        return (function(x + h * direction) - function(x - h * direction)) / (2.0 * h)

    return (4.0 * central(0.5 * step) - central(step)) / 3.0


def reference_drag(x):
    r, v = x[0], x[3]
    return drag(r, v, reference_angle(share(r, v)))


def reference_flow(x):
    """Under the reference controls."""
    r, v = x[0], x[3]
    e = share(r, v)
    size, bank = lift(r, v, reference_angle(e)), reference_bank(e)
    return flow(x, size * np.cos(bank), size * np.sin(bank), reference_drag(x))


def track_slope(output):
    """y1' (output 1) or y2' (output 2), which lift does not move."""
    return lambda x: flow(x, 0.0, 0.0, reference_drag(x))[output]


def downrange_curvature(x):
    """y1'' under the reference controls."""
    return along(track_slope(1), x, reference_flow(x))
