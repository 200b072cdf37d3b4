"""How the attitude follows a command: at once, or as a second-order response."""

from abc import abstractmethod
from typing import ClassVar, Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp

from .._interpolation import clamp
from ..fields import Scalar, optional_scalar, scalar
from .state import Controls


AttitudeState = TypeVar("AttitudeState")


class AbstractAttitude(eqx.Module, Generic[AttitudeState]):
    """Response of the attitude: it turns the commands of a law into controls.

    Its state is a pytree of floats that is integrated with the motion, or None if it has
    no state.
    """

    first_angle_of_attack: eqx.AbstractVar[Scalar | None]
    """Angle of attack at the start, rad; None for that of the first command"""

    @abstractmethod
    def init(self, command: Controls) -> AttitudeState:
        """Attitude at the start, at rest: at the given angles or at the first command."""

    @abstractmethod
    def angle_of_attack(self, state: AttitudeState) -> Scalar | None:
        """Angle of attack of the vehicle in a state, rad.

        It is None if it is the angle commanded at the same instant.
        """

    @abstractmethod
    def bank(self, state: AttitudeState) -> "Swing | None":
        """Bank of the vehicle in a state, positive to the right, and its rate.

        It is None if it is the bank commanded at the same instant.
        """

    @abstractmethod
    def flown(self, state: AttitudeState, command: Controls) -> Controls:
        """Controls of the vehicle in a state, under a command."""

    @abstractmethod
    def rate(self, state: AttitudeState, command: Controls) -> AttitudeState:
        """Time derivative of the state under a command."""


class IdealAttitude(AbstractAttitude[None]):
    """An attitude that follows each command at once."""

    first_angle_of_attack: ClassVar[None] = None

    def init(self, command: Controls) -> None:
        return None

    def angle_of_attack(self, state: None) -> None:
        return None

    def bank(self, state: None) -> None:
        return None

    def flown(self, state: None, command: Controls) -> Controls:
        return command

    def rate(self, state: None, command: Controls) -> None:
        return None


class Swing(eqx.Module):
    """An angle about one axis and its rate, or the time derivatives of both."""

    angle: Scalar
    """Angle, rad"""
    rate: Scalar
    """Rate of the angle, rad/s"""


class Response(eqx.Module):
    """Second-order response of one angle to its command, with hard limits.

    angle'' = frequency^2 (command - angle) - 2 damping frequency angle', within the limits
    on the acceleration, the rate and the angle. Both the command and the angle of the
    vehicle are clamped to the limits of the angle.
    """

    frequency: Scalar = scalar(unit="rad/s", positive=True)
    damping: Scalar = scalar(unit="1", positive=True)
    rate_limit: Scalar = scalar(unit="rad/s", positive=True)
    acceleration_limit: Scalar = scalar(unit="rad/s2", positive=True)
    lower: Scalar = scalar(unit="rad")
    """Smallest angle of the vehicle"""
    upper: Scalar = scalar(unit="rad")
    """Largest angle of the vehicle"""

    def within(self, angle: Scalar) -> Scalar:
        """Angle (rad) clamped to the limits."""
        return clamp(angle, self.lower, self.upper)

    def turn(self, swing: Swing, command: Scalar) -> Swing:
        """Time derivative of angle and rate under a command (rad)."""
        away = self.within(command) - swing.angle
        wish = self.frequency * (
            self.frequency * away - 2.0 * self.damping * swing.rate
        )
        acceleration = jnp.clip(wish, -self.acceleration_limit, self.acceleration_limit)
        rate = jnp.clip(swing.rate, -self.rate_limit, self.rate_limit)
        outward = swing.rate * acceleration > 0.0
        fast = jnp.abs(swing.rate) >= self.rate_limit
        acceleration = jnp.where(fast & outward, 0.0, acceleration)
        stopped = ((swing.angle >= self.upper) & (rate > 0.0)) | (
            (swing.angle <= self.lower) & (rate < 0.0)
        )
        return Swing(jnp.where(stopped, 0.0, rate), acceleration)


class Swings(eqx.Module):
    """State of a `SecondOrderAttitude`."""

    angle_of_attack: Swing
    bank_angle: Swing


class SecondOrderAttitude(AbstractAttitude[Swings]):
    """An attitude whose angle of attack and bank each follow their command as a `Response`.

    A bank reversal takes time and passes through zero bank: the commanded bank is within
    [-pi, pi]. The attitude starts at rest, at the given angles or at those of the first
    command, within the limits of the response.
    """

    angle_of_attack_response: Response
    bank_response: Response
    first_angle_of_attack: Scalar | None = optional_scalar(unit="rad")
    """Angle of attack at the start; None for the commanded one"""
    first_bank_angle: Scalar | None = optional_scalar(unit="rad")
    """Bank angle at the start, positive to the right; None for the commanded one"""

    def init(self, command: Controls) -> Swings:
        def at_rest(response: Response, given: Scalar | None, wish: Scalar) -> Swing:
            angle = wish if given is None else given + 0.0 * wish
            return Swing(response.within(angle), 0.0 * angle)

        return Swings(
            at_rest(
                self.angle_of_attack_response,
                self.first_angle_of_attack,
                command.angle_of_attack,
            ),
            at_rest(self.bank_response, self.first_bank_angle, command.bank_angle),
        )

    def angle_of_attack(self, state: Swings) -> Scalar:
        return self.angle_of_attack_response.within(state.angle_of_attack.angle)

    def bank(self, state: Swings) -> Swing:
        response, swing = self.bank_response, state.bank_angle
        limit = response.rate_limit
        return Swing(response.within(swing.angle), clamp(swing.rate, -limit, limit))

    def flown(self, state: Swings, command: Controls) -> Controls:
        bank_angle = self.bank_response.within(state.bank_angle.angle)
        return Controls.from_bank(bank_angle, self.angle_of_attack(state))

    def rate(self, state: Swings, command: Controls) -> Swings:
        return Swings(
            self.angle_of_attack_response.turn(
                state.angle_of_attack, command.angle_of_attack
            ),
            self.bank_response.turn(state.bank_angle, command.bank_angle),
        )
