"""Range networks in three dimensions: predicted ends, decisions, and refused models."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from range_networks import (
    ALL,
    asked,
    in_plane,
    in_space,
    linear,
    of,
    summed,
    turning,
    underway,
    windy,
    with_network,
)

from jentry.addresses import replace_leaves
from jentry.guidance.lateral import (
    AbstractLateralLogic,
    PredictedCrossrange,
    PredictedPassage,
)
from jentry.guidance.range_network import RangeNetwork
from jentry.onboard import Factors, WindEstimator, WindPrior


HALF_LIFT_TO_DRAG = 0.1


def leading_aside(ranges=ALL):
    """ln of the deceleration falls by 1 from number 0 to 1, and by the side."""
    across = summed(np.log(HALF_LIFT_TO_DRAG), ranges)
    return linear(2.9, across=across, number=-1.0)


@pytest.mark.parametrize("number", [0.0, 0.3, 0.9, 1.0])
def test_to_the_side_it_is_that_of_a_turn(number):
    """y / x = L/D / 2 sin(bank) ln(v / v_f), with a cosine of the bank of 2 number - 1."""
    answer = asked(leading_aside(), number)
    end = float(in_plane().law.end.velocity)
    turn = np.sin(np.arccos(2.0 * number - 1.0)) * np.log(3000.0 / end)
    expected = HALF_LIFT_TO_DRAG * turn * float(answer.range)
    assert bool(answer.knows)
    assert float(answer.across) == pytest.approx(expected, rel=1e-12, abs=1e-6)
    assert float(asked(linear(2.9)).across) == 0.0


def aside(seen, number, sign):
    """Downrange and crossrange of the end, by vectors: from the place along the heading by
    the range, then at right angles by what leads to the side."""
    law = in_space().law
    radius, end = float(law.model.planet.radius), float(law.end.velocity)
    longitude, latitude = float(seen.state.longitude), float(seen.state.latitude)
    heading, velocity = float(seen.state.heading), float(seen.state.velocity)
    along = (velocity**2 - end**2) / (2.0 * np.exp(2.9 - number))
    turn = np.sin(np.arccos(2.0 * number - 1.0)) * np.log(velocity / end)
    angle, side = along / radius, HALF_LIFT_TO_DRAG * turn * along / radius
    up = np.array(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    north = np.cross(up, east)
    ahead = np.cos(heading) * north + np.sin(heading) * east
    right = np.cross(ahead, up)
    there = np.cos(angle) * up + np.sin(angle) * ahead
    there = np.cos(side) * there + sign * np.sin(side) * right
    # The origin is on the equator, and flies east.
    x, y, z = there
    return radius * np.arctan2(y, x), radius * np.arcsin(z)


def aimed(crossrange=0.0, network=None, **changes):
    """A law in three dimensions some way down, 8 degrees off to the left, and what it
    measures."""
    seen = underway()
    state = dataclasses.replace(
        seen.state, latitude=jnp.asarray(0.01), heading=jnp.asarray(np.radians(82.0))
    )
    law = dataclasses.replace(
        in_space().law,
        network=leading_aside() if network is None else network,
        aim=dataclasses.replace(in_space().law.aim, crossrange=crossrange),
        corrections=8,
        **changes,
    )
    origin = law.aim.origin
    assert (float(origin.longitude), float(origin.latitude)) == (0.0, 0.0)
    assert float(origin.heading) == pytest.approx(np.pi / 2)
    return law, dataclasses.replace(seen, state=state)


@eqx.filter_jit
def decided(law, seen):
    _, before = law.init(seen)
    return before, law.update(jnp.asarray(0.0), seen, (), before)[1]


@pytest.mark.parametrize("nearer", ["to the right", "to the left"])
def test_a_decision_in_three_dimensions_is_that_of_the_network(nearer):
    """The number brings it to the downrange, and the bank turns to the side on which it
    comes much nearer in crossrange."""
    law, seen = aimed()
    number = float(decided(law, seen)[1].numbers[0])
    assert 0.05 < number < 0.95
    passed = [aside(seen, number, sign) for sign in (1.0, -1.0)]
    assert passed[0][0] == pytest.approx(float(law.aim.downrange), abs=1e-3)
    right, left = (crossrange for _, crossrange in passed)
    assert right < left - 10e3
    law, _ = aimed(right + 100.0 if nearer == "to the right" else left + 100.0)
    before, after = decided(law, seen)
    assert float(before.side.sign) == 1.0
    turned = nearer == "to the left"
    assert float(after.side.reversals) == turned
    assert float(after.side.sign) == (-1.0 if turned else 1.0)
    assert float(law.caveats(after)["decisions_without_prediction"]) == 0.0


class Told(AbstractLateralLogic[PredictedPassage]):
    """Remembers what it is told of a bank to the left, and banks to the right."""

    def init(self, measurement):
        nothing = 0.0 * measurement.drag
        return PredictedPassage(nothing, nothing)

    def update(self, time, measurement, side, destination):
        return destination.predicted(-1.0 + 0.0 * time)

    def sign(self, side):
        return 1.0


@pytest.mark.parametrize("known", [True, False])
def test_a_lateral_logic_is_told_what_the_corrected_bank_makes_of_it(known):
    """And no number where the networks know nothing."""
    network = leading_aside(ALL if known else [*ALL[:1], (0.5, 2.0), *ALL[2:]])
    law, seen = aimed(50e3, network, lateral=Told())
    _, after = decided(law, seen)
    passage = after.side
    assert np.isnan(float(passage.time))
    if not known:
        assert np.isnan(float(passage.crossrange_error))
        return
    _, crossrange = aside(seen, float(after.numbers[0]), -1.0)
    expected = crossrange - 50e3
    assert float(passage.crossrange_error) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("which", ["ahead", "across"])
def test_what_one_of_two_networks_does_not_know_is_not_known(which):
    """Neither the number nor the side change, and it is said."""
    slow = [*ALL[:1], (0.5, 2.0), *ALL[2:]]
    ahead = summed(2.9, slow if which == "ahead" else ALL, number=-1.0)
    across = summed(np.log(0.1), slow if which == "across" else ALL)
    network = RangeNetwork(ahead, of(in_plane().law), across)
    law, seen = aimed(100e3, network)
    before, after = decided(law, seen)
    assert float(after.numbers[0]) == float(before.numbers[0])
    assert float(after.side.reversals) == 0.0
    assert float(law.caveats(after)["decisions_without_prediction"]) == 1.0


@pytest.mark.parametrize("in_three_dimensions", [True, False])
def test_of_a_planet_that_turns_a_network_knows_nothing(in_three_dimensions):
    """Where that is not known before it is asked, as in a campaign."""
    law, seen = aimed()
    if not in_three_dimensions:
        law, seen = with_network(linear(2.0)), underway()

    @jax.vmap
    def knows(rate):
        model = replace_leaves(law, {"model.planet.rotation_rate": rate}).model
        factors = jax.tree.map(jnp.asarray, Factors(1.0, 1.0))
        given = seen.angle_of_attack, factors, jnp.asarray(0.5), law.end.first()
        return law.network(model, seen.state, *given).knows

    assert knows(jnp.array([0.0, 1e-9, -7e-5])).tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda law: turning(law), "planet of the model turns by 7e-05 rad/s"),
        (lambda law: windy(law), "with the wind ConstantWind"),
        (
            lambda law: dataclasses.replace(
                law, wind=WindEstimator(WindPrior(30.0, 8e3), 0.01)
            ),
            "wind is estimated, and a network has learnt flights in still air",
        ),
        (
            lambda law: dataclasses.replace(
                law, lateral=PredictedCrossrange(predicts_reversals=True)
            ),
            "where the flight ends and not when.*predicts_reversals=False",
        ),
        (
            lambda law: dataclasses.replace(law, network=linear()),
            "this one is of flights in the vertical plane, and in_space is True",
        ),
        (
            lambda law: dataclasses.replace(law, in_space=False),
            "this one is of flights in three dimensions, and in_space is False",
        ),
    ],
)
def test_a_network_in_three_dimensions_is_refused_where_it_is_wrong(change, said):
    law, _ = aimed()
    with pytest.raises(ValueError, match=said):
        dataclasses.replace(change(law), steps=100)
