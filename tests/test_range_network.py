"""Range networks: inputs, predicted ranges, and decisions in the vertical plane."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import with_leaf
from range_networks import ALL, asked, in_plane, linear, summed, underway, with_network

from jentry.addresses import leaves_by_address, replace_leaves
from jentry.guidance.bank_shapes import ConstantBankShape, LinearBankShape
from jentry.guidance.glide_damping import GlideDamping
from jentry.guidance.range_network import RangeNetwork, features
from jentry.missions.mars import predictor_corrector as mars
from jentry.onboard import Factors
from jentry.onboard.network import Network
from jentry.onboard.profiles import PolynomialProfile


def test_range_is_that_of_the_mean_deceleration():
    """Of 10 m/s2 from 3000 m/s down to 503: x = (v^2 - v_f^2) / (2 a)."""
    answer = asked(linear(np.log(10.0)))
    assert bool(answer.knows)
    end = float(in_plane().law.end.velocity)
    assert float(answer.range) == pytest.approx((3000.0**2 - end**2) / 20.0, rel=1e-12)


def test_inputs_are_what_their_names_say():
    law, seen = in_plane().law, underway()
    factors = Factors(jnp.asarray(1.2), jnp.asarray(0.8))
    read = features(
        law.model, seen.state, seen.angle_of_attack, factors, jnp.asarray(0.3)
    )
    vehicle, air = law.model.vehicle, law.model.planet.atmosphere
    density = float(air.surface_density * np.exp(-30e3 / air.scale_height))
    # 115 kg/m2 of the paper.
    drag = 0.8 * 0.5 * density * 3000.0**2 / 115.0
    expected = [3.0, 3.0, -1.0, np.log(drag), np.log(0.8), np.log(1.5), 0.3]
    np.testing.assert_allclose(read, expected, rtol=1e-9)
    assert vehicle.mass == 992.0


@pytest.mark.parametrize(
    ("change", "knows"),
    [
        ({}, True),
        ({"number": 1.0}, True),
        ({"number": 1.0001}, False),
        ({"velocity": 500.0}, False),  # slower than the end
        ({"factors": Factors(jnp.nan, 1.0)}, False),
    ],
)
def test_it_knows_what_it_was_trained_on(change, knows):
    answer = asked(linear(2.0), **change)
    assert bool(answer.knows) == knows
    assert np.isfinite(answer.range) and (answer.range > 0.0) == knows


def test_another_network_is_refused():
    wrong = Network(
        (jnp.ones((1, 2)),),
        (jnp.zeros(1),),
        ("a", "b"),
        jnp.zeros(2),
        jnp.ones(2),
        jnp.asarray([(0.0, 1.0)] * 2),
        jnp.asarray(0.0),
        jnp.asarray(1.0),
    )
    with pytest.raises(ValueError, match="the network reads a, b: the range is read"):
        RangeNetwork(wrong, jnp.zeros(8))
    with pytest.raises(ValueError, match="the network reads a, b: the range is read"):
        RangeNetwork(summed(), jnp.zeros(8), wrong)
    with pytest.raises(
        ValueError, match="of has shape .3,.: a network of the range is"
    ):
        RangeNetwork(linear().network, jnp.zeros(3))


@pytest.mark.parametrize(
    "address",
    [
        "end.velocity",
        "end.altitude",
        "model.planet.radius",
        "model.planet.gravity.gravitational_parameter",
        "model.planet.atmosphere.surface_density",
        "model.planet.atmosphere.scale_height",
        "model.vehicle.mass",
        "model.vehicle.aerodynamics.lift_coefficient",
        "model.vehicle.aerodynamics.drag_coefficient",
    ],
)
def test_of_another_model_or_end_it_knows_nothing(address):
    law, seen = in_plane().law, underway()
    other = replace_leaves(law, {address: 1.0001 * leaves_by_address(law)[address]})
    for asked_about, knows in ((law, True), (other, False)):
        answer = linear(2.0)(
            asked_about.model,
            seen.state,
            seen.angle_of_attack,
            Factors(jnp.asarray(1.0), jnp.asarray(1.0)),
            jnp.asarray(0.5),
            asked_about.end.first(),
        )
        assert bool(answer.knows) == knows


def test_a_decision_is_where_the_network_says_that_the_target_is():
    """ln of the deceleration falls by 1 from number 0 to 1: more lift flies farther."""
    law = with_network(linear(2.9, number=-1.0), corrections=6)
    seen = underway()
    end = float(law.end.velocity)
    to_go = float(law.range_to_go(seen.state))
    number = 2.9 - np.log((3000.0**2 - end**2) / (2.0 * to_go))
    assert 0.1 < number < 0.9
    _, before = law.init(seen)
    _, after = eqx.filter_jit(law.update)(jnp.asarray(0.0), seen, (), before)
    assert float(after.numbers[0]) == pytest.approx(number, abs=1e-9)
    assert float(law.caveats(after)["decisions_without_prediction"]) == 0.0


def test_a_shape_with_another_largest_bank_asks_about_its_bank():
    """The same bank is flown, whatever the number is that tells it."""
    seen, cosines = underway(), []
    for lowest in (-1.0, -0.8):
        shape = ConstantBankShape(lowest=lowest)
        law = with_network(linear(2.9, number=-1.0), corrections=8, shape=shape)
        _, before = law.init(seen)
        _, held = eqx.filter_jit(law.update)(jnp.asarray(0.0), seen, (), before)
        cosines.append(float(shape.cos_bank(held.numbers, held.since, held.since)))
    assert cosines[1] == pytest.approx(cosines[0], abs=1e-9)


def test_where_the_network_knows_nothing_the_number_stays_and_it_is_said():
    slow = [*ALL[:1], (0.5, 2.0), *ALL[2:]]
    law = with_network(linear(2.5, slow, number=-1.0))
    seen = underway()
    _, before = law.init(seen)
    _, after = eqx.filter_jit(law.update)(jnp.asarray(0.0), seen, (), before)
    assert float(after.numbers[0]) == float(before.numbers[0])
    assert float(law.caveats(after)["decisions_without_prediction"]) == 1.0


def test_a_network_of_another_prediction_is_refused():
    law = in_plane().law
    for changes in (
        {"in_space": True},
        {"damping": GlideDamping()},
        {"shape": LinearBankShape(end=0.0)},
        {"angle_of_attack": PolynomialProfile(jnp.ones(1))},
        {"end": mars.GuidedEnd(altitude=10e3)},
    ):
        with pytest.raises(
            ValueError, match="a network takes the place of the predict"
        ):
            dataclasses.replace(law, network=linear(), **changes)
    turning = with_leaf(law, lambda law: law.model.planet.rotation_rate, 7e-5)
    with pytest.raises(ValueError, match="over a planet at rest"):
        dataclasses.replace(turning, network=linear())
