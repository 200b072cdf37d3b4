"""Tracking of a ground track over the energy, with angle of attack and bank.

Reference: S. Bharadwaj, A. V. Rao, K. D. Mease, "Entry Trajectory Tracking Law via
Feedback Linearization", Journal of Guidance, Control, and Dynamics 21(5), 1998. The code
uses the symbols of the paper where it implements an equation. In the paper the heading is
counted from east to the left and the bank is positive to the left. Here both are positive
to the right.
"""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._apart import apart
from .._math import sincos
from ..fields import Scalar, scalar
from ..motion.dynamics import rates_under
from ..motion.quantities import energy, ground_track
from ..motion.state import Controls, EntryState
from ..onboard.estimation import Factors
from ..onboard.measurement import Measurement, measure
from ..onboard.model import OnboardModel, require_sphere, require_still_air
from ..onboard.profiles import AbstractProfile, QuinticTable
from ..world.planet import Planet
from .law import AbstractContinuousLaw, Tracked
from .lift_tradeoff import AbstractTradeoff, EqualTradeoff, LiftBounds
from .tracking_gains import AbstractTrackingGains


class AbstractTrackAngles(eqx.Module):
    """The two angles that locate a vehicle on the sphere: the outputs y1 and y2."""

    @abstractmethod
    def angles(self, planet: Planet, state: EntryState) -> tuple[Scalar, Scalar]:
        """Downrange and crossrange angle, rad; crossrange is positive to the left."""


class EarthFixedAngles(AbstractTrackAngles):
    """Longitude and latitude: for flights along the equator to the east."""

    def angles(self, planet: Planet, state: EntryState) -> tuple[Scalar, Scalar]:
        return state.longitude, state.latitude


class ReferencePlaneAngles(AbstractTrackAngles):
    """Angles along and across the great circle through an origin in its heading."""

    origin: EntryState

    def angles(self, planet: Planet, state: EntryState) -> tuple[Scalar, Scalar]:
        downrange, crossrange = ground_track(planet, self.origin, state)
        return downrange / planet.radius, crossrange / planet.radius


class AttitudeBand(eqx.Module):
    """Limits of the command."""

    deviation: Scalar = scalar(unit="rad", positive=True)
    """Largest deviation of the angle of attack from the reference, to either side"""
    least: Scalar = scalar(unit="rad")
    """Smallest angle of attack"""
    largest: Scalar = scalar(unit="rad")
    """Largest angle of attack"""
    largest_bank: Scalar = scalar(unit="rad", range=(0.0, np.pi))
    """Largest bank to either side"""


class GroundTrackModel(eqx.Module):
    """The onboard motion over the energy, with its outputs, which the law differentiates.

    Energy is in units of `energy_span`, so that the numbers are of order one. The drag is
    that at the reference angle of attack, equation (36): the bank controls the drag, not
    the angle of attack.
    """

    onboard: OnboardModel
    angle_of_attack: AbstractProfile
    """Reference angle of attack (rad) over the energy (J/kg)"""
    bank: AbstractProfile
    """Reference bank (rad, positive to the right) over the energy (J/kg)"""
    energy_span: Scalar = scalar(unit="J/kg", positive=True)
    """Fall of the energy from the start to the end of the reference"""
    track_angles: AbstractTrackAngles = EarthFixedAngles()

    def energy(self, state: EntryState) -> Scalar:
        """Energy per unit mass, J/kg."""
        return energy(self.onboard.planet, state)

    def outputs(self, state: EntryState) -> tuple[Scalar, Scalar]:
        """Downrange and crossrange angle, rad."""
        return self.track_angles.angles(self.onboard.planet, state)

    def forces(
        self, state: EntryState, angle_of_attack: Scalar, factors: Factors
    ) -> tuple[Scalar, Scalar]:
        """Modelled specific lift and drag (m/s2), multiplied by the factors."""
        air = measure(self.onboard.planet, self.onboard.vehicle, state, angle_of_attack)
        return factors.lift * air.lift, factors.drag * air.drag

    @eqx.filter_jit
    def reference_forces(
        self, state: EntryState, factors: Factors
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Lift upwards and to the right, and drag, under the reference controls; m/s2."""
        require_still_air(self.onboard.planet, "the law of the ground track")
        here = self.energy(state)
        lift, drag = self.forces(state, self.angle_of_attack(here), factors)
        sine, cosine = sincos(self.bank(here))
        return lift * cosine, lift * sine, drag

    @eqx.filter_jit
    def over_energy(
        self,
        state: EntryState,
        drag: Scalar,
        above: Scalar | None = None,
        right: Scalar | None = None,
    ) -> EntryState:
        """Rates over the energy, equations (10) to (15), under specified forces (m/s2)."""
        rates = rates_under(self.onboard.planet, state, -drag, above, right)
        per_rate = -self.energy_span / (state.velocity * drag)
        return jax.tree.map(lambda x: x * per_rate, rates)


class OutputDynamics(eqx.Module):
    """The outputs and their derivatives over the energy, in units of its span.

    y1''' = drift[0] + effect[0] . lift and y2'' = drift[1] + effect[1] . lift. The
    components of the lift are upwards and to the right.
    """

    downrange: tuple[Scalar, Scalar, Scalar]
    """y1, y1' and y1'', rad"""
    crossrange: tuple[Scalar, Scalar]
    """y2 and y2', rad"""
    drift: tuple[Scalar, Scalar]
    effect: tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]
    """rad per m/s2"""

    def under(self, above: Scalar, right: Scalar) -> tuple[Scalar, Scalar]:
        """y1''' and y2'' under a lift, m/s2."""
        (b1, b2), (m1, m2) = self.effect
        a, l = self.drift
        return a + b1 * above + b2 * right, l + m1 * above + m2 * right

    def lift_for(self, third: Scalar, second: Scalar) -> tuple[Scalar, Scalar]:
        """The lift upwards and to the right (m/s2) that gives y1''' and y2''."""
        (b1, b2), (m1, m2) = self.effect
        w1, w2 = third - self.drift[0], second - self.drift[1]
        per_determinant = 1.0 / (b1 * m2 - b2 * m1)
        return (m2 * w1 - b2 * w2) * per_determinant, (
            b1 * w2 - m1 * w1
        ) * per_determinant


class AbstractLinearization(eqx.Module):
    """Method that differentiates the outputs until the controls appear."""

    @abstractmethod
    def dynamics(
        self, model: GroundTrackModel, state: EntryState, factors: Factors
    ) -> OutputDynamics:
        """The outputs in a state, and the effect of the lift on them."""


class FullLinearization(AbstractLinearization):
    """Exact linearization, by nested forward derivatives of equations (10) to (15).

    In y1'' the lift appears too early, through the sines of flight-path angle and heading.
    There the lift of the reference controls is used.
    """

    @apart
    def dynamics(
        self, model: GroundTrackModel, state: EntryState, factors: Factors
    ) -> OutputDynamics:
        def slopes(state: EntryState):
            _, _, drag = model.reference_forces(state, factors)
            free = model.over_energy(state, drag)
            angles, slopes = jax.jvp(model.outputs, (state,), (free,))
            return slopes, angles

        def curved(state: EntryState):
            above, right, drag = model.reference_forces(state, factors)
            flow = model.over_energy(state, drag, above, right)
            (s1, s2), (q, _), angles = jax.jvp(slopes, (state,), (flow,), has_aux=True)
            return (q, s2), (s1, angles)

        (q, s2), further, (s1, angles) = jax.linearize(curved, state, has_aux=True)
        _, _, drag = model.reference_forces(state, factors)
        per_rate = -model.energy_span / (state.velocity * drag)
        turn = per_rate / state.velocity
        _, cos_path = sincos(state.flight_path_angle)
        still = jax.tree.map(jnp.zeros_like, state)
        up = eqx.tree_at(lambda s: s.flight_path_angle, still, turn)
        aside = eqx.tree_at(lambda s: s.heading, still, turn / cos_path)
        drift = further(model.over_energy(state, drag))
        by_lift = further(up), further(aside)
        return OutputDynamics(
            downrange=(angles[0], s1, q),
            crossrange=(angles[1], s2),
            drift=drift,
            effect=(
                (by_lift[0][0], by_lift[1][0]),
                (by_lift[0][1], by_lift[1][1]),
            ),
        )


class SmallAngleLinearization(AbstractLinearization):
    """Small flight-path, crossrange and heading angles: equations (37) to (44).

    a of (43) is corrected: it misses 2 gamma (D + 2 g gamma) / (D^3 V^2 r^2). The drag
    coefficient is constant along the reference angle of attack, as printed.
    """

    @apart
    def dynamics(
        self, model: GroundTrackModel, state: EntryState, factors: Factors
    ) -> OutputDynamics:
        planet, span = model.onboard.planet, model.energy_span
        require_sphere(planet, "the linearization for small angles")
        _, _, D = model.reference_forces(state, factors)
        theta, phi = model.outputs(state)
        V, gamma, chi = state.velocity, state.flight_path_angle, _course(model, state)
        r = planet.radius + state.altitude
        g = planet.gravity.acceleration(r)
        H = model.onboard.scale_height(state)

        K = 1.0 / H - 1.0 / r + 2.0 * g / V**2
        D_rate = gamma / H + 2.0 * D / V**2 + 2.0 * g * gamma / V**2  # (44)
        first = -1.0 / (D * r)  # (37)
        second = gamma * K / (D**2 * r) + 2.0 / (D * V**2 * r)  # (39)
        b = -K / (D**3 * V**2 * r)  # (43)
        a = (  # (43), corrected
            -b * (g - V**2 / r)
            - gamma**2 / (D**3 * r**3)
            - 4.0 * (D + g * gamma) ** 2 / (D**3 * V**4 * r)
            - 2.0 * D_rate / (D**2 * V**2 * r)
            + K * (gamma**2 / (D**3 * r**2) - 2.0 * D_rate * gamma / (D**3 * r))
            + 2.0 * gamma * (D + 2.0 * g * gamma) / (D**3 * V**2 * r**2)
        )
        m = 1.0 / (D**2 * V**2 * r)  # (41)
        l = (  # (41)
            gamma * chi * K / (D**2 * r)
            + 2.0 * chi / (D * V**2 * r)
            - phi / (D**2 * r**2)
        )
        nothing = jnp.zeros_like(D)
        return OutputDynamics(
            downrange=(theta, span * first, span**2 * second),
            crossrange=(phi, -span * chi / (D * r)),  # (38)
            drift=(span**3 * a, span**2 * l),
            effect=((span**3 * b, nothing), (nothing, -(span**2) * m)),
        )


def _course(model: GroundTrackModel, state: EntryState) -> Scalar:
    """Direction of the velocity in the frame of the outputs: chi, rad, to the left."""
    sin_heading, cos_heading = sincos(state.heading)
    _, cos_latitude = sincos(state.latitude)
    over_ground = eqx.tree_at(
        lambda s: (s.longitude, s.latitude),
        jax.tree.map(jnp.zeros_like, state),
        (sin_heading / cos_latitude, cos_heading),
    )
    (_, phi), (along, across) = jax.jvp(model.outputs, (state,), (over_ground,))
    return jnp.arctan2(across, along * jnp.cos(phi))


class AbstractForceKnowledge(eqx.Module):
    """How the law obtains the actual lift and drag, in units of those of its model."""

    @abstractmethod
    def factors(self, model: GroundTrackModel, measurement: Measurement) -> Factors:
        """Factors on lift and drag."""


class ModelledForces(AbstractForceKnowledge):
    """Lift and drag of the model, with factors of one."""

    def factors(self, model: GroundTrackModel, measurement: Measurement) -> Factors:
        one = jnp.ones_like(measurement.drag)
        return Factors(one, one)


class MeasuredForces(AbstractForceKnowledge):
    """Ratio of the sensed force to that of the model at the actual angle of attack.

    The command then depends on forces that depend on the command. Use `Sampled(law,
    period)`, or an attitude response with a lag.
    """

    def factors(self, model: GroundTrackModel, measurement: Measurement) -> Factors:
        nominal = ModelledForces().factors(model, measurement)
        angle = measurement.angle_of_attack
        lift, drag = model.forces(measurement.state, angle, nominal)
        return Factors(measurement.lift / lift, measurement.drag / drag)


class TrackErrors(eqx.Module):
    """Integrals of the errors over the energy in units of its span, or their rates."""

    downrange: Scalar
    """rad"""
    crossrange: Scalar
    """rad"""


_COLUMNS = (
    "downrange",
    "downrange_first",
    "downrange_second",
    "downrange_third",
    "crossrange",
    "crossrange_first",
    "crossrange_second",
)


def along_reference(
    linearization: AbstractLinearization,
    model: GroundTrackModel,
    state: EntryState,
    factors: Factors | None = None,
) -> dict[str, Scalar]:
    """Outputs and their derivatives in a state of the reference, by name.

    The values are in rad, over the energy in units of its span. They are computed with the
    expressions of the law, so that on the reference it commands the reference controls.
    `factors` multiply the forces of the model along the reference; they are one by default.
    """
    one = jnp.ones_like(state.velocity)
    factors = Factors(one, one) if factors is None else factors
    seen = linearization.dynamics(model, state, factors)
    above, right, _ = model.reference_forces(state, factors)
    third, second = seen.under(above, right)
    values = *seen.downrange, third, *seen.crossrange, second
    return dict(zip(_COLUMNS, values, strict=True))


def _errors(
    seen: OutputDynamics, wanted: dict[str, Scalar]
) -> tuple[tuple[Scalar, Scalar, Scalar], tuple[Scalar, Scalar]]:
    """Errors of the outputs and of their derivatives with respect to the reference."""
    y1, y1_1, y1_2 = seen.downrange
    y2, y2_1 = seen.crossrange
    downrange = (
        y1 - wanted["downrange"],
        y1_1 - wanted["downrange_first"],
        y1_2 - wanted["downrange_second"],
    )
    return downrange, (y2 - wanted["crossrange"], y2_1 - wanted["crossrange_first"])


class GroundTrackTracking(AbstractContinuousLaw[TrackErrors]):
    """Feedback linearization of downrange and crossrange, equations (48) to (54).

    Memory is the integrals of the errors in (49).
    """

    model: GroundTrackModel
    reference: QuinticTable
    """Result of `along_reference` over the energy (J/kg), from `plan_ground_track`"""
    gains: AbstractTrackingGains
    band: AttitudeBand
    linearization: AbstractLinearization = FullLinearization()
    tradeoff: AbstractTradeoff = EqualTradeoff()
    force_knowledge: AbstractForceKnowledge = ModelledForces()

    def __check_init__(self):
        missing = [name for name in _COLUMNS if name not in self.reference.coefficients]
        if missing:
            raise ValueError(
                f"the reference has no {', '.join(missing)}: plan_ground_track makes one "
                "that has"
            )

    def init(self, measurement: Measurement) -> TrackErrors:
        nothing = 0.0 * measurement.drag
        return TrackErrors(nothing, nothing)

    def tracked(self, time: Scalar, measurement: Measurement, held: None) -> Tracked:
        model, state = self.model, measurement.state
        factors = self.force_knowledge.factors(model, measurement)
        seen = self.linearization.dynamics(model, state, factors)
        wanted = self._wanted(model.energy(state))
        errors = _errors(seen, wanted)
        return Tracked(errors, ("angle_of_attack", "bank_angle"))

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: TrackErrors
    ) -> tuple[Controls, TrackErrors]:
        here = self.model.energy(measurement.state)
        factors = self.force_knowledge.factors(self.model, measurement)
        wanted = self._wanted(here)
        return self.towards(wanted, self.model, factors, measurement, memory)

    def _wanted(self, energy: Scalar) -> dict[str, Scalar]:
        read = self.reference.with_derivatives(energy)
        return {name: read[name][0] for name in _COLUMNS}

    def towards(
        self,
        wanted: dict[str, Scalar],
        model: GroundTrackModel,
        factors: Factors,
        measurement: Measurement,
        memory: TrackErrors,
    ) -> tuple[Controls, TrackErrors]:
        """Command that tracks a reference, and the rate of the memory.

        **Arguments:**

        - first argument: result of `along_reference` at the point of the reference that has
          the energy of the vehicle.
        - `model`: model with the controls of that reference. The bounds of the angle of
          attack remain those about the reference of the law.
        - `factors`: factors on lift and drag of the model.
        """
        state = measurement.state
        here = model.energy(state)
        seen = self.linearization.dynamics(model, state, factors)
        (k11, k12, k13, k14), (k21, k22, k23) = self.gains.at(here)
        (off1, off1_1, off1_2), (off2, off2_1) = _errors(seen, wanted)
        w1 = (  # (49), with the second derivative in its first term
            wanted["downrange_third"]
            - k11 * off1_2
            - k12 * off1_1
            - k13 * off1
            - k14 * memory.downrange
        )
        w2 = (  # (49)
            wanted["crossrange_second"]
            - k21 * off2_1
            - k22 * off2
            - k23 * memory.crossrange
        )
        errors = TrackErrors(off1, off2)
        controls = self._flown(state, here, factors, *seen.lift_for(w1, w2))
        falls = -state.velocity * measurement.drag / model.energy_span
        return controls, jax.tree.map(lambda error: error * falls, errors)

    def _flown(
        self,
        state: EntryState,
        here: Scalar,
        factors: Factors,
        above: Scalar,
        right: Scalar,
    ) -> Controls:
        """Angle of attack and bank by (52) and (53), or within their limits by (54)."""
        model, band = self.model, self.band
        reference = model.angle_of_attack(here)
        least = jnp.maximum(reference - band.deviation, band.least)
        largest = jnp.minimum(reference + band.deviation, band.largest)
        bounds = LiftBounds(
            model.forces(state, least, factors)[0],
            model.forces(state, largest, factors)[0],
            band.largest_bank,
        )
        best = self.tradeoff.nearest(above, right, bounds)
        lift = best.lift / factors.lift
        angle = model.onboard.angle_of_attack_for(state, lift, least, largest)
        return Controls(angle, best.cos_bank, best.sin_bank)
