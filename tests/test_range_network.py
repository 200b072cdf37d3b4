"""The range of the rest of a flight by a network, in place of its prediction."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ConstantBank, along_each, with_leaf

import jentry
from jentry._computed_once import computed_once
from jentry.addresses import leaves_by_address, replace_leaves
from jentry.guidance.bank_shapes import ConstantBankShape, LinearBankShape
from jentry.guidance.glide_damping import GlideDamping
from jentry.guidance.lateral import (
    AbstractLateralLogic,
    PredictedCrossrange,
    PredictedPassage,
)
from jentry.guidance.range_network import INPUTS, RangeNetwork, basis, features
from jentry.learning.range_network import (
    LEAST,
    predict_samples,
    train_range_network,
)
from jentry.missions import find_mission
from jentry.missions.mars import predictor_corrector as mars
from jentry.missions.mars.drag_tracking import independent
from jentry.motion.quantities import ground_track
from jentry.onboard import Factors, WindEstimator, WindPrior
from jentry.onboard.navigation import Measurement, measure
from jentry.onboard.network import Network, load_network, save_network
from jentry.onboard.profiles import PolynomialProfile
from jentry.world.wind import ConstantWind


ALL = [(-1e3, 1e3)] * 6 + [(0.0, 1.0)]


def summed(constant=0.0, ranges=ALL, **weights):
    """Network without hidden layers: a sum of its inputs."""
    given = [weights.pop(name, 0.0) for name in ("velocity", "number")]
    assert not weights
    row = np.zeros(7)
    row[1], row[6] = given
    return Network(
        (jnp.asarray(row)[None],),
        (jnp.zeros(1),),
        INPUTS,
        jnp.zeros(7),
        jnp.ones(7),
        jnp.asarray(ranges),
        jnp.asarray(constant),
        jnp.asarray(1.0),
    )


def linear(constant=0.0, ranges=ALL, across=None, **weights):
    """In three dimensions with a network of what leads to the side."""
    network = summed(constant, ranges, **weights)
    return RangeNetwork(network, of(in_plane().law), across)


def of(law):
    angle = law.model.vehicle.trim_angle_of_attack
    return basis(law.model, in_plane().initial_state, angle, law.end.first())


@computed_once
def in_plane():
    return find_mission("mars-range-tracking").scenario(
        "predictor-corrector", world="in-plane"
    )


@computed_once
def in_space():
    return mars.guided()


def underway(velocity=3000.0, altitude=30e3, law=None):
    """What is measured by the nominal vehicle some way down."""
    law = in_plane().law if law is None else law
    model = law.model
    state = jentry.EntryState(altitude, 0.1, 0.0, velocity, -0.1, jnp.pi / 2)
    state = jax.tree.map(jnp.asarray, state)
    angle = model.vehicle.trim_angle_of_attack
    sensed = measure(model.planet, model.vehicle, state, angle)
    return Measurement(state, sensed.lift, sensed.drag, angle, angle, {})


def asked(network, number=0.5, velocity=3000.0, factors=Factors()):
    law, seen = in_plane().law, underway(velocity)
    factors = jax.tree.map(jnp.asarray, factors)
    given = law.model, seen.state, seen.angle_of_attack, factors, jnp.asarray(number)
    return network(*given, law.end.first())


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


def turning(law):
    return replace_leaves(law, {"model.planet.rotation_rate": 7e-5})


def windy(law):
    return eqx.tree_at(lambda law: law.model.planet.wind, law, ConstantWind(east=10.0))


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
                law, lateral=PredictedCrossrange(foresees=True)
            ),
            "where the flight ends and not when.*take foresees=False",
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


def with_network(network, **changes):
    return dataclasses.replace(in_plane().law, network=network, **changes)


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


def test_shipped_network_says_how_it_was_trained():
    network = mars.range_network()
    _, card = load_network(mars.FOLDER / "range.npz")
    assert network.network.names == INPUTS
    assert card["command"].startswith("jentry train mars-range-tracking --seed 0 ")
    low, high = card["inputs"]["number of the bank"]
    assert (low, high) == (0.0, 1.0)  # where a number saturates it is known
    np.testing.assert_allclose(network.of, of(in_plane().law), rtol=1e-9)


def test_a_file_that_does_not_say_what_it_is_of_is_refused(tmp_path):
    network, card = load_network(mars.FOLDER / "range.npz")
    del card["of"]
    save_network(tmp_path / "range.npz", network, card)
    with pytest.raises(ValueError, match="does not say what it is of .velocity at the"):
        mars.range_network(tmp_path)


def test_shipped_networks_in_three_dimensions_say_how_they_were_trained():
    network = mars.range_network_in_space()
    assert network.in_space and len(network.networks) == 2
    for name in ("range", "ahead", "across"):
        _, card = load_network(mars.FOLDER / f"{name}.npz")
        _, of_the_plane = load_network(mars.FOLDER / "range.npz")
        assert card["command"] == of_the_plane["command"]
        assert card["inputs"]["number of the bank"] == [0.0, 1.0]
    np.testing.assert_allclose(network.of, of(in_space().law), rtol=1e-9)


def test_networks_that_do_not_belong_together_are_refused(tmp_path):
    for name in ("ahead", "across"):
        network, card = load_network(mars.FOLDER / f"{name}.npz")
        save_network(tmp_path / f"{name}.npz", network, card)
    assert mars.range_network_in_space(tmp_path).in_space
    mars.range_network_in_space.cache_clear()
    other = dict(card["of"], **{"velocity at the end, m/s": 600.0})
    save_network(tmp_path / "across.npz", network, card | {"of": other})
    with pytest.raises(
        ValueError,
        match="are not of the same predictions: velocity at the end, m/s 503 and 600;",
    ):
        mars.range_network_in_space(tmp_path)
    plane, card = load_network(mars.FOLDER / "range.npz")
    save_network(tmp_path / "ahead.npz", plane, card)
    with pytest.raises(ValueError, match="is a network for 'range at a constant bank"):
        mars.range_network_in_space(tmp_path)


@pytest.fixture(scope="module")
def samples():
    """Of another seed than those that the shipped network has learnt from."""
    return predict_samples(in_plane(), independent(), 100, 3000, jax.random.key(7))


@pytest.mark.slow
def test_samples_are_predictions(samples):
    law = in_plane().law
    predict = eqx.filter_jit(law.predicted)
    for index in range(0, len(samples), len(samples) // 20):
        one = jax.tree.map(jnp.asarray, samples.of(np.array([index])))
        state, factors = jax.tree.map(lambda x: x[0], (one.states, one.factors))
        angle = law.model.vehicle.trim_angle_of_attack
        sensed = measure(law.model.planet, law.model.vehicle, state, angle)
        seen = Measurement(state, sensed.lift, sensed.drag, angle, angle, {})
        end = predict(jnp.asarray(0.0), seen, factors, one.numbers[:1], 1.0, False)
        flown = law.model.planet.radius * end.state.longitude
        assert float(one.ranges[0]) == pytest.approx(float(flown), rel=1e-9)
    assert np.all(samples.ranges >= LEAST)
    left_out = sum(samples.left_out.values())
    assert len(samples) + left_out == 3000 and left_out < 600
    for bound in (0.0, 1.0):
        assert np.mean(samples.numbers == bound) == pytest.approx(0.045, abs=0.015)


def errors(network, samples):
    """Magnitudes, m; NaN where the network knows nothing."""
    law = in_plane().law
    angle, end = law.model.vehicle.trim_angle_of_attack, law.end.first()

    @eqx.filter_jit
    @jax.vmap
    def asked(state, factors, number):
        return network(law.model, state, angle, factors, number, end)

    given = samples.states, samples.factors, samples.numbers
    answers = asked(*jax.tree.map(jnp.asarray, given))
    found = np.where(answers.knows, answers.range, np.nan)
    return np.abs(found - samples.ranges)


@pytest.mark.slow
def test_shipped_network_predicts_as_well_as_its_card_says(samples):
    _, card = load_network(mars.FOLDER / "range.npz")
    error = errors(mars.range_network(), samples)
    known = np.isfinite(error)
    error = error[known]
    assert known.mean() > 0.98
    # Means of 6000 and of 3000 errors with long tails.
    assert error.mean() < 1.3 * card["held out mean error, m"]
    near = samples.ranges[known] < 100e3
    assert error[near].mean() < 1.3 * card["held out mean error below 100 km, m"]


@pytest.mark.slow
def test_training_again_learns(samples):
    told = []
    trained = train_range_network(
        in_plane(),
        samples,
        jax.random.key(0),
        hidden=(16,),
        warm_up=500,
        iterations=500,
        report=told.append,
    )
    card = trained.cards["range"]
    assert card["samples"] + card["held out samples"] == len(samples)
    # The error of the card is that of flights which the network has not learnt from.
    _, split, _, _ = jax.random.split(jax.random.key(0), 4)
    flights = np.max(samples.flights) + 1
    out = np.asarray(jax.random.uniform(split, (flights,))) < 0.1
    held = samples.of(out[samples.flights])
    error = errors(trained.network, held)
    assert card["held out samples"] == len(held)
    assert card["held out mean error, m"] == pytest.approx(np.nanmean(error), rel=1e-6)
    # A tenth of what a prediction of one number would err.
    spread = np.abs(samples.ranges - np.median(samples.ranges)).mean()
    assert card["held out mean error, m"] < 0.1 * spread
    assert len(told) == 2 and told[1].startswith("range: L-BFGS, 500 steps: loss")


@pytest.fixture(scope="module")
def samples_in_space():
    """From places that flights by the networks visit, of another seed than those that
    these have learnt from."""
    scenario = mars.networked()
    # Of the last cycle before the end, for which there was nothing to learn.
    with pytest.warns(UserWarning, match="decisions without prediction, up to 1%"):
        return predict_samples(scenario, independent(), 100, 1500, jax.random.key(7))


@pytest.mark.slow
def test_samples_in_three_dimensions_are_predictions_to_either_side(samples_in_space):
    """From another place, with another heading and to the other side, seen from there."""
    law, samples = in_space().law, samples_in_space
    planet, angle = law.model.planet, law.model.vehicle.trim_angle_of_attack
    predict = eqx.filter_jit(law.predicted)
    for index in range(0, len(samples), len(samples) // 10):
        one = jax.tree.map(jnp.asarray, samples.of(np.array([index])))
        state, factors = jax.tree.map(lambda x: x[0], (one.states, one.factors))
        place = {"longitude": 1.0, "latitude": -0.6, "heading": 0.3 + index}
        place = {name: jnp.asarray(value) for name, value in place.items()}
        state = dataclasses.replace(state, **place)
        sensed = measure(planet, law.model.vehicle, state, angle)
        seen = Measurement(state, sensed.lift, sensed.drag, angle, angle, {})
        sign = jnp.asarray(-1.0)
        end = predict(jnp.asarray(0.0), seen, factors, one.numbers[:1], sign, True)
        ahead, to_the_left = ground_track(planet, state, end.state)
        # Steps are the same; in between is the rounding of some hundred of them.
        assert float(one.ranges[0]) == pytest.approx(float(ahead), rel=1e-7)
        assert float(one.across[0]) == pytest.approx(
            float(to_the_left), rel=1e-7, abs=0.1
        )


@pytest.mark.slow
def test_shipped_networks_in_three_dimensions_are_as_good_as_their_cards_say(
    samples_in_space,
):
    samples = samples_in_space
    law, network = in_space().law, mars.range_network_in_space()
    angle, end = law.model.vehicle.trim_angle_of_attack, law.end.first()

    @eqx.filter_jit
    @jax.vmap
    def asked(state, factors, number):
        return network(law.model, state, angle, factors, number, end)

    given = samples.states, samples.factors, samples.numbers
    answers = asked(*jax.tree.map(jnp.asarray, given))
    known = np.asarray(answers.knows)
    assert known.mean() > 0.98
    near = samples.ranges[known] < 100e3
    for name, found, expected in (
        ("ahead", answers.range, samples.ranges),
        ("across", answers.across, samples.across),
    ):
        _, card = load_network(mars.FOLDER / f"{name}.npz")
        error = np.abs(np.asarray(found) - expected)[known]
        # Means of 10635 and of 1500 errors with long tails.
        assert error.mean() < 1.3 * card["held out mean error, m"]
        assert error[near].mean() < 1.3 * card["held out mean error below 100 km, m"]


@pytest.mark.slow
def test_a_flight_by_the_networks_has_its_derivatives():
    """By density and lift; between reversals, which are discrete."""
    scenario = mars.networked()

    def end(factors):
        given = with_leaf(scenario, lambda s: s.planet.density_scale, factors[0])
        given = with_leaf(given, lambda s: s.vehicle.lift_scale, factors[1])
        flight = jentry.fly(given)
        sides = flight.state.longitude, flight.state.latitude
        return jnp.stack(sides) * scenario.planet.radius

    slopes, differences = along_each(end, [1.02, 0.97], [1e-6, 1e-6])
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=1.0)
    assert np.min(np.max(np.abs(differences), axis=1)) > 1.0


def test_only_predictions_of_a_constant_bank_can_be_learnt():
    def learnt(law):
        scenario = eqx.tree_at(lambda s: s.guidance, in_space(), law)
        predict_samples(scenario, independent(), 100, 100, jax.random.key(0))

    with pytest.raises(ValueError, match="the law is Const.*expected a PredictorCorr"):
        learnt(ConstantBank())
    with pytest.raises(ValueError, match="the range is learnt of a ConstantBankShape"):
        shape = ConstantBankShape(lowest=-0.5)
        learnt(dataclasses.replace(in_space().guidance, shape=shape))
    for change in (turning, windy):
        for law in (in_space().guidance, in_plane().guidance):
            with pytest.raises(
                ValueError, match="learnt that are alike in every direction"
            ):
                learnt(change(law))
