"""Linear-quadratic tracking of a flight in the vertical plane, over the time to go.

Legendre pseudospectral collocation solves the regulator, either once for stored gains or
repeatedly in flight for the remaining horizon.

Reference: D.-W. Lee, K.-R. Cho, H. Yan, "Re-Entry Trajectory Tracking Via an Inverse
Dynamics Method", KSME International Journal 18(9), 2004, section 4.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from .._collocation import interpolate
from .._interpolation import interval
from ..fields import NOT_NEGATIVE, Scalar, Vector, optional_scalar, scalar, table
from ..motion.state import Controls, EntryState
from ..onboard.linear_quadratic import Plan, Weights, collocated_plans
from ..onboard.longitudinal import (
    LongitudinalModel,
    LongitudinalReference,
    LongitudinalState,
    Units,
    linearized,
    on_nodes,
)
from ..onboard.measurement import Measurement
from .aim import Aim, TargetOfScenario, known
from .cycle import FixedCycle
from .lateral import AbstractLateralLogic, FixedSide, turned
from .law import AbstractBankLaw, AbstractSampledLaw
from .open_loop import vertical_lift_command


class DeviationWeights(eqx.Module):
    """Costs of squared deviations, without dimensions: the diagonal of Q, or of P_f.

    Altitude and downrange are in units of the planet's radius, the velocity in units of the
    circular velocity at the surface, the flight-path angle in rad.
    """

    altitude: Scalar = scalar(1.0, range=NOT_NEGATIVE)
    velocity: Scalar = scalar(1.0, range=NOT_NEGATIVE)
    flight_path_angle: Scalar = scalar(1.0, range=NOT_NEGATIVE)
    downrange: Scalar | None = optional_scalar(range=NOT_NEGATIVE)
    """None for a regulator that does not control the downrange, as in the paper"""

    @property
    def diagonal(self) -> Vector:
        """Shape (3,), or (4,) with the downrange."""
        weights = self.altitude, self.velocity, self.flight_path_angle
        if self.downrange is not None:
            weights = *weights, self.downrange
        return jnp.stack(weights)


class Regulator(eqx.Module):
    """Linear-quadratic regulation of a flight about its reference, over the time to go.

    The cost is (26). The unit of time is that in which a circular orbit at the surface
    covers one radian.
    """

    model: LongitudinalModel
    reference: LongitudinalReference
    underway: DeviationWeights = eqx.field(default_factory=DeviationWeights)
    """Q"""
    at_end: DeviationWeights = eqx.field(
        default_factory=lambda: DeviationWeights(300.0, 300.0, 300.0)
    )
    """P_f"""
    control: Scalar = scalar(1.0, positive=True)
    """R: weight of the lift-to-drag ratio"""
    aim: Aim | TargetOfScenario | None = None
    """Aim from whose origin the downrange is counted: `TargetOfScenario()` if the downrange
    has weights, None if it has none"""
    degree: int = eqx.field(default=10, static=True)
    """Degree of the polynomials in each part of the reference"""

    def __check_init__(self):
        weighed = self.underway.downrange is not None
        if weighed != (self.at_end.downrange is not None):
            raise ValueError(
                "downrange has a weight in one of underway and at_end, and None in the "
                "other: give both, or neither"
            )
        if weighed != (self.aim is not None):
            raise ValueError(
                "aim=TargetOfScenario() says from where the downrange is counted: give it "
                "where downrange has weights, and only there"
            )
        if self.degree < 1:
            raise ValueError(f"degree is {self.degree}: it must be 1 or more")

    @property
    def weights(self) -> Weights:
        """The weights as matrices."""
        return Weights(
            jnp.diag(self.underway.diagonal),
            jnp.reshape(self.control, (1, 1)),
            jnp.diag(self.at_end.diagonal),
        )

    @property
    def units(self) -> Units:
        return Units.of(self.model.onboard.planet)

    def system(self, part: Any, time: Scalar) -> tuple[Array, Array]:
        """A and B of (24) in a part of the reference, at a time, without dimensions."""
        n = self.underway.diagonal.shape[0]
        here = self.reference.in_part(part, time * self.units.time)
        a, b = linearized(self.model, here.state, here.lift_to_drag_up)
        return a[:n, :n], b[:n]

    def ends(self, time: Scalar | float = 0.0) -> Vector:
        """Ends of the parts that remain at a time (s), without dimensions. Parts that are
        past have zero length."""
        return jnp.maximum(self.reference.ends, time) / self.units.time

    def plans(self, time: Scalar | float) -> Plan:
        """The optimal motion in each part that remains at a time, s."""
        return collocated_plans(self.system, self.weights, self.ends(time), self.degree)

    def deviation(self, time: Scalar, state: EntryState) -> Vector:
        """Deviation from the reference at a time (s), without dimensions."""
        n = self.underway.diagonal.shape[0]
        origin = None if self.aim is None else known(self.aim).origin
        here = LongitudinalState.of(self.model.onboard.planet, state, origin)
        units, there = self.units, self.reference.at(time).state
        return (units.vector(here) - units.vector(there))[:n]

    def commanded(
        self, time: Scalar, measurement: Measurement, change: Scalar
    ) -> Controls:
        """Bank to the right for a change of the reference lift-to-drag ratio."""
        wanted = self.reference.at(time).lift_to_drag_up + change
        angle = measurement.trim_angle_of_attack
        there = self.model.onboard.lift_to_drag(measurement.state, angle)
        return vertical_lift_command(wanted / there, angle)


class GainSchedule(eqx.Module):
    """Gains of the lift-to-drag ratio on deviations without dimensions, over the time."""

    ends: Vector = table(unit="s", increasing=True)
    """Ends of the parts, shape (parts + 1,)"""
    gains: Float[Array, "parts nodes states"] = table()
    """K at the Legendre-Gauss-Lobatto nodes of each part"""

    def at(self, time: Scalar) -> Vector:
        """K, shape (states,), at a time in s."""
        part = interval(self.ends, time)
        x = on_nodes(self.ends[part], self.ends[part + 1], time)
        return jnp.asarray(jax.vmap(interpolate, (1, None))(self.gains[part], x))


_SPLIT = 8
"""Number of parts into which each part of the reference is split for its gains"""
_HALVINGS = 16
"""Number of times that the last of these parts is halved"""


def plan_gains(regulator: Regulator) -> GainSchedule:
    """Gains at all times, by one collocation of the whole flight.

    K is M W_2 over W_1 of (57) and (58), for any deviation at the start of a part. Being a
    quotient, it has larger curvature than W_1 and W_2, so each part of the reference is
    split. With large final weights K also grows with one over the time to go, so the last
    part is halved repeatedly. The gains are differentiable in the weights.
    """
    reference = regulator.reference
    starts, end = reference.ends[:-1], reference.ends[-1]
    shares = jnp.arange(_SPLIT) / _SPLIT
    split = (starts[:, None] + jnp.outer(jnp.diff(reference.ends), shares)).ravel()
    last = end - (end - split[-1]) * 0.5 ** jnp.arange(1.0, _HALVINGS + 1.0)
    ends = jnp.concatenate([split, last, end[None]])
    within = jnp.minimum(jnp.arange(ends.shape[0] - 1) // _SPLIT, starts.shape[0] - 1)
    plans = collocated_plans(
        lambda part, time: regulator.system(within[part], time),
        regulator.weights,
        ends / regulator.units.time,
        regulator.degree,
    )
    turned = jnp.swapaxes(plans.states, 2, 3), jnp.swapaxes(plans.controls, 2, 3)
    return GainSchedule(ends, -jnp.linalg.solve(*turned)[..., 0])


class StoredGainTracking(AbstractBankLaw[None]):
    """The regulator with gains that are computed before the flight.

    The lift-to-drag ratio is u*(t) - K(t) (x - x*(t)), with the time as index.
    """

    regulator: Regulator
    gains: GainSchedule
    """Gains from `plan_gains`"""
    lateral: AbstractLateralLogic = FixedSide()

    def __check_init__(self):
        states = self.regulator.underway.diagonal.shape[0]
        if self.gains.gains.shape[-1] != states:
            raise ValueError(
                f"gains has {self.gains.gains.shape[-1]} for each time, and the "
                f"regulator {states} deviations: take plan_gains(regulator)"
            )

    def init(self, measurement: Measurement) -> None:
        return None

    def to_the_right(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[Controls, None]:
        deviation = self.regulator.deviation(time, measurement.state)
        change = -jnp.sum(self.gains.at(time) * deviation)
        return self.regulator.commanded(time, measurement, change), None


class ControlPlan(eqx.Module):
    """Changes of the lift-to-drag ratio for the rest of the flight."""

    ends: Vector
    """Ends of the remaining parts, s, shape (parts + 1,)"""
    changes: Float[Array, "parts nodes"]
    """Changes at the Legendre-Gauss-Lobatto nodes"""

    def at(self, time: Scalar) -> Scalar:
        """Change of the lift-to-drag ratio at a time, s."""
        part = interval(self.ends, time)
        x = on_nodes(self.ends[part], self.ends[part + 1], time)
        return interpolate(self.changes[part], x)


class PseudospectralTracking(AbstractSampledLaw[None, ControlPlan]):
    """The regulator, solved in flight at each guidance cycle for the remaining horizon.

    From the measured deviation the law computes the optimal changes of the control for the
    rest of the flight, with one linear system in each part of the reference. These changes
    are applied, without feedback, until the next cycle.
    """

    regulator: Regulator
    cycle: FixedCycle = FixedCycle(10.0)
    lateral: FixedSide = FixedSide()

    def init(self, measurement: Measurement) -> tuple[None, ControlPlan]:
        reference = self.regulator.reference
        shape = reference.ends.shape[0] - 1, self.regulator.degree + 1
        nothing = 0.0 * measurement.drag
        return None, ControlPlan(reference.ends + nothing, jnp.zeros(shape) + nothing)

    def update(
        self, time: Scalar, measurement: Measurement, memory: None, held: ControlPlan
    ) -> tuple[None, ControlPlan]:
        regulator = self.regulator
        plans = regulator.plans(time)

        def onward(deviation: Vector, part: Plan) -> tuple[Vector, Array]:
            return part.states[-1] @ deviation, part.controls[:, 0] @ deviation

        deviation = regulator.deviation(time, measurement.state)
        _, changes = lax.scan(onward, deviation, plans)
        ends = jnp.maximum(regulator.reference.ends, time)
        return None, ControlPlan(ends, changes)

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: None, held: ControlPlan
    ) -> tuple[Controls, None]:
        controls = self.regulator.commanded(time, measurement, held.at(time))
        return turned(controls, self.lateral.sign(None)), None
