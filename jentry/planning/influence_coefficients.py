"""Influence coefficients of a planned flight: the reference of a terminal-point law."""

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from .._integrate import runge_kutta
from .._math import derivatives_along, sincos
from .._setup import needs_float64
from ..fields import Scalar
from ..guidance.open_loop import BankProfile
from ..guidance.terminal_point import COLUMNS
from ..motion.forces import air_data
from ..motion.index import AbstractIndex, AltitudeIndex, VelocityIndex
from ..motion.quantities import ground_track
from ..motion.state import EntryState
from ..onboard.longitudinal import LongitudinalModel, LongitudinalState
from ..onboard.model import OnboardModel, require_still_air
from ..onboard.profiles import (
    PolynomialProfile,
    QuinticProfile,
    QuinticTable,
    grid,
    quintic_table,
)
from ..onboard.reference import Reference
from .reference_flight import ReferenceFlight


_STEPS = 2
"""Runge-Kutta steps of the adjoint in each interval of the table"""

Deviation = Float[Array, " 2"]
"""Altitude (m) and flight-path angle (rad), or the adjoint of them"""


@needs_float64
def plan_terminal_point(
    flight: ReferenceFlight,
    end_velocity: Scalar | float,
    end: AbstractIndex = VelocityIndex(),
    start_drag: Scalar | float = 2.0,
    intervals: int = 1000,
) -> Reference:
    """Reference of `TerminalPoint`: a planned flight and its influence coefficients.

    Over the velocity V let y be altitude and flight-path angle, u the upward lift-to-drag
    ratio, f(V, y, u) = dy/dV and g(V, y) = dR/dV, where R is the range flown. Deviations
    at a fixed velocity, about the planned flight with its u over the velocity, obey

        d(dy)/dV = f_y dy + f_u du        d(dR)/dV = g_y dy

    Let the flight end where an index X(V, y) has its planned value. The end then moves by
    the velocity -X_y dy / (X_V + X_y f), and the range by g times that. With the
    Hamiltonian H = l f + g the adjoint l and the effect m of a constant du are

        dl/dV = -dH/dy    l = -g X_y / (X_V + X_y f) at the end
        dm/dV = -dH/du    m = 0 at the end

    such that the range to the end changes by l(V) dy + m(V) du. With the drag D and the
    altitude rate r = V sin(gamma), as deviations at a fixed velocity, this is

        F1 = dR/dD = l_h / (dD/dh)    F2 = dR/dr = l_gamma / (V cos(gamma))    F3 = m

    The derivatives of H are by reverse differentiation of the motion. Lateral motion and
    rotation of the planet are neglected in the coefficients, and not in the flight.

    These are the coefficients of the final phase of Apollo (D. J. Morth, "Reentry Guidance
    for Apollo", MIT R-532, 1966), whose adjoint is over time. The equations above are our
    derivation.

    **Arguments:**

    - `flight`: planned flight under a `BankProfile`. It must continue past the end.
    - `end_velocity`: velocity at the end of guided flight, m/s.
    - `end`: index that ends guided flight; `AltitudeIndex()` for the range to an altitude.
    - `start_drag`: drag above which the table starts, m/s2; the velocity must fall there.
    - `intervals`: number of intervals of the table.

    **Raises:** `ValueError` for a flight under another law, for a wind, and for a velocity
    or a drag that the flight does not reach. In a compiled program the coefficients are
    then NaN.
    """
    scenario = flight.scenario
    law = scenario.guidance
    if not isinstance(law, BankProfile):
        raise ValueError(f"the flight is under {type(law).__name__}, not a BankProfile")
    planet, vehicle, origin = scenario.planet, scenario.vehicle, scenario.initial_state
    require_still_air(planet, "a terminal-point reference")
    angle = law.angle_of_attack
    angle = vehicle.trim_angle_of_attack if angle is None else angle
    onboard = OnboardModel(planet, vehicle)
    model = LongitudinalModel(onboard, PolynomialProfile(jnp.reshape(angle, 1)))

    def quantities(time: Scalar, state: EntryState) -> dict[str, Scalar]:
        air = air_data(planet, vehicle, state, angle)
        cosine = jnp.clip(law.cos_bank(state.velocity), -1.0, 1.0)
        return {
            "altitude": state.altitude,
            "flight_path_angle": state.flight_path_angle,
            "lift_to_drag_up": cosine * air.lift / air.drag,
            "downrange": ground_track(planet, origin, state)[0],
        }

    drags = jax.vmap(lambda s: air_data(planet, vehicle, s, angle).drag)(flight.states)
    _, state = flight.first_above(jnp.asarray(drags), start_drag, "start_drag")
    start = state.velocity
    end_velocity = _below(
        start, flight.reached(VelocityIndex(), end_velocity, "end_velocity")
    )
    flown = flight.tabulate(quantities, VelocityIndex(), intervals, start)
    return Reference(
        VelocityIndex(),
        _with_coefficients(model, flown, start, end_velocity, end, intervals),
    )


@needs_float64
def plan_range_over_altitude(
    flight: ReferenceFlight,
    end_velocity: Scalar | float,
    start_altitude: Scalar | float,
    intervals: int = 1000,
) -> QuinticProfile:
    """Range to go of a planned flight (m) over the altitude (m), for `EarlyEnd`.

    **Arguments:**

    - `flight`: planned flight, which descends from `start_altitude` on and continues past
      the end.
    - `end_velocity`: velocity at which no range is left, m/s.
    - `start_altitude`: altitude at which the table starts, m.
    - `intervals`: number of intervals of the table.

    **Raises:** `ValueError` for a velocity or an altitude that the flight does not reach.
    In a compiled program the range is then NaN.
    """
    planet, origin = flight.scenario.planet, flight.scenario.initial_state

    def quantities(time: Scalar, state: EntryState) -> dict[str, Scalar]:
        return {"downrange": ground_track(planet, origin, state)[0]}

    end_velocity = flight.reached(VelocityIndex(), end_velocity, "end_velocity")
    after = flight.tabulate(quantities, VelocityIndex(), 1, end_velocity)
    at_end = after.profile("downrange")(end_velocity)

    def to_go(time: Scalar, state: EntryState) -> dict[str, Scalar]:
        return {"range_to_go": at_end - quantities(time, state)["downrange"]}

    start = flight.reached(AltitudeIndex(), start_altitude, "start_altitude")
    return flight.tabulate(to_go, AltitudeIndex(), intervals, start).profile(
        "range_to_go"
    )


def _below(start: Scalar, end: Scalar) -> Scalar:
    """The velocity at the end, m/s; it must be below that at the start of the table."""
    below = end < start
    if not isinstance(below, Tracer) and not below:
        raise ValueError(
            f"end_velocity is {float(end):g} m/s: it must be below the velocity where the "
            f"drag first exceeds start_drag, {float(start):g} m/s"
        )
    return jnp.where(below, end, jnp.nan)


def _with_coefficients(
    model: LongitudinalModel,
    flown: QuinticTable,
    start: Scalar,
    end_velocity: Scalar,
    end: AbstractIndex,
    intervals: int,
) -> QuinticTable:
    """Table of `COLUMNS` from a start to an end velocity (m/s), of a flown table."""
    planet = model.onboard.planet

    def read(velocity: Scalar) -> dict[str, Scalar]:
        return {k: v[0] for k, v in flown.with_derivatives(velocity).items()}

    def planned(velocity: Scalar) -> tuple[Deviation, Scalar]:
        at = read(velocity)
        return jnp.stack([at["altitude"], at["flight_path_angle"]]), at[
            "lift_to_drag_up"
        ]

    def state_at(velocity: Scalar, y: Deviation) -> LongitudinalState:
        altitude, path = y
        return LongitudinalState(altitude, velocity, path, jnp.zeros_like(velocity))

    def over_velocity(velocity: Scalar, y: Deviation, up: Scalar):
        """f and g."""
        rates = model.rates(state_at(velocity, y), up)
        each = 1.0 / rates.velocity
        f = jnp.stack([rates.altitude, rates.flight_path_angle]) * each
        return f, rates.downrange * each

    def slope(velocity: Scalar, adjoint: tuple[Deviation, Scalar]):
        by, _ = adjoint

        def hamiltonian(y: Deviation, up: Scalar) -> Scalar:
            f, g = over_velocity(velocity, y, up)
            return jnp.dot(by, f) + g

        by_y, by_up = jax.grad(hamiltonian, (0, 1))(*planned(velocity))
        return -by_y, -by_up

    def at_end() -> Deviation:
        y, up = planned(end_velocity)
        f, g = over_velocity(end_velocity, y, up)

        def index(velocity: Scalar, y: Deviation) -> Scalar:
            there = state_at(velocity, y).eastward()
            return end.value(planet, jnp.zeros_like(velocity), there)

        by_velocity, by_y = jax.grad(index, (0, 1))(end_velocity, y)
        return -g / (by_velocity + jnp.dot(by_y, f)) * by_y

    def columns(point) -> dict[str, Scalar]:
        velocity, (by, by_up) = point
        at = read(velocity)
        y, _ = planned(velocity)
        sine, cosine = sincos(at["flight_path_angle"])

        def drag(altitude: Scalar) -> Scalar:
            here = state_at(velocity, y.at[0].set(altitude)).eastward()
            vehicle = model.onboard.vehicle
            angle = model.angle_of_attack(velocity)
            return air_data(planet, vehicle, here, angle).drag

        value, per_altitude = jax.value_and_grad(drag)(at["altitude"])
        by_altitude, by_path = by
        found = (
            value,
            velocity * sine,
            at["lift_to_drag_up"],
            read(end_velocity)["downrange"] - at["downrange"],
            by_altitude / per_altitude,
            by_path / (velocity * cosine),
            by_up,
        )
        return dict(zip(COLUMNS, found, strict=True))

    def flow(point):
        velocity, adjoint = point
        return jnp.ones_like(velocity), slope(velocity, adjoint)

    nodes = grid(start, end_velocity, intervals)

    def back(adjoint, ends):
        after, before = ends
        adjoint = runge_kutta(slope, after, before, adjoint, _STEPS)
        return adjoint, adjoint

    last = at_end(), jnp.zeros_like(end_velocity)
    backward = nodes[::-1]
    _, earlier = lax.scan(back, last, (backward[:-1], backward[1:]))
    adjoints = jax.tree.map(
        lambda end, x: jnp.concatenate([end[None], x])[::-1], last, earlier
    )
    along = jax.vmap(lambda *point: derivatives_along(flow, columns, point))
    values, firsts, seconds = along(nodes, adjoints)
    return quintic_table(
        nodes, {k: (values[k], firsts[k], seconds[k]) for k in COLUMNS}
    )
