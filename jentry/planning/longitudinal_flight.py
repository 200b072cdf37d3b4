"""Flights in the vertical plane as references, from a bank profile or from a flight."""

import jax
import jax.numpy as jnp

from .._collocation import legendre_gauss_lobatto
from .._integrate import runge_kutta
from .._programs import cached
from .._setup import needs_float64
from ..fields import Scalar, Vector
from ..flight.lane import Moving
from ..flight.sensing import command
from ..motion.forces import air_data
from ..motion.index import TimeIndex
from ..motion.quantities import ground_track
from ..motion.state import EntryState
from ..onboard.longitudinal import (
    LongitudinalModel,
    LongitudinalReference,
    LongitudinalState,
)
from ..onboard.profiles import (
    AbstractProfile,
    JoinedProfile,
    QuinticProfile,
    grid,
    quintic_profile,
)
from .drag_profile import CollocatedProfile
from .inverse_dynamics import AbstractInverse
from .reference_flight import ReferenceFlight, no_memory


_STEPS = 4000
"""Steps of the classical Runge-Kutta method over the velocity, in each part"""
_STEPS_BETWEEN_NODES = 50


@needs_float64
def plan_bank_over_velocity(
    inverse: AbstractInverse, ends: Vector, intervals: int = 400
) -> JoinedProfile:
    """Cosine of the bank over the velocity (m/s) that follows a drag profile.

    **Arguments:**

    - `inverse`: inverse dynamics of the drag profile.
    - `ends`: rising velocities (m/s): the least, those at which the cosine jumps, and the
      largest. At a jump each part uses the derivatives of the angle of attack on its side.
    - `intervals`: number of intervals of the table in each part.

    **Raises:** `ValueError` if the drag cannot be flown: if no altitude has it, or if it
    needs more lift than there is.
    """
    ends = jnp.asarray(ends, float)
    pairs = zip(ends[:-1], ends[1:], strict=True)
    parts = [cached(_bank_table)(inverse, low, high, intervals) for low, high in pairs]
    for (low, high), (nodes, cosine, _) in zip(
        zip(ends[:-1], ends[1:], strict=True), parts, strict=True
    ):
        wrong = ~(jnp.abs(cosine) <= 1.0)
        if jnp.any(wrong):
            where = int(jnp.argmax(wrong))
            raise ValueError(
                f"at {float(nodes[where]):.0f} m/s, between {float(low):g} and "
                f"{float(high):g} m/s, the drag profile requires a cosine of the bank of "
                f"{float(cosine[where]):.3g}: there is no such flight; use another drag, "
                "or an angle of attack with more lift"
            )
    return JoinedProfile(tuple(table for *_, table in parts), ends)


_DEGREE = 80
"""Degree of the polynomial through the cosines of the inverse, which provides the
derivatives of the table. Derivatives of the inverse itself take ten times as long to
compile"""


def _bank_table(
    inverse: AbstractInverse, low: Scalar, high: Scalar, intervals: int
) -> tuple[Vector, Vector, QuinticProfile]:
    """Velocities, the cosines of the bank there, and the table through them."""
    places = jnp.asarray(legendre_gauss_lobatto(_DEGREE).nodes)
    velocities = low + 0.5 * (high - low) * (1.0 + places)
    # Jumps are at the ends of a part; the last point is moved inside the part.
    inside = velocities.at[-1].set(jnp.nextafter(high, low))
    cosines = jnp.asarray(jax.vmap(lambda v: inverse.at(v).cos_bank)(inside))
    nodes = grid(low, high, intervals)
    made = CollocatedProfile(cosines, low, high)
    values = map(jnp.asarray, jax.vmap(made.with_derivatives)(nodes))
    return velocities, cosines, quintic_profile(low, nodes[1] - nodes[0], *values)


@needs_float64
def fly_longitudinal(
    model: LongitudinalModel,
    cos_bank: JoinedProfile,
    start: LongitudinalState,
    end_velocity: Scalar | float,
    parts: int = 5,
    degree: int = 10,
) -> LongitudinalReference:
    """The flight of the model in the vertical plane with a bank over the velocity.

    **Arguments:**

    - `cos_bank`: cosine of the bank; the velocity must fall through all of its parts.
    - `start`: initial state, in the last part of `cos_bank`.
    - `end_velocity`: velocity at the end of the flight, m/s, in the first part.
    - `parts`: number of pieces of equal duration in each part of `cos_bank`.
    - `degree`: degree of the polynomials over the time in each piece.

    **Raises:** `ValueError` if the velocity does not fall throughout.
    """
    end_velocity = jnp.asarray(end_velocity, float)
    reference = cached(_flown)(model, cos_bank, start, end_velocity, parts, degree)
    if not jnp.all(jnp.diff(reference.ends) > 0.0):
        raise ValueError(
            f"the flight from {float(start.velocity):g} m/s does not come down to "
            f"{float(end_velocity):g} m/s: its velocity must fall all the time"
        )
    return reference


def _flown(
    model: LongitudinalModel,
    cos_bank: JoinedProfile,
    start: LongitudinalState,
    end_velocity: Scalar,
    parts: int,
    degree: int,
) -> LongitudinalReference:
    profiles = cos_bank.parts[::-1]
    joints = [*cos_bank.ends[1:-1][::-1], end_velocity]
    nodes = jnp.asarray(legendre_gauss_lobatto(degree).nodes)

    def control(profile: AbstractProfile, state: LongitudinalState) -> Scalar:
        first, last = cos_bank.ends[0], cos_bank.ends[-1]
        velocity = jnp.clip(state.velocity, first, last)
        return profile(velocity) * model.lift_to_drag(state)

    def flow(profile: AbstractProfile, state: LongitudinalState) -> LongitudinalState:
        return model.rates(state, control(profile, state))

    def lasts(profile, state, until) -> Scalar:
        """How long the flight takes from a state to a velocity, s."""

        def over_velocity(_, moving):
            _, state = moving
            rates = flow(profile, state)
            each = 1.0 / rates.velocity
            falling = jnp.where(rates.velocity < 0.0, each, jnp.nan)
            return falling, jax.tree.map(lambda rate: rate * each, rates)

        y = jnp.zeros_like(until), state
        return runge_kutta(over_velocity, state.velocity, until, y, _STEPS)[0]

    def pieces(profile, state, length):
        """The last state, and states and controls at the nodes of each piece."""
        slope = lambda _, state: flow(profile, state)
        steps = 0.5 * length * jnp.diff(nodes)

        def to_node(state, step):
            after = runge_kutta(slope, 0.0, step, state, _STEPS_BETWEEN_NODES)
            return after, (after, control(profile, after))

        def through(state, _):
            first = state, control(profile, state)
            last, later = jax.lax.scan(to_node, state, steps)
            return last, jax.tree.map(
                lambda a, b: jnp.concatenate([a[None], b]), first, later
            )

        return jax.lax.scan(through, state, length=parts)

    state, ends, points = start, [jnp.zeros(1)], []
    for profile, until in zip(profiles, joints, strict=True):
        length = lasts(profile, state, until) / parts
        state, found = pieces(profile, state, length)
        ends.append(ends[-1][-1] + length * jnp.arange(1.0, parts + 1.0))
        points.append(found)
    states, controls = jax.tree.map(lambda *x: jnp.concatenate(x), *points)
    return LongitudinalReference(
        jnp.concatenate(ends),
        states.altitude,
        states.velocity,
        states.flight_path_angle,
        states.downrange,
        controls,
    )


@needs_float64
def as_longitudinal(
    flight: ReferenceFlight, parts: int = 20, degree: int = 10
) -> LongitudinalReference:
    """A flight in the vertical plane as a reference over the time since its start.

    The reference ends with the last whole interval of the flight.

    **Arguments:**

    - `flight`: flight with a law without memory, whose commands are followed without delay.
    - `parts`: number of pieces of equal duration.
    - `degree`: degree of the polynomials over the time in each piece.
    """
    scenario = flight.scenario
    planet, origin = scenario.planet, scenario.initial_state
    memory = no_memory(scenario, flight.interval)

    def quantities(time: Scalar, state: EntryState) -> dict[str, Scalar]:
        controls, _ = command(scenario, time, Moving(state, None, memory), None)
        air = air_data(planet, scenario.vehicle, state, controls.angle_of_attack)
        return {
            "altitude": state.altitude,
            "velocity": state.velocity,
            "flight_path_angle": state.flight_path_angle,
            "downrange": ground_track(planet, origin, state)[0],
            "lift_to_drag_up": controls.cos_bank * air.lift / air.drag,
        }

    table = flight.tabulate(quantities, TimeIndex(), 4000)
    last = table.start + 4000 * table.spacing
    ends = jnp.linspace(table.start, last, parts + 1)
    shares = 0.5 * (1.0 + jnp.asarray(legendre_gauss_lobatto(degree).nodes))
    times = ends[:-1, None] + jnp.outer(jnp.diff(ends), shares)
    read = jax.vmap(jax.vmap(table.with_derivatives))(times)
    columns = {name: jnp.asarray(values[0]) for name, values in read.items()}
    return LongitudinalReference(ends, **columns)
