"""The predictor-corrector: predictions, decisions, and refused settings."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ahead, fly_compiled, mars_entry, with_leaf
from laws import predictor_corrector
from predictor_correctors import (
    decided,
    in_plane,
    in_space,
    number,
    predicted,
    start_of,
    underway,
)

from jentry.flight import FixedStep, Outcome, misses
from jentry.guidance import Aim, AngleOfAttackProfile, BankProfile, GuidedEnd, compose
from jentry.guidance.path_limits import PathLimits
from jentry.missions.x_33.predictor_corrector import guided as x_33
from jentry.motion import EntryState, Response, SecondOrderAttitude, Swing
from jentry.onboard import BankTurning, Factors, PolynomialProfile
from jentry.units import degree, km


# Predictions


def test_what_is_predicted_is_flown():
    """Open loop under the same bank, in the steps of the simulation, to its end."""
    scenario = in_plane()
    law = dataclasses.replace(scenario.law, step=1.0, steps=400)
    end = predicted(law, start_of(scenario), jnp.array([0.8]), 1.0, False)
    held = eqx.tree_at(
        lambda s: s.guidance, scenario, BankProfile(PolynomialProfile([0.6]))
    )
    flown = fly_compiled(held)
    # Fourth order of steps of 1 and of 0.1 s.
    assert float(end.time) == pytest.approx(float(flown.time), abs=1e-4)
    assert float(end.state.longitude) == pytest.approx(
        float(flown.state.longitude), abs=0.1 / float(scenario.planet.radius)
    )


def turning_from(bank):
    """The law with a bank that turns by a degree a second, and what it senses."""
    scenario = in_space()
    turning = BankTurning(1.0 * degree, 5.0 * degree)
    law = dataclasses.replace(scenario.law, turning=turning, step=2.0, steps=200)
    swing = Swing(number(bank * degree), number(0.0))
    return law, dataclasses.replace(start_of(scenario), bank=swing)


AXES = "longitude", "latitude"

BANK = 60.0
"""deg; the number 0.75 of a bank up to half a turn"""


@pytest.mark.slow
def test_what_is_predicted_while_the_bank_turns_is_flown():
    """From the left to the right in two minutes, by an attitude whose bandwidth is large
    beside its rate."""
    law, seen = turning_from(-BANK)
    end = predicted(law, seen, jnp.array([0.75]), 1.0, True)
    swift = lambda reach, rate: Response(
        5.0, 1.0, rate * degree, 5.0 * degree, -reach, reach
    )
    attitude = SecondOrderAttitude(
        swift(1.0, 100.0), swift(math.pi, 1.0), None, -BANK * degree
    )
    bank = BankProfile(PolynomialProfile([math.cos(BANK * degree)]))
    flown = fly_compiled(
        dataclasses.replace(in_space(), guidance=bank, attitude=attitude)
    )
    at_once = predicted(in_space().law, seen, jnp.array([0.75]), 1.0, True)
    radius = float(in_space().planet.radius)
    off, moved = (
        [radius * float(getattr(a, axis) - getattr(b.state, axis)) for axis in AXES]
        for a, b in ((flown.state, end), (flown.state, at_once))
    )
    # The turn ends 0.04 s late, and so does a lift of some 20 m/s2: 2 m.
    assert np.max(np.abs(off)) < 20.0
    assert np.max(np.abs(moved)) > 100e3


@pytest.mark.slow
def test_a_reversal_that_comes_at_once_is_to_the_other_side():
    law, seen = turning_from(BANK)
    numbers = jnp.array([0.75])
    kept, later, now, other = (
        predicted(law, seen, numbers, sign, True, reverses_in=number(time)).state
        for sign, time in ((1.0, math.inf), (1.0, 60.0), (1.0, 0.0), (-1.0, math.inf))
    )
    np.testing.assert_allclose(now.latitude, other.latitude, rtol=1e-12)
    assert float(kept.latitude) < float(later.latitude) < float(now.latitude)


@pytest.mark.slow
def test_wings_level_can_be_left_where_a_bank_turns():
    """The derivative of what is predicted is there at the bound of the number too."""
    law, seen = turning_from(30.0)

    @eqx.filter_jit
    def longitude(share):
        return predicted(law, seen, share[None], 1.0, False).state.longitude

    ends = [
        jax.jvp(longitude, (number(share),), (number(1.0),))
        for share in (1.0, 0.999, 0.998)
    ]
    (at_bound, slope), (before, _), (twice, _) = [map(float, end) for end in ends]
    # The one-sided difference of second order.
    expected = (3.0 * at_bound - 4.0 * before + twice) / (2.0 * 0.001)
    assert slope == pytest.approx(expected, rel=1e-3) and abs(slope) > 0.1


def test_a_bank_that_is_flown_at_once_has_no_turning():
    law, seen = turning_from(BANK)
    with pytest.raises(ValueError, match="flies its commands at once"):
        decided(law, dataclasses.replace(seen, bank=None), jnp.array([0.75]))


@pytest.mark.slow
def test_what_is_predicted_with_an_angle_of_attack_is_flown():
    scenario = x_33()
    law = scenario.law
    angle = AngleOfAttackProfile(law.angle_of_attack)
    cosine = math.cos(40 * degree)
    bank = BankProfile(PolynomialProfile([cosine]))
    flown = fly_compiled(
        eqx.tree_at(lambda s: s.guidance, scenario, compose(angle, bank)),
        FixedStep(0.5),
    )
    level = jnp.full(2, 1.0 - 40.0 / 80.0)
    end = predicted(law, start_of(scenario), level, 1.0, False)
    assert float(end.time) == pytest.approx(float(flown.time), abs=0.01)
    assert float(end.state.altitude) == pytest.approx(
        float(flown.state.altitude), abs=5.0
    )


@pytest.mark.slow
def test_side_of_the_bank_is_that_of_the_predicted_crossrange():
    scenario = in_space()
    ends = [
        predicted(scenario.law, start_of(scenario), jnp.array([0.7]), sign, True)
        for sign in (1.0, -1.0)
    ]
    right, left = (float(end.state.latitude) for end in ends)
    assert right == pytest.approx(-left, rel=1e-9)
    assert right < -1e-3  # due east, to the south


def test_factors_are_those_of_the_prediction():
    law, seen = in_plane().law, start_of(in_plane())
    thicker = Factors(1.2, 1.2)
    by_factor = predicted(law, seen, jnp.array([0.8]), 1.0, False, thicker)
    denser = with_leaf(law, lambda law: law.model.planet.density_scale, 1.2)
    by_density = predicted(denser, seen, jnp.array([0.8]), 1.0, False)
    for a, b in zip(
        jax.tree.leaves(by_factor.state), jax.tree.leaves(by_density.state), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-11)


@pytest.mark.parametrize("bearing", [0.0, 35.0, -60.0, 170.0])
def test_range_to_go_is_the_arc_to_the_target(bearing):
    aim = Aim(mars_entry(), 900 * km, -120 * km, 10 * km, 503.0)
    law = dataclasses.replace(predictor_corrector(), aim=aim)
    radius = float(law.model.planet.radius)
    # The target by the textbook: east along the equator, then to the right, to the south.
    target = 900 * km / radius / degree, -120 * km / radius / degree
    distance = 7.0
    (longitude, latitude, _) = ahead(target, bearing, distance)
    numbers = (2e4, longitude * degree, latitude * degree, 3e3, -0.1, 1.5)
    here = EntryState(*(number(x) for x in numbers))
    assert abs(float(law.range_to_go(here))) == pytest.approx(
        radius * distance * degree, rel=1e-12
    )
    behind = longitude > target[0]
    assert (float(law.range_to_go(here)) < 0.0) == behind


# Decisions


after = eqx.filter_jit(decided)


@pytest.mark.slow
def test_a_decision_is_a_zero_of_the_prediction():
    law, (_, seen) = in_plane().law, underway()
    numbers = jnp.array([0.7])
    for _ in range(4):
        numbers = after(law, seen, numbers).numbers
    end = predicted(law, seen, numbers, 1.0, False)
    reached = law.model.planet.radius * float(end.state.longitude)
    assert reached == pytest.approx(float(law.range_to_go(seen.state)), abs=0.01)


@pytest.mark.parametrize(("share", "best"), [(0.2, 0.0), (3.0, 1.0)])
def test_what_cannot_be_reached_saturates_on_the_side_that_comes_nearest(share, best):
    law, (_, seen) = in_plane().law, underway()
    law = with_leaf(law, lambda law: law.aim.downrange, share * 723.32 * km)
    numbers = jnp.array([0.5])
    for _ in range(3):
        held = after(law, seen, numbers)
        # Two corrections, none of which goes farther than it may.
        assert abs(float(held.numbers[0] - numbers[0])) <= 2 * 0.3 + 1e-12
        numbers = held.numbers
    assert float(numbers[0]) == best
    assert float(held.without_prediction) == 0.0


def test_before_there_is_air_nothing_is_decided():
    law = in_plane().law
    held = after(law, start_of(in_plane()), jnp.array([0.3]))
    assert float(held.numbers[0]) == 0.3
    assert float(held.decisions) == 0.0


def test_where_the_number_can_do_little_it_stays():
    law, (_, seen) = in_plane().law, underway()
    law = with_leaf(law, lambda law: law.aim.downrange, law.aim.downrange + 2 * km)
    assert float(after(law, seen, jnp.array([0.7])).numbers[0]) != 0.7
    # Effects are of some hundreds of km: none of them is enough, nor is the miss.
    lazy = with_leaf(law, lambda law: law.least_effect, 1e9)
    assert float(after(lazy, seen, jnp.array([0.7])).numbers[0]) == 0.7


def test_a_flight_that_skips_out_goes_too_far():
    """At the ceiling it is nearer than the target; the number falls all the same."""
    scenario = in_plane()
    shallow = with_leaf(
        scenario, lambda s: s.initial_state.flight_path_angle, -4.0 * degree
    )
    law = with_leaf(shallow.law, lambda law: law.gate, 1e-12)
    seen = start_of(shallow)
    end = predicted(law, seen, jnp.array([1.0]), 1.0, False)
    assert bool(law.end.is_skip(end.ended_by))
    far = with_leaf(law, lambda law: law.aim.downrange, 1e7)
    held = after(far, seen, jnp.array([1.0]))
    assert float(held.numbers[0]) == pytest.approx(1.0 - 2 * 0.3, abs=1e-12)
    assert float(held.without_prediction) == 0.0


@pytest.mark.slow
def test_a_flight_that_outlasts_its_steps_goes_too_far():
    law, (_, seen) = in_plane().law, underway()
    short = dataclasses.replace(law, steps=8, step=1.0)
    held = after(short, seen, jnp.array([0.7]))
    assert float(held.numbers[0]) == pytest.approx(0.7 - 2 * 0.3, abs=1e-12)


def test_without_a_prediction_the_numbers_stay_and_it_is_said():
    law, (_, seen) = in_plane().law, underway()
    lost = with_leaf(law, lambda law: law.model.vehicle.mass, jnp.nan)
    held = after(lost, seen, jnp.array([0.7]))
    assert float(held.numbers[0]) == 0.7
    assert float(lost.caveats(held)["decisions_without_prediction"]) == 1.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"corrections": 0}, "corrections is 0"),
        ({"step": 0.0}, "steps of 0.0 s"),
        ({"steps": 0}, "0 steps"),
        ({"predicts_limits": True}, "limits is None"),
        (
            {"predicts_limits": True, "limits": PathLimits(), "step": 3.0},
            "step is 3.0 s and the guidance cycle 2.0 s",
        ),
    ],
)
def test_what_cannot_predict_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        dataclasses.replace(predictor_corrector(), **changes)


def test_an_end_must_be_given():
    with pytest.raises(ValueError, match="no velocity, no altitude and no energy"):
        GuidedEnd(ceiling=1e5)


# Flights


def test_nominal_flight_ends_at_its_target():
    miss = misses(in_plane(), underway()[0])
    assert abs(float(miss.downrange)) < 0.1
    assert int(underway()[0].outcome) == Outcome.REACHED
