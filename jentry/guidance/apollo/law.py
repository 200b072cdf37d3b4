"""The entry guidance of Apollo, in five phases with or without a skip."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._math import safe_sqrt, sincos
from ...fields import Flag, Scalar, scalar
from ...motion.quantities import arc_to, direction_to, from_ground_track, ground_track
from ...motion.state import Controls
from ...onboard.inertial import local_velocity, with_velocity
from ...onboard.measurement import Measurement
from ...onboard.model import require_still_air
from ...units import degree, foot
from ..aim import Aim, TargetOfScenario, known
from ..cycle import FixedCycle
from ..lateral import Destination, predicted_crossrange, turned
from ..law import AbstractSampledLaw
from ..open_loop import vertical_lift_command
from ..terminal_point import HeldBank, TerminalPoint
from .phases import ConstantDrag, DecelerationLimit, InitialRoll, Seen, UpControl
from .search import FOUND, SLOW, Search, searched
from .skip import SkipPrediction


WAITING, INITIAL_ROLL, CONSTANT_DRAG, UP_CONTROL, BALLISTIC, FINAL = map(
    float, range(6)
)
"""Phases in their order: before the first drag, and the five phases of the guidance"""

_PASSES = 3
"""Passes for the range to a target that moves while it is flown. The error falls to a
fourteenth in each"""


class HeldPhase(eqx.Module):
    """Decision of `ApolloEntry` at a guidance cycle."""

    phase: Scalar
    """Position in `PHASES`"""
    lift_to_drag: Scalar
    """Commanded upward lift-to-drag ratio before its limits, in the upper phases"""
    bank: HeldBank
    search: Search
    ending_drag: Scalar
    """Drag that ends the initial roll, m/s2"""
    constant_drag: Scalar
    """Drag of the constant-drag phase, m/s2"""
    gain: Scalar
    """Factor on the feedback of the up-control"""


PHASES = "waiting", "initial roll", "constant drag", "up-control", "ballistic", "final"
"""Names of the phases, in their order"""


class ApolloEntry(AbstractSampledLaw[tuple[()], HeldPhase]):
    """Entry guidance of the Apollo command module, with and without a skip.

    The phases come in this order, and any of the middle ones may be left out:

    - Before the first drag the lift is up.
    - Initial roll: lift up, or down for a shallow entry, until the drag is large enough.
    - Constant drag: holds a drag. When the altitude rate is small enough, the range of a
      skip is predicted in closed form. The search changes the upward lift-to-drag ratio of
      the skip until it has the range to go. While all skips are too long, the drag is held
      and takes velocity.
    - Up-control: follows velocity and altitude rate of the skip over the drag to its exit.
    - Ballistic: holds the bank, or the lift up below the first drag.
    - Final phase: `final`, to the target. It follows at once if the vehicle is too slow
      for a skip, or descends again before it leaves the air.

    Bank and upward lift are related by the largest lift-to-drag ratio that is counted on,
    and not by the sensed one. The side is that of the lateral logic of `final`. In the
    program this is a `CrossrangeCorridor` that widens with the square of the velocity.
    Near full lift, up or down, the upper phases keep the `smallest_bank` of `final` towards
    the target, which is 15 degrees in the program, and away from it the corridor has the
    `narrowing` of `final`, which is one half. The specific force is sensed at the instant
    of a decision. The program has its mean over the last cycle, and extrapolates it over
    half a cycle to the same instant.

    The upper phases are those of an inertial velocity, and of the place to which the
    rotation of the planet carries the target until the end. The final phase here is
    relative to the planet, with its own reference. In the program it is inertial down to
    half the circular velocity.

    Sources: the flight program of Apollo 11, Comanche 055, 1969, REENTRY_CONTROL, which
    also has the constants; D. J. Morth, "Reentry Guidance for Apollo", MIT R-532, 1966; P.
    E. Moseley, "The Apollo Entry Guidance: A Review of the Mathematical Development and Its
    Operational Characteristics", TRW, 1969.

    Not included: the first side by the place of the target, full lift down behind the
    target (the final phase commands it by its range error), and displays, scaling and
    attitude. Our own: the limit of the last bank, and that a vehicle slower
    than `slow_exit` of `constant_drag` searches at any altitude rate, so that it comes to
    the final phase.
    """

    final: TerminalPoint
    """Law of the final phase, with the planet on board and the lateral logic"""
    prediction: SkipPrediction = eqx.field(default_factory=SkipPrediction)
    initial_roll: InitialRoll = eqx.field(default_factory=InitialRoll)
    constant_drag: ConstantDrag = eqx.field(default_factory=ConstantDrag)
    up_control: UpControl = eqx.field(default_factory=UpControl)
    deceleration_limit: DecelerationLimit | None = eqx.field(
        default_factory=DecelerationLimit
    )
    """Limit in the final phase; None for no limit"""
    reentry_drag: Scalar = scalar(6.5 * foot, unit="m/s2", positive=True)
    """Drag that ends the ballistic phase (Q7F + KDMIN)"""
    seconds_per_range: Scalar = scalar(1000.0, unit="s", positive=True)
    """Time to go per rad of range to go, in which the planet carries the target"""
    last_velocity: Scalar = scalar(1000.0 * foot, unit="m/s", positive=True)
    """Velocity relative to the planet below which the bank is held (VQUIT)"""
    largest_last_bank: Scalar = scalar(75.0 * degree, unit="rad", range=(0.0, math.pi))
    """Largest bank below that velocity; our own. With a larger one a capsule may fall
    vertically, where its state has no heading"""
    steers_to_the_end: bool = eqx.field(default=False, static=True)
    """Whether the final phase also commands the bank below `last_velocity`, which is our
    own. The limit of the bank applies in both cases"""
    trials: int = eqx.field(default=6, static=True)
    """Largest number of skips that are tried in a guidance cycle"""
    cycle: FixedCycle = FixedCycle(2.0)
    aim: Aim | TargetOfScenario = TargetOfScenario()

    def __check_init__(self):
        if self.trials < 1:
            raise ValueError(f"trials is {self.trials}: it must be 1 or more")
        if self.final.cycle.period != self.cycle.period:
            raise ValueError(
                f"the guidance cycle is {self.cycle.period} s, and that of final "
                f"{self.final.cycle.period} s: the final phase decides with the other "
                "phases, so give both the same cycle"
            )

    def init(self, measurement: Measurement) -> tuple[tuple[()], HeldPhase]:
        nothing = 0.0 * measurement.drag
        one = nothing + 1.0
        side = self.final.lateral.init(measurement)
        return (), HeldPhase(
            phase=nothing + WAITING,
            lift_to_drag=self.prediction.lift_to_drag + nothing,
            bank=HeldBank(one, nothing, side),
            search=Search.start(self.constant_drag, nothing),
            ending_drag=self.initial_roll.largest_held_drag + nothing,
            constant_drag=self.initial_roll.constant_drag + nothing,
            gain=one,
        )

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: tuple[()],
        held: HeldPhase,
    ) -> tuple[tuple[()], HeldPhase]:
        require_still_air(self.final.planet, "the entry guidance of Apollo")
        seen, inertial, destination = self.seen(measurement)
        held = self._rolled(seen, held)
        held = self._searched(seen, held)
        held = self._climbed(seen, held)
        upper = self._banked(time, measurement, inertial, destination, seen, held)
        _, final = self.final.update(time, measurement, (), held.bank)
        bank = _chosen(
            held.phase == FINAL, self._last(measurement, seen, held, final), upper
        )
        return (), dataclasses.replace(held, bank=bank)

    def seen(self, measurement: Measurement) -> tuple[Seen, Measurement, Destination]:
        """Motion, measurement and destination in the frame that does not rotate."""
        aim, planet, state = known(self.aim), self.final.planet, measurement.state
        east, north, up = local_velocity(state)
        _, cos_latitude = sincos(state.latitude)
        carried = planet.rotation_rate * (planet.radius + state.altitude) * cos_latitude
        inertial = with_velocity(state, east + carried, north, up)
        longitude, latitude = from_ground_track(
            planet, aim.origin, aim.downrange, aim.crossrange
        )

        def at_end(range_to_go: Scalar) -> Scalar:
            seconds = self.seconds_per_range * range_to_go
            return longitude + planet.rotation_rate * seconds

        range_to_go = jnp.zeros_like(longitude)
        for _ in range(_PASSES):
            to = direction_to(at_end(range_to_go), latitude, state)
            range_to_go = arc_to(*to)
        there = dataclasses.replace(
            aim.origin, longitude=at_end(range_to_go), latitude=latitude
        )
        force = safe_sqrt(measurement.lift**2 + measurement.drag**2)
        seen = Seen(inertial.velocity, up, force, range_to_go)
        place = ground_track(planet, aim.origin, there)
        destination = Destination(planet, aim.origin, *place)
        return seen, dataclasses.replace(measurement, state=inertial), destination

    def _rolled(self, seen: Seen, held: HeldPhase) -> HeldPhase:
        """Decisions at the first drag, and the end of the initial roll."""
        roll, prediction = self.initial_roll, self.prediction
        starts = (held.phase == WAITING) & (seen.drag > roll.first_drag)
        slow = seen.velocity < roll.slow_velocity
        dives = roll.is_shallow(seen) & jnp.logical_not(slow)
        excess = seen.excess(prediction)
        first = dataclasses.replace(
            held,
            phase=jnp.where(slow, BALLISTIC, INITIAL_ROLL),
            lift_to_drag=jnp.where(dives, -1.0, 1.0) * prediction.lift_to_drag,
            ending_drag=roll.ending_drag(excess),
            constant_drag=jnp.maximum(roll.drag_after(excess), roll.first_drag),
        )
        held = _chosen(starts, first, held)
        control = self.constant_drag
        late = (seen.rate > control.search_rate) | (seen.velocity < control.slow_exit)
        late &= jnp.logical_not(starts)  # as in the program
        ends = (held.phase == INITIAL_ROLL) & (late | (seen.drag > held.ending_drag))
        phase = jnp.where(ends, CONSTANT_DRAG, held.phase)
        searches = (phase == CONSTANT_DRAG) & late
        started = jnp.where(searches, 1.0, held.search.started)
        search = dataclasses.replace(held.search, started=started)
        return dataclasses.replace(held, phase=phase, search=search)

    def _searched(self, seen: Seen, held: HeldPhase) -> HeldPhase:
        """Constant drag, and the search for a skip."""
        down = held.lift_to_drag < 0.0
        lower = jnp.where(down, self.constant_drag.lowering, 0.0)

        active = (held.phase == CONSTANT_DRAG) & (held.search.started > 0.0)
        found = searched(
            self.constant_drag, self.prediction, seen, held.search, lower, self.trials
        )
        search = _chosen(active, found, held.search)
        phase = jnp.where(active & (search.end == FOUND), UP_CONTROL, held.phase)
        phase = jnp.where(active & (search.end == SLOW), FINAL, phase)
        holding = self.constant_drag.holding(self.prediction, seen, held.constant_drag)
        holding = self.up_control.without_dive(seen.drag, holding)
        lift = jnp.where(phase == CONSTANT_DRAG, holding, held.lift_to_drag)
        return dataclasses.replace(held, phase=phase, lift_to_drag=lift, search=search)

    def _climbed(self, seen: Seen, held: HeldPhase) -> HeldPhase:
        """Up-control, and the ends of it and of the ballistic phase."""
        control, plan, prediction = self.up_control, held.search.plan, self.prediction
        climbs = held.phase == UP_CONTROL
        descends = climbs & (seen.velocity >= plan.pull_out_velocity)
        follows = climbs & jnp.logical_not(descends)
        leaves = follows & (seen.drag < plan.exit_drag)
        slow = seen.velocity < plan.exit_velocity + control.early_velocity
        falls = follows & (seen.rate < 0.0) & slow
        phase = jnp.where(leaves, BALLISTIC, jnp.where(falls, FINAL, held.phase))
        enters = (phase == BALLISTIC) & (seen.drag > self.reentry_drag)
        phase = jnp.where(enters, FINAL, phase)

        gain = control.gain(plan, seen.drag, held.gain)
        gain = jnp.where(follows, gain, held.gain)
        lift = jnp.where(
            descends,
            self.constant_drag.pulling_out(prediction, plan, seen),
            control.climbing(prediction, plan, seen, gain),
        )
        lift = control.without_dive(seen.drag, lift)
        lift = jnp.where(phase == UP_CONTROL, lift, held.lift_to_drag)
        return dataclasses.replace(held, phase=phase, lift_to_drag=lift, gain=gain)

    def _banked(
        self,
        time: Scalar,
        measurement: Measurement,
        inertial: Measurement,
        destination: Destination,
        seen: Seen,
        held: HeldPhase,
    ) -> HeldBank:
        """Bank of the upper phases."""
        phase, before, final = held.phase, held.bank, self.final
        steers = (phase != WAITING) & (phase != BALLISTIC)
        dense = seen.drag > self.up_control.no_reversal_drag
        reversible = steers & jnp.logical_not((phase == UP_CONTROL) & dense)
        cosine = jnp.clip(held.lift_to_drag / self.prediction.lift_to_drag, -1.0, 1.0)
        most = jnp.cos(final.smallest_bank)
        lateral = final.corridor(jnp.abs(cosine) >= most)
        decided = lateral.update(time, inertial, before.side, destination)
        side = _chosen(reversible, decided, before.side)
        sign = lateral.sign(side)

        planet, state = final.planet, inertial.state
        flown, _ = ground_track(planet, destination.origin, state)
        passing = predicted_crossrange(
            planet, destination.origin, state, destination.downrange - flown
        )
        # A miss to the left, which is positive, needs a bank to the right. A new side turns
        # from the next cycle on.
        miss = passing - destination.crossrange
        turns = steers & (lateral.sign(before.side) * miss > 0.0)
        cosine = jnp.where(turns, jnp.clip(cosine, -most, most), cosine)
        controls = turned(vertical_lift_command(cosine, 0.0 * cosine), sign)
        bank = HeldBank(controls.cos_bank, controls.sin_bank, side)
        # In thin air the lift is up; otherwise the ballistic phase holds the bank.
        one = jnp.ones_like(cosine)
        level = HeldBank(one, 0.0 * one, before.side)
        coasting = _chosen(seen.drag < self.initial_roll.first_drag, level, before)
        return _chosen(phase == BALLISTIC, coasting, bank)

    def _last(
        self, measurement: Measurement, seen: Seen, held: HeldPhase, final: HeldBank
    ) -> HeldBank:
        """Bank of the final phase."""
        if self.deceleration_limit is not None:
            lifts = self.deceleration_limit.needs_lift(self.prediction, seen)
            one = jnp.ones_like(final.cos_bank)
            final = _chosen(lifts, HeldBank(one, 0.0 * one, final.side), final)
        slow = measurement.state.velocity < self.last_velocity
        last = final if self.steers_to_the_end else held.bank
        sine, cosine = sincos(self.largest_last_bank)
        sine = jnp.where(last.sin_bank < 0.0, -sine, sine)
        limit = HeldBank(cosine, sine, last.side)
        last = _chosen(last.cos_bank < cosine, limit, last)
        return _chosen(slow, last, final)

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: tuple[()],
        held: HeldPhase,
    ) -> tuple[Controls, tuple[()]]:
        return self.final(time, measurement, memory, held.bank)


def _chosen(condition: Flag, chosen, otherwise):
    """One of two pytrees of numbers."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, otherwise)
