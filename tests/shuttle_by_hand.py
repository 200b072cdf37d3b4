"""The Shuttle's re-entry without jentry: Betts's equations, in his units, by scipy."""

import numpy as np
import scipy.integrate
import scipy.interpolate


RADIUS, MU = 20_902_900.0, 0.14076539e17
MASS, AREA = 203_000.0 / 32.174, 2690.0
END_ENERGY = 0.5 * 2500.0**2 - MU / (RADIUS + 80e3)
START = np.array([260e3, 0.0, 0.0, 25_600.0, np.radians(-1.0), np.radians(90.0)])
"""Altitude, longitude, latitude, velocity, path angle, heading; ft, rad, ft/s"""
FOOT = 0.3048


def energy(state):
    """ft2/s2"""
    return 0.5 * state[3] ** 2 - MU / (RADIUS + state[0])


def heat_rate(state, angle):
    """Btu/(ft2 s), at an angle of attack in rad."""
    alpha = np.degrees(angle)
    of_angle = 1.0672181 + alpha * (
        -0.19213774e-1 + alpha * (0.21286289e-3 - 0.10117249e-5 * alpha)
    )
    density = 0.002378 * np.exp(-state[0] / 23_800.0)
    return of_angle * 17_700.0 * np.sqrt(density) * (1e-4 * state[3]) ** 3.07


def rates(state, angle, bank):
    altitude, _, latitude, velocity, path, heading = state
    radius, alpha = RADIUS + altitude, np.degrees(angle)
    pressure = 0.5 * 0.002378 * np.exp(-altitude / 23_800.0) * velocity**2
    lift = pressure * AREA / MASS * (-0.20704 + 0.029244 * alpha)
    drag = 0.07854 - 0.61592e-2 * alpha + 0.621408e-3 * alpha**2
    drag = pressure * AREA / MASS * drag
    gravity, along = MU / radius**2, velocity / radius * np.cos(path)
    return np.array(
        [
            velocity * np.sin(path),
            along * np.sin(heading) / np.cos(latitude),
            along * np.cos(heading),
            -drag - gravity * np.sin(path),
            lift * np.cos(bank) / velocity
            + np.cos(path) * (velocity / radius - gravity / velocity),
            lift * np.sin(bank) / (velocity * np.cos(path))
            + along * np.sin(heading) * np.tan(latitude),
        ]
    )


def spline(breakpoints, coefficients):
    """A control over the energy in ft2/s2; what jentry has is in SI."""
    knots = np.asarray(breakpoints) / FOOT**2
    knots = np.r_[[knots[0]] * 3, knots, [knots[-1]] * 3]
    return scipy.interpolate.BSpline(knots, np.asarray(coefficients), 3)


def fly(angle, bank):
    """State at the end, time, and largest heat rate, with controls over the energy."""

    def controls(state):
        here = energy(state)
        return float(angle(here)), float(bank(here))

    def end(_, state):
        return energy(state) - END_ENERGY

    end.terminal, end.direction = True, -1
    solved = scipy.integrate.solve_ivp(
        lambda _, state: rates(state, *controls(state)),
        (0.0, 4000.0),
        START,
        method="DOP853",
        rtol=1e-10,
        atol=1e-9,
        events=end,
        max_step=5.0,
    )
    hottest = max(heat_rate(s, controls(s)[0]) for s in solved.y.T)
    return solved.y[:, -1], solved.t[-1], hottest
