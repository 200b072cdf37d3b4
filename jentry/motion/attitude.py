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
    """What stands between the command of a law and the controls that are flown.

    The state of the attitude is a pytree of floats that is integrated with the motion,
    or None where nothing has to be remembered.
    """

    first_angle_of_attack: eqx.AbstractVar[Scalar | None]
    """Angle of attack at the start, rad; None where it is the one of the first command"""

    @abstractmethod
    def init(self, command: Controls) -> AttitudeState:
        """Attitude at the start: at rest, and at the first command where none is given."""

    @abstractmethod
    def angle_of_attack(self, state: AttitudeState) -> Scalar | None:
        """The angle of attack that is flown in a state, rad.

        None where it is the one that is commanded at the same instant.
        """

    @abstractmethod
    def bank(self, state: AttitudeState) -> "Swing | None":
        """The bank that is flown in a state, positive to the right, and how it turns.

        None where it is the one that is commanded at the same instant.
        """

    @abstractmethod
    def flown(self, state: AttitudeState, command: Controls) -> Controls:
        """What the vehicle flies in a state."""

    @abstractmethod
    def rate(self, state: AttitudeState, command: Controls) -> AttitudeState:
        """Time derivative of the state under a command."""


class IdealAttitude(AbstractAttitude[None]):
    """The vehicle flies each command at once."""

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
    """An angle about one axis and how fast it turns, or the time derivative of both."""

    angle: Scalar
    """Angle, rad"""
    rate: Scalar
    """Rate of the angle, rad/s"""


class Response(eqx.Module):
    """Second-order response of one angle to its command, with hard limits.

    angle'' = frequency^2 (command - angle) - 2 damping frequency angle', as far as the
    limits on the acceleration, the rate and the angle let it. The command is held within
    the limits of the angle, and so is the angle that is flown.
    """

    frequency: Scalar = scalar(unit="rad/s", positive=True)
    damping: Scalar = scalar(unit="1", positive=True)
    rate_limit: Scalar = scalar(unit="rad/s", positive=True)
    acceleration_limit: Scalar = scalar(unit="rad/s2", positive=True)
    lower: Scalar = scalar(unit="rad")
    """Smallest angle that is flown"""
    upper: Scalar = scalar(unit="rad")
    """Largest angle that is flown"""

    def within(self, angle: Scalar) -> Scalar:
        """The nearest angle (rad) within the limits."""
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
    """State of an attitude that takes its time."""

    angle_of_attack: Swing
    bank_angle: Swing


class SecondOrderAttitude(AbstractAttitude[Swings]):
    """Angle of attack and bank that each follow their command as a `Response`.

    A bank reversal takes the time that it takes, and goes through level wings: the
    commanded bank is within [-pi, pi]. It starts at rest: at the angles that are given, or
    at those of the first command, within the limits of the response.
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
