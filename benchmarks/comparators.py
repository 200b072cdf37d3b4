"""The guided Mars entry of jentry's mission, written without jentry.

Four programs that a reader might write instead: vectors in C (`flights.c`), scalars in
numba, scipy's `solve_ivp`, and diffrax batched with `vmap`. Each flies the same vehicle
with the same law: a planar point mass over a sphere that does not turn (in C also one in
three dimensions), drag tracking with a high-gain observer over energy, ended at a velocity
or an altitude, whichever is met first. State: altitude, downrange angle, velocity,
flight-path angle, and the two estimates of the observer.

Each takes one array entry per flight and returns the arrays (time, altitude, downrange,
velocity) at the end of flight, in SI units.
"""

import ctypes
import functools
import math
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np


class Mission(NamedTuple):
    """What all flights have in common, in SI units."""

    planet_radius: float
    gravitational_parameter: float
    surface_density: float
    scale_height: float
    reference_area: float
    lift_coefficient: float
    drag_coefficient: float
    altitude: float
    """Altitude, velocity and flight-path angle are those at entry."""
    velocity: float
    flight_path_angle: float
    end_velocity: float
    end_altitude: float
    time_limit: float
    epsilon0: float
    a: float
    b: float
    epsilon: float
    l1: float
    l2: float
    reference_start: float
    """Energy at the first node of the reference drag, J/kg"""
    reference_spacing: float
    """Mean one of the nodes, of which node k of n lies at the share (k / n)^2 of the way;
    the reference has a row of six quintic coefficients for each interval, highest power
    first"""


class Plan(NamedTuple):
    """The numbers that the inner loop needs, with the divisions done beforehand."""

    planet_radius: float
    gravitational_parameter: float
    per_scale_height: float
    lift_to_drag: float
    feedback_error: float
    feedback_rate: float
    innovation_error: float
    innovation_rate: float
    reference_start: float
    per_spacing: float
    intervals: int


def plan(mission: Mission, reference: np.ndarray) -> Plan:
    """Constants of the inner loop; the law believes in the nominal vehicle and air."""
    m = mission
    return Plan(
        planet_radius=m.planet_radius,
        gravitational_parameter=m.gravitational_parameter,
        per_scale_height=1.0 / m.scale_height,
        lift_to_drag=m.lift_coefficient / m.drag_coefficient,
        feedback_error=m.a / m.epsilon0**2,
        feedback_rate=m.b / m.epsilon0,
        innovation_error=m.l1 / m.epsilon,
        innovation_rate=m.l2 / m.epsilon**2,
        reference_start=m.reference_start,
        per_spacing=1.0 / m.reference_spacing,
        intervals=len(reference),
    )


def force_factors(mission: Mission, mass, density_scale, lift_scale, drag_scale):
    """Lift and drag over exp(-altitude / scale height) velocity^2, 1/m."""
    half_area = 0.5 * mission.reference_area * mission.surface_density
    common = half_area * density_scale / mass
    lift = common * lift_scale * mission.lift_coefficient
    return lift, common * drag_scale * mission.drag_coefficient


def rates(
    altitude, velocity, path, error, error_rate, lift_factor, drag_factor, p, table
):
    """Time derivative of a flight: scalars in, scalars out, for Python and numba alike.

    `table` holds the reference row after row. The downrange angle drives nothing.
    """
    sin = math.sin(path)
    cos = math.cos(path)
    per_radius = 1.0 / (p.planet_radius + altitude)
    per_velocity = 1.0 / velocity
    square = velocity * velocity
    attraction = p.gravitational_parameter * per_radius
    gravity = attraction * per_radius
    pressure = math.exp(-altitude * p.per_scale_height) * square
    drag = drag_factor * pressure
    lift = lift_factor * pressure

    # The reference drag and its two derivatives over energy.
    position = (0.5 * square - attraction - p.reference_start) * p.per_spacing
    inside = min(max(position, 0.0), p.intervals)
    interval = min(int(math.sqrt(inside * p.intervals)), p.intervals - 1)
    per_width = p.intervals / (2.0 * interval + 1.0)
    x = inside * per_width - interval * (interval / (2.0 * interval + 1.0))
    row = 6 * interval
    c0 = table[row]
    c1 = table[row + 1]
    c2 = table[row + 2]
    c3 = table[row + 3]
    c4 = table[row + 4]
    c5 = table[row + 5]
    wanted = ((((c0 * x + c1) * x + c2) * x + c3) * x + c4) * x + c5
    first = (((5.0 * c0 * x + 4.0 * c1) * x + 3.0 * c2) * x + 2.0 * c3) * x + c4
    second = ((20.0 * c0 * x + 12.0 * c1) * x + 6.0 * c2) * x + 2.0 * c3
    beyond = (position - inside) * per_width
    wanted += beyond * (first + 0.5 * beyond * second)
    per_unit = p.per_spacing * per_width
    first = (first + beyond * second) * per_unit
    second *= per_unit * per_unit

    # Drag dynamics as modelled on board: drag'' = f + g0 u.
    gravity_along = gravity * sin
    common = -velocity * sin * p.per_scale_height - 2.0 * gravity_along * per_velocity
    slowing = 2.0 * drag * per_velocity
    drag_rate = drag * (common - slowing)
    sin2 = sin * sin
    cos2 = cos * cos
    turning = (
        drag * drag + 2.0 * drag * gravity_along + gravity * gravity * (sin2 - cos2)
    )
    f = (common - 2.0 * slowing) * drag_rate + drag * (
        (drag * sin + gravity) * p.per_scale_height
        + (gravity * (4.0 * sin2 - 2.0 * cos2) - square * cos2 * p.per_scale_height)
        * per_radius
        - 2.0 * turning * per_velocity * per_velocity
    )
    g0 = (
        -(velocity * p.per_scale_height + 2.0 * gravity * per_velocity)
        * (p.lift_to_drag * drag * drag)
        * (cos * per_velocity)
    )

    # The law, and the observer that it is fed by.
    energy_rate = -drag * velocity
    energy_drift = -drag_rate * velocity + drag * (drag + gravity_along)
    wanted_acceleration = second * energy_rate * energy_rate + first * energy_drift
    x1 = drag - wanted
    feedback = -p.feedback_error * x1 - p.feedback_rate * error_rate
    u = (wanted_acceleration - f + feedback) / g0
    u = min(max(u, -1.0), 1.0)
    innovation = x1 - error

    turn = velocity * cos * per_radius
    return (
        velocity * sin,
        turn,
        -drag - gravity_along,
        (lift * u - gravity * cos) * per_velocity + turn,
        error_rate + p.innovation_error * innovation,
        feedback + p.innovation_rate * innovation,
    )


@functools.cache
def _numba_program(fastmath: bool, parallel: bool):
    import numba

    flow = numba.njit(rates, fastmath=fastmath, inline="always")

    @numba.njit(fastmath=fastmath)
    def step(h, s, v, g, e, d, lift, drag, p, table, dt):
        half = 0.5 * dt
        h1, s1, v1, g1, e1, d1 = flow(h, v, g, e, d, lift, drag, p, table)
        h2, s2, v2, g2, e2, d2 = flow(
            h + half * h1,
            v + half * v1,
            g + half * g1,
            e + half * e1,
            d + half * d1,
            lift,
            drag,
            p,
            table,
        )
        h3, s3, v3, g3, e3, d3 = flow(
            h + half * h2,
            v + half * v2,
            g + half * g2,
            e + half * e2,
            d + half * d2,
            lift,
            drag,
            p,
            table,
        )
        h4, s4, v4, g4, e4, d4 = flow(
            h + dt * h3,
            v + dt * v3,
            g + dt * g3,
            e + dt * e3,
            d + dt * d3,
            lift,
            drag,
            p,
            table,
        )
        w = dt / 6.0
        return (
            h + w * (h1 + 2.0 * (h2 + h3) + h4),
            s + w * (s1 + 2.0 * (s2 + s3) + s4),
            v + w * (v1 + 2.0 * (v2 + v3) + v4),
            g + w * (g1 + 2.0 * (g2 + g3) + g4),
            e + w * (e1 + 2.0 * (e2 + e3) + e4),
            d + w * (d1 + 2.0 * (d2 + d3) + d4),
        )

    @numba.njit(fastmath=fastmath)
    def fly(lift, drag, mission, p, table, dt):
        h, v, g = mission.altitude, mission.velocity, mission.flight_path_angle
        t, s, d = 0.0, 0.0, 0.0
        # With estimates of zero the first estimate grows by the innovation alone.
        e = flow(h, v, g, 0.0, 0.0, lift, drag, p, table)[4] / p.innovation_error
        margin = min(v - mission.end_velocity, h - mission.end_altitude)
        while t < mission.time_limit:
            y = step(h, s, v, g, e, d, lift, drag, p, table, dt)
            after = min(y[2] - mission.end_velocity, y[0] - mission.end_altitude)
            if after <= 0.0:
                break
            t += dt
            h, s, v, g, e, d = y
            margin = after
        # The end lies within one step: shorten it by the rule of false position, with the
        # margin of an end halved that stays: of the two conditions first one, then the
        # other is the nearer, and without it some flights were metres off.
        short, at_short, long, at_long = 0.0, margin, dt, after
        trial, side = 0.0, 0
        for _ in range(30):
            if at_long > 0.0:
                break
            trial = short + (long - short) * at_short / (at_short - at_long)
            y = step(h, s, v, g, e, d, lift, drag, p, table, trial)
            after = min(y[2] - mission.end_velocity, y[0] - mission.end_altitude)
            if abs(after) < 1e-7:
                break
            if after > 0.0:
                if side > 0:
                    at_long *= 0.5
                short, at_short, side = trial, after, 1
            else:
                if side < 0:
                    at_short *= 0.5
                long, at_long, side = trial, after, -1
        h, s, v, g, e, d = y
        return t + trial, h, s * mission.planet_radius, v

    each = numba.prange if parallel else range

    @numba.njit(fastmath=fastmath, parallel=parallel)
    def fly_all(lift, drag, mission, p, table, dt):
        out = np.empty((4, lift.size))
        for i in each(lift.size):
            end = fly(lift[i], drag[i], mission, p, table, dt)
            out[0, i], out[1, i], out[2, i], out[3, i] = end
        return out

    return fly_all


def numba_flights(
    mission: Mission,
    reference: np.ndarray,
    mass: np.ndarray,
    density_scale: np.ndarray,
    lift_scale: np.ndarray,
    drag_scale: np.ndarray,
    step: float = 0.1,
    fastmath: bool = True,
    threads: int = 1,
):
    """One flight after the other, classical Runge-Kutta, all state in registers."""
    p = plan(mission, reference)
    lift, drag = force_factors(mission, mass, density_scale, lift_scale, drag_scale)
    table = np.ascontiguousarray(reference).ravel()
    if threads > 1:
        import numba

        numba.set_num_threads(threads)
    fly_all = _numba_program(fastmath, threads > 1)
    return tuple(fly_all(lift, drag, mission, p, table, step))


class NoCProgramError(RuntimeError):
    """There is no C compiler, or it does not compile the program."""


# Not -ffast-math, which is no faster here: a library that is linked with it has the whole
# process take the smallest numbers for zero.
_C_FLAGS = (
    *("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math"),
    *("-ffinite-math-only", "-fno-signed-zeros", "-shared", "-fPIC", "-pthread"),
)


@functools.cache
def c_program(*, space: bool):
    """`fly_all` of `flights.c`, compiled into a folder that is gone afterwards.

    In the plane, or in space: in three dimensions.

    Raises:
        NoCProgramError: There is no compiler `cc`, or it fails.

    """
    compiler = shutil.which("cc")
    if compiler is None:
        raise NoCProgramError("there is no C compiler `cc`")
    source = Path(__file__).with_name("flights.c")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "flights.so"
        flags = (*_C_FLAGS, "-DSPACE") if space else _C_FLAGS
        command = compiler, *flags, source, "-o", library, "-lm"
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise NoCProgramError(f"`cc` fails on {source.name}:\n{done.stderr}")
        fly_all = ctypes.CDLL(str(library)).fly_all
    numbers = ctypes.c_void_p
    fly_all.argtypes = (
        *5 * (numbers,),
        *(ctypes.c_long, ctypes.c_double, ctypes.c_int),
        numbers,
    )
    return fly_all


def _rows_for_c(reference: np.ndarray) -> np.ndarray:
    """Rows of the reference, each with the two numbers that place an energy in its
    interval, in one line of the cache. Shape (intervals, 8)."""
    count = len(reference)
    memory = np.zeros(8 * count + 7)
    first = -memory.ctypes.data % 64 // 8
    rows = memory[first : first + 8 * count].reshape(count, 8)
    interval = np.arange(count)
    rows[:, :6] = reference
    rows[:, 6] = count / (2.0 * interval + 1.0)
    rows[:, 7] = interval * (interval / (2.0 * interval + 1.0))
    return rows


def c_flights(
    mission: Mission,
    reference: np.ndarray,
    mass: np.ndarray,
    density_scale: np.ndarray,
    lift_scale: np.ndarray,
    drag_scale: np.ndarray,
    step: float = 0.1,
    threads: int = 1,
    space: bool = False,
):
    """Eight flights to a vector, classical Runge-Kutta: see `flights.c`.

    In space, that is in three dimensions, the downrange that it returns is the longitude,
    on the radius of the planet.

    Raises:
        NoCProgramError: There is no compiler `cc`, or it fails.

    """
    factors = force_factors(mission, mass, density_scale, lift_scale, drag_scale)
    lift, drag = (np.ascontiguousarray(x, dtype=float) for x in factors)
    given = np.array(mission, float), np.array(plan(mission, reference), float)
    given = *given, _rows_for_c(reference), lift, drag
    out = np.empty((4, lift.size))
    places = [x.ctypes.data for x in given]
    if c_program(space=space)(*places, lift.size, step, threads, out.ctypes.data) != 0:
        raise RuntimeError(f"the system gives no {threads} threads")
    return tuple(out)


def scipy_flights(
    mission: Mission,
    reference: np.ndarray,
    mass: np.ndarray,
    density_scale: np.ndarray,
    lift_scale: np.ndarray,
    drag_scale: np.ndarray,
    tolerance: float = 1e-6,
    method: str = "RK45",
):
    """One flight after the other with `solve_ivp`, scalars and `math` inside.

    `DOP853` with a tolerance of 1e-12 is the truth that all programs are judged by.
    """
    from scipy.integrate import solve_ivp

    p = plan(mission, reference)
    factors = force_factors(mission, mass, density_scale, lift_scale, drag_scale)
    table = reference.ravel().tolist()  # a list is quicker to index than an array

    def field(t, y, lift, drag):
        h, _, v, g, e, d = y.tolist()
        return rates(h, v, g, e, d, lift, drag, p, table)

    def slow(t, y, lift, drag):
        return y[2] - mission.end_velocity

    def low(t, y, lift, drag):
        return y[0] - mission.end_altitude

    slow.terminal = low.terminal = True
    ends = []
    for lift, drag in zip(*(x.tolist() for x in factors), strict=True):
        start = mission.altitude, 0.0, mission.velocity, mission.flight_path_angle
        at_rest = (*start, 0.0, 0.0)
        error = field(0.0, np.array(at_rest), lift, drag)[4] / p.innovation_error
        solution = solve_ivp(
            field,
            (0.0, mission.time_limit),
            (*start, error, 0.0),
            method,
            events=(slow, low),
            args=(lift, drag),
            rtol=tolerance,
            atol=tolerance,
        )
        h, s, v = solution.y[:3, -1]
        ends.append((solution.t[-1], h, s * mission.planet_radius, v))
    return tuple(np.array(ends).T)


def _jax_rates(p: Plan, table, y, lift_factor, drag_factor):
    """`rates` in jax.numpy; `table` has a row for each interval."""
    import jax.numpy as jnp

    altitude, _, velocity, path, error, error_rate = y
    sin, cos = jnp.sin(path), jnp.cos(path)
    radius = p.planet_radius + altitude
    gravity = p.gravitational_parameter / radius**2
    pressure = jnp.exp(-altitude * p.per_scale_height) * velocity**2
    lift, drag = lift_factor * pressure, drag_factor * pressure

    energy = 0.5 * velocity**2 - p.gravitational_parameter / radius
    position = (energy - p.reference_start) * p.per_spacing
    inside = jnp.clip(position, 0.0, p.intervals)
    interval = jnp.floor(jnp.sqrt(inside * p.intervals))
    interval = jnp.clip(interval, 0, p.intervals - 1)
    row = table[interval.astype(int)]
    per_width = p.intervals / (2.0 * interval + 1.0)
    x = (inside - interval**2 / p.intervals) * per_width
    beyond = (position - inside) * per_width
    wanted = jnp.polyval(row, x)
    first = jnp.polyval(row[:5] * jnp.arange(5.0, 0.0, -1.0), x)
    second = jnp.polyval(row[:4] * jnp.array([20.0, 12.0, 6.0, 2.0]), x)
    wanted = wanted + beyond * (first + 0.5 * beyond * second)
    per_unit = p.per_spacing * per_width
    first = (first + beyond * second) * per_unit
    second = second * per_unit**2

    common = -velocity * sin * p.per_scale_height - 2.0 * gravity * sin / velocity
    drag_rate = drag * (common - 2.0 * drag / velocity)
    turning = drag**2 + 2.0 * drag * gravity * sin + gravity**2 * (sin**2 - cos**2)
    f = (common - 4.0 * drag / velocity) * drag_rate + drag * (
        (drag * sin + gravity) * p.per_scale_height
        + gravity * (4.0 * sin**2 - 2.0 * cos**2) / radius
        - 2.0 * turning / velocity**2
        - velocity**2 * cos**2 * p.per_scale_height / radius
    )
    steepness = velocity * p.per_scale_height + 2.0 * gravity / velocity
    g0 = -steepness * p.lift_to_drag * drag**2 * cos / velocity

    energy_rate = -drag * velocity
    energy_drift = -drag_rate * velocity + drag * (drag + gravity * sin)
    wanted_acceleration = second * energy_rate**2 + first * energy_drift
    x1 = drag - wanted
    feedback = -p.feedback_error * x1 - p.feedback_rate * error_rate
    u = jnp.clip((wanted_acceleration - f + feedback) / g0, -1.0, 1.0)
    innovation = x1 - error
    turn = velocity * cos / radius
    return jnp.stack(
        [
            velocity * sin,
            turn,
            -drag - gravity * sin,
            (lift * u - gravity * cos) / velocity + turn,
            error_rate + p.innovation_error * innovation,
            feedback + p.innovation_rate * innovation,
        ]
    )


@functools.cache
def _diffrax_program(mission: Mission, p: Plan, tolerance: float):
    import diffrax
    import jax
    import jax.numpy as jnp
    import optimistix

    def field(t, y, args):
        table, lift, drag = args
        return _jax_rates(p, table, y, lift, drag)

    def margin(t, y, args, **kwargs):
        return jnp.minimum(y[2] - mission.end_velocity, y[0] - mission.end_altitude)

    def fly(table, lift, drag):
        start = mission.altitude, 0.0, mission.velocity, mission.flight_path_angle
        y = jnp.array([*start, 0.0, 0.0])
        # With estimates of zero the first estimate grows by the innovation alone.
        error = _jax_rates(p, table, y, lift, drag)[4] / p.innovation_error
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Tsit5(),
            t0=0.0,
            t1=mission.time_limit,
            dt0=0.1,
            y0=y.at[4].set(error),
            args=(table, lift, drag),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            event=diffrax.Event(margin, optimistix.Newton(1e-9, 1e-9)),
        )
        h, s, v = solution.ys[0, :3]
        return solution.ts[0], h, s * mission.planet_radius, v

    return jax.jit(jax.vmap(fly, in_axes=(None, 0, 0)))


def diffrax_flights(
    mission: Mission,
    reference: np.ndarray,
    mass: np.ndarray,
    density_scale: np.ndarray,
    lift_scale: np.ndarray,
    drag_scale: np.ndarray,
    tolerance: float = 1e-6,
):
    """All flights at once: `vmap` over `diffeqsolve` with its own steps and event.

    In double precision only where the process has switched JAX to it.
    """
    import jax

    lift, drag = force_factors(mission, mass, density_scale, lift_scale, drag_scale)
    program = _diffrax_program(mission, plan(mission, reference), tolerance)
    return jax.block_until_ready(program(reference, lift, drag))
