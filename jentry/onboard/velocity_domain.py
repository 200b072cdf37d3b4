"""Deviations from a glide over the velocity: the linear model for modulation.

Reference: R. Zhang, H. Li, R. Zhang, "Angle-of-Attack Modulation in Trajectory Tracking for
a Reusable Launch Vehicle", with the symbols of the paper. Radius is in units of the
planet's radius, velocity in units of the circular velocity at its surface, forces in units
of the gravity there; angles are in rad. Since the velocity falls, stable eigenvalues have
positive real parts.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._math import sincos
from ..fields import Scalar, scalar
from ..motion.state import EntryState
from .model import OnboardModel, require_sphere, require_still_air


class GlidePoint(eqx.Module):
    """A point of a reference over the velocity, in normalised units."""

    velocity: Scalar
    radius: Scalar
    flight_path_angle: Scalar
    """rad"""
    bank: Scalar
    """Magnitude of the bank, rad"""
    drag: Scalar
    lift: Scalar
    lift_slope: Scalar
    """dC_L/dalpha in units of C_L, 1/rad"""
    drag_slope: Scalar
    """dC_D/dalpha in units of C_D, 1/rad"""


class VelocityDomain(eqx.Module):
    """The law's model of the world: a sphere at rest with an exponential atmosphere."""

    model: OnboardModel
    """Model from which the aerodynamics, the radius and the gravity are taken"""
    scale_height: Scalar = scalar(7200.0, unit="m", positive=True)

    @property
    def gravity(self) -> Scalar:
        """Gravity at the surface, m/s2: the unit of force."""
        planet = self.model.planet
        return planet.gravity.acceleration(planet.radius)

    @property
    def circular_velocity(self) -> Scalar:
        """Circular velocity at the surface, m/s: the unit of velocity."""
        return jnp.sqrt(self.gravity * self.model.planet.radius)

    @property
    def steepness(self) -> Scalar:
        """Radius over scale height, R_e / H."""
        return self.model.planet.radius / self.scale_height

    def point(
        self, state: EntryState, wanted: dict[str, tuple[Scalar, Scalar, Scalar]]
    ) -> GlidePoint:
        """Reference at the velocity of a state, from the table of `plan_glide`."""
        value = {name: values[0] for name, values in wanted.items()}
        gravity, angle = self.gravity, value["angle_of_attack"]
        (lift, lift_slope), (drag, drag_slope) = self.model.coefficients_with_slopes(
            state, angle
        )
        planet = self.model.planet
        require_still_air(planet, "a glide over the velocity")
        require_sphere(planet, "a glide over the velocity")
        return GlidePoint(
            velocity=state.velocity / self.circular_velocity,
            radius=1.0 + value["altitude"] / planet.radius,
            flight_path_angle=value["flight_path_angle"],
            bank=value["bank"],
            drag=value["drag"] / gravity,
            lift=value["lift"] / gravity,
            lift_slope=lift_slope / lift,
            drag_slope=drag_slope / drag,
        )

    def exact(self, point: GlidePoint) -> "Deviations":
        """Equations (10), (11) and (16), by forward differentiation of the motion."""

        def rates(x: Float[Array, " 2"], angle: Scalar) -> Float[Array, " 2"]:
            r, gamma = x
            lift, drag = self._forces(point, r, angle)
            sine, cosine = sincos(gamma)
            _, cos_bank = sincos(point.bank)
            v = point.velocity
            slows = -drag - sine / r**2
            turns = (lift * cos_bank + (v * v - 1.0 / r) * cosine / r) / v
            return jnp.stack([v * sine / slows, turns / slows])

        def output(x: Float[Array, " 2"], angle: Scalar) -> Scalar:
            return self._forces(point, x[0], angle)[1]

        x = jnp.stack([point.radius, point.flight_path_angle])
        nothing = jnp.zeros_like(point.drag)
        a, b = jax.jacfwd(rates, (0, 1))(x, nothing)
        c, chi = jax.jacfwd(output, (0, 1))(x, nothing)
        return Deviations(a, b, c, chi)

    def simplified(self, point: GlidePoint) -> "Deviations":
        """Equations (14) and (15), corrected: a_gg = [(V^2 - 1) + L cos s] / (V D^2)."""
        v, drag, lift = point.velocity, point.drag, point.lift
        sine, _ = sincos(point.flight_path_angle)
        _, cos_bank = sincos(point.bank)
        drag_r = -self.steepness * drag
        carried = (v * v - 1.0) + lift * cos_bank
        per_drag = 1.0 / (v * drag)
        a_rr = v * drag_r * sine / drag**2
        a_rg = -v / drag
        a_gr = drag_r * (v * v - 1.0) * per_drag / drag
        a_gg = carried * per_drag / drag
        b_r = v * v * sine * per_drag * point.drag_slope
        b_g = per_drag * (
            carried * point.drag_slope - lift * point.lift_slope * cos_bank
        )
        nothing = jnp.zeros_like(drag)
        return Deviations(
            jnp.stack([jnp.stack([a_rr, a_rg]), jnp.stack([a_gr, a_gg])]),
            jnp.stack([b_r, b_g]),
            jnp.stack([drag_r, nothing]),
            drag * point.drag_slope,
        )

    def zero_dynamics(self, point: GlidePoint) -> tuple[Scalar, Scalar]:
        """Gamma1 and Gamma2 of (25); the bracket is C_La / C_L - C_Da / C_D."""
        v = point.velocity
        _, cos_bank = sincos(point.bank)
        up = point.lift * cos_bank
        bracket = point.lift_slope - point.drag_slope
        chi = point.drag * point.drag_slope
        gamma1 = self.steepness * up / (point.drag * chi) * bracket
        return gamma1, ((v * v - 1.0) + up) / (v * point.drag**2)

    def flight_condition(self, point: GlidePoint) -> Int[Array, ""]:
        """1 or 2 if holding the drag with the angle of attack is unstable, else 0.

        Condition 1: both Gammas are below zero. The angle of attack diverges in slow
        oscillations, on the back side of the lift-to-drag ratio. Condition 2: Gamma1 is
        above zero. The angle of attack diverges without oscillations, on the front side.
        """
        gamma1, gamma2 = self.zero_dynamics(point)
        return jnp.where(gamma1 > 0.0, 2, jnp.where(gamma2 < 0.0, 1, 0))

    def _forces(
        self, point: GlidePoint, radius: Scalar, angle: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Lift and drag beside a point, for an increment of the angle of attack.

        They are of first order in the increment, which suffices for derivatives.
        """
        thinner = jnp.exp(-self.steepness * (radius - point.radius))
        return (
            point.lift * thinner * (1.0 + point.lift_slope * angle),
            point.drag * thinner * (1.0 + point.drag_slope * angle),
        )


class Deviations(eqx.Module):
    """e' = A e + B u and y = C e + chi u: e of radius and path angle, y of the drag."""

    a: Float[Array, "2 2"]
    b: Float[Array, " 2"]
    c: Float[Array, " 2"]
    chi: Scalar
