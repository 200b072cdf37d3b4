"""What a law commands as a bank must be one: flights are stopped where it is not."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, free_scenario, with_leaf

from jentry.fields import Scalar, scalar
from jentry.flight import Adaptive, FixedStep, Outcome, Scenario
from jentry.guidance import (
    AbstractContinuousLaw,
    AbstractSampledLaw,
    FixedCycle,
    Sampled,
    Sharp,
    Smooth,
    SmoothReversals,
)
from jentry.guidance.switching import AbstractSwitching, shares_reversals
from jentry.motion import (
    Controls,
    EquatorialDynamics,
    IdealAttitude,
    Response,
    SecondOrderAttitude,
)


class Raw(AbstractContinuousLaw[None]):
    """A cosine and a sine as they are, from a time on; before it a bank of zero."""

    cosine: Scalar = scalar()
    sine: Scalar = scalar()
    start: Scalar = scalar(0.0, unit="s")
    switching: AbstractSwitching = Sharp()

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        begun = time >= self.start
        cosine = jnp.where(begun, self.cosine, 1.0)
        sine = jnp.where(begun, self.sine, 0.0)
        return Controls(0.0 * time, cosine, sine), None


def flying(law, **changes) -> Scenario:
    given = free_scenario(time_limit=60.0)
    return dataclasses.replace(given, guidance=law, **changes)


def outcome(cosine, sine, **given) -> Outcome:
    flight = fly_compiled(flying(Raw(cosine, sine, **given)), FixedStep(0.5))
    return Outcome(int(flight.outcome))


BANKS = {
    "level": (1.0, 0.0),
    "left": (0.6, -0.8),
    "rounded": (0.6, 0.8 + 5e-10),
    "rounded down": (0.6, 0.8 - 5e-10),
}

NO_BANKS = {
    "both cosine": (0.8, 0.8),
    "not normalised": (3.0, 4.0),
    "little": (0.6, 0.8 + 1e-8),
    "little less": (0.6, 0.8 - 1e-8),
    "no sine": (0.6, 0.0),
    "nothing": (0.0, 0.0),
    "degrees": (50.0, 0.0),
}


@pytest.mark.parametrize("name", BANKS)
def test_a_bank_is_flown(name):
    assert outcome(*BANKS[name]) == Outcome.TIMED_OUT


@pytest.mark.parametrize("name", NO_BANKS)
def test_what_is_no_bank_is_not_flown(name):
    assert outcome(*NO_BANKS[name]) == Outcome.NOT_A_BANK


@pytest.mark.parametrize("switching", [SmoothReversals(), Smooth()])
def test_a_surrogate_may_have_less_lift_and_not_more(switching):
    assert outcome(0.6, 0.3, switching=switching) == Outcome.TIMED_OUT
    assert outcome(0.6, 0.9, switching=switching) == Outcome.NOT_A_BANK
    assert outcome(0.6, 0.8 + 1e-8, switching=switching) == Outcome.NOT_A_BANK


def test_which_laws_share_reversals_out():
    law = Raw(0.6, 0.8)
    assert not shares_reversals(law) and not shares_reversals(Sampled(law, 1.0))
    smooth = dataclasses.replace(law, switching=SmoothReversals())
    assert shares_reversals(smooth) and shares_reversals(Sampled(smooth, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize("begin", [20.0, 20.2, 20.4999])
@pytest.mark.parametrize("solver", [FixedStep(0.5), Adaptive(1e-6)])
def test_a_flight_stops_where_its_command_is_no_bank_any_more(solver, begin):
    law = Raw(0.6, 0.9, start=begin)
    flight = fly_compiled(flying(law), solver, None)
    assert int(flight.outcome) == Outcome.NOT_A_BANK
    # By the step, or the guidance cycle of the adaptive solver.
    assert 18.5 <= float(flight.time) <= begin
    assert np.isfinite(float(flight.state.altitude))


@pytest.mark.parametrize("attitude", ["ideal", "lagging"])
def test_it_is_the_command_that_is_looked_at(attitude):
    """The attitude that is flown is a bank whatever was commanded."""
    axis = Response(0.5, 0.9, 0.1, 0.1, -1.0, 1.0)
    lagging = SecondOrderAttitude(axis, axis)
    chosen = IdealAttitude() if attitude == "ideal" else lagging
    flight = fly_compiled(flying(Raw(0.8, 0.8), attitude=chosen), FixedStep(0.5))
    assert int(flight.outcome) == Outcome.NOT_A_BANK


def test_in_the_plane_of_the_equator_as_well():
    """There nobody reads the sine."""
    given = flying(Raw(0.6, 0.9), dynamics=EquatorialDynamics())
    start = dataclasses.replace(given.initial_state, latitude=0.0, heading=np.pi / 2.0)
    given = dataclasses.replace(given, initial_state=start)
    assert int(fly_compiled(given, FixedStep(0.5)).outcome) == Outcome.NOT_A_BANK


def test_one_such_flight_leaves_the_others_of_a_batch():
    given = flying(Raw(0.6, 0.8))

    def end(sine):
        flight = fly_compiled(
            with_leaf(given, lambda s: s.guidance.sine, sine), FixedStep(0.5)
        )
        return flight.outcome, flight.state.altitude

    outcomes, altitudes = jax.vmap(end)(jnp.array([0.8, 0.9, -0.8]))
    assert list(outcomes) == [Outcome.TIMED_OUT, Outcome.NOT_A_BANK, Outcome.TIMED_OUT]
    np.testing.assert_allclose(altitudes[0], altitudes[2], rtol=1e-6)


class Late(AbstractSampledLaw[tuple[()], Controls]):
    """Holds nothing that is a bank until its first cycle, which begins at once."""

    cycle: FixedCycle = FixedCycle(1.0)

    def init(self, measurement):
        nothing = 0.0 * measurement.drag
        return (), Controls(nothing, nothing, nothing)

    def update(self, time, measurement, memory, held):
        one = jnp.ones_like(measurement.drag)
        return (), Controls(0.0 * one, 0.6 * one, 0.8 * one)

    def __call__(self, time, measurement, memory, held):
        return held, ()


def test_what_is_held_before_the_first_decision_is_not_flown():
    flight = fly_compiled(flying(Late()), FixedStep(0.5))
    assert int(flight.outcome) == Outcome.TIMED_OUT


def test_numbers_that_are_not_finite_have_their_own_outcome():
    assert outcome(np.nan, 0.0) == Outcome.NOT_FINITE


def test_the_message_says_what_to_do():
    assert "Controls.from_bank" in Outcome.NOT_A_BANK.message
