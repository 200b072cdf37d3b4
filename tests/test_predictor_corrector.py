"""The predictor-corrector: its shapes, its steps, its predictions, and its flights."""

import dataclasses
import functools
import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    ahead,
    along_each,
    fly_compiled,
    mars_entry,
    predictor_corrector,
    with_leaf,
)
from scipy.integrate import solve_ivp
from scipy.optimize import lsq_linear

from jentry._computed_once import computed_once
from jentry.campaign import monte_carlo
from jentry.flight import FixedStep, Outcome, fly, misses
from jentry.guidance import (
    Aim,
    AngleOfAttackProfile,
    BankProfile,
    ConstantBankShape,
    GivenBankShape,
    GuidedEnd,
    LinearBankShape,
    TwoEndedBankShape,
    compose,
)
from jentry.guidance.bounded_step import least_squares_step
from jentry.guidance.lateral import PredictedCrossrange
from jentry.guidance.path_limits import PathLimits
from jentry.guidance.predictor_corrector import _End, _with_effects
from jentry.missions import find_mission
from jentry.missions.mars import predictor_corrector as mars
from jentry.missions.mars.drag_tracking import entry, independent
from jentry.missions.x_33.predictor_corrector import guided as x_33
from jentry.motion import EntryState, Response, SecondOrderAttitude, Swing
from jentry.onboard import BankTurning, Factors, PolynomialProfile, measure
from jentry.units import degree, km


def number(x):
    return jnp.asarray(float(x))


# Shapes


def test_constant_bank_goes_from_the_largest_to_wings_level():
    shape = ConstantBankShape(lowest=math.cos(100 * degree))
    for share, cosine in ((0.0, math.cos(100 * degree)), (1.0, 1.0)):
        found = shape.cos_bank(jnp.array([share]), number(3.0), number(0.0))
        assert float(found) == pytest.approx(cosine, abs=1e-15)


def test_linear_bank_is_a_line_of_the_angle_over_the_index():
    shape = LinearBankShape(end=2.0, final=60 * degree, largest=80 * degree)
    # A quarter of the way to wings level: 60 degrees now at 10, and 60 at the end.
    level = shape.cos_bank(jnp.array([0.25]), number(6.0), number(10.0))
    assert float(level) == pytest.approx(math.cos(60 * degree), abs=1e-15)
    # 20 degrees now: half of the way at 6, and all of it at the end and beyond.
    numbers = jnp.array([0.75])
    for index, angle in ((12.0, 20), (10.0, 20), (6.0, 40), (2.0, 60), (1.0, 60)):
        found = shape.cos_bank(numbers, number(index), number(10.0))
        assert float(found) == pytest.approx(math.cos(angle * degree), abs=1e-15)
    at_end = shape.cos_bank(numbers, number(2.0), number(2.0))
    assert float(at_end) == pytest.approx(math.cos(60 * degree), abs=1e-15)


def test_both_ends_of_a_bank_are_free():
    shape = TwoEndedBankShape(
        end=2.0, final=60 * degree, largest=80 * degree, first=0.5
    )
    np.testing.assert_allclose(shape.numbers, [0.5, 0.25], rtol=1e-14)
    found = shape.cos_bank(jnp.array([0.75, 0.25]), number(6.0), number(10.0))
    assert float(found) == pytest.approx(math.cos(40 * degree), abs=1e-15)


@pytest.mark.parametrize(
    ("share", "cosine"), [(0.0, 0.6), (1.0, 1.0), (0.5, 0.8), (-1.0, -0.2), (-0.5, 0.2)]
)
def test_given_bank_is_moved_to_either_side(share, cosine):
    shape = GivenBankShape(PolynomialProfile([0.6]), lowest=-0.2)
    found = shape.cos_bank(jnp.array([share]), number(1.0), number(0.0))
    assert float(found) == pytest.approx(cosine, abs=1e-15)


# Steps


def test_step_of_two_numbers_is_the_best_between_its_bounds():
    rng = np.random.default_rng(5)
    stepped = jax.jit(least_squares_step)
    on_edge = 0
    for _ in range(200):
        misses_, effects = rng.normal(size=2), rng.normal(size=(2, 2))
        lower, upper = -rng.uniform(0.0, 1.0, 2), rng.uniform(0.0, 1.0, 2)
        found = stepped(*(jnp.asarray(x) for x in (misses_, effects, lower, upper)))
        best = lsq_linear(effects, -misses_, (lower, upper), tol=1e-14)
        left = np.sum((misses_ + effects @ np.asarray(found)) ** 2)
        # Not above what scipy finds, but for the tolerance of its own search.
        assert left <= 2.0 * best.cost + 1e-9
        assert np.all(found >= lower) and np.all(found <= upper)
        on_edge += best.cost > 1e-12
    assert 50 < on_edge < 199


def test_step_of_one_number_is_newtons_within_its_bounds():
    effects = jnp.array([[2.0]])
    for miss, step in ((-0.4, 0.2), (-4.0, 0.3), (4.0, -0.1)):
        found = least_squares_step(
            jnp.array([miss]), effects, jnp.array([-0.1]), jnp.array([0.3])
        )
        assert float(found[0]) == pytest.approx(step, abs=1e-15)


def test_a_number_without_effect_stays_where_it_is_best():
    # The second number moves nothing: the first one does what can be done.
    found = least_squares_step(
        jnp.array([1.0, 0.0]),
        jnp.array([[2.0, 0.0], [0.0, 0.0]]),
        jnp.array([-1.0, -1.0]),
        jnp.array([1.0, 1.0]),
    )
    assert float(found[0]) == pytest.approx(-0.5, abs=1e-15)
    assert np.all(np.isfinite(found))


# Predictions


@computed_once
def in_plane():
    return find_mission("mars-range-tracking").scenario(
        "predictor-corrector", world="in-plane"
    )


@computed_once
def in_space():
    return mars.guided()


def start_of(scenario):
    law = scenario.law
    angle = scenario.vehicle.trim_angle_of_attack
    return measure(law.model.planet, law.model.vehicle, scenario.initial_state, angle)


@eqx.filter_jit
def predicted(
    law, seen, numbers, sign, in_space, factors=Factors(), reverses_in=math.inf
):
    zero = 0.0 * seen.drag
    return law.predicted(zero, seen, factors, numbers, sign, in_space, reverses_in)


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


@pytest.mark.slow
def test_a_flight_has_its_derivatives_where_reversals_are_foreseen():
    """By density and lift, through sensed banks and what is expected of reversals."""
    reach = Response(1.0, 1.0, 10.0 * degree, 5.0 * degree, -math.pi, math.pi)
    attitude = SecondOrderAttitude(dataclasses.replace(reach, frequency=2.0), reach)
    law = dataclasses.replace(
        in_space().guidance,
        corrections=1,
        turning=BankTurning(10.0 * degree, 5.0 * degree),
        lateral=PredictedCrossrange(factor=3.0, foresees=True),
    )
    scenario = dataclasses.replace(in_space(), guidance=law, attitude=attitude)

    def end(factors):
        given = with_leaf(scenario, lambda s: s.planet.density_scale, factors[0])
        given = with_leaf(given, lambda s: s.vehicle.lift_scale, factors[1])
        flight = fly(given)
        sides = flight.state.longitude, flight.state.latitude
        return jnp.stack(sides) * scenario.planet.radius

    slopes, differences = along_each(end, [1.02, 0.97], [1e-6, 1e-6])
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=1.0)
    assert np.min(np.max(np.abs(differences), axis=1)) > 1.0


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


def decided(law, seen, numbers):
    _, held = law.init(seen)
    held = dataclasses.replace(held, numbers=jnp.asarray(numbers))
    return law.update(0.0 * seen.drag, seen, (), held)[1]


after = eqx.filter_jit(decided)


@functools.cache
def underway():
    """The nominal flight, and what is measured after 80 s of it."""
    flight = fly_compiled(in_plane(), FixedStep(), 10.0)
    state = jax.tree.map(lambda x: x[8], flight.history.states)
    model = in_plane().law.model
    angle = in_plane().vehicle.trim_angle_of_attack
    return flight, measure(model.planet, model.vehicle, state, angle)


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
        ({"foresees_limits": True}, "limits is None"),
        (
            {"foresees_limits": True, "limits": PathLimits(), "step": 3.0},
            "step is 3.0 s and the guidance cycle 2.0 s",
        ),
    ],
)
def test_what_cannot_predict_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        dataclasses.replace(predictor_corrector(), **changes)


def test_a_plane_over_a_planet_that_turns_is_that_of_the_great_circle():
    """By scipy: polar coordinates in the plane, of the air that turns with the planet."""
    mission = find_mission("cav-h-glide").scenario("undamped")
    planet, craft, law = mission.planet, mission.vehicle, mission.law
    turns, heading, latitude = float(planet.rotation_rate), 1.1, 0.5
    state = dataclasses.replace(
        mission.initial_state,
        altitude=jnp.asarray(46e3),
        latitude=jnp.asarray(latitude),
        velocity=jnp.asarray(6000.0),
        flight_path_angle=jnp.asarray(-1e-3),
        heading=jnp.asarray(heading),
    )
    seen = measure(planet, craft, state, craft.trim_angle_of_attack)
    law = dataclasses.replace(law, step=4.0, steps=600)
    found = predicted(law, seen, jnp.array([0.25]), 1.0, False)
    # The axis of the great circle, by vectors: longitude zero is as good as any.
    here = np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    north = np.array([-np.sin(latitude), 0.0, np.cos(latitude)])
    axis = np.cross(
        here, np.sin(heading) * np.array([0, 1, 0]) + np.cos(heading) * north
    )
    rate, area = turns * axis[2], float(craft.reference_area / craft.mass)
    radius = float(planet.radius)
    parameter = float(planet.gravity.gravitational_parameter)
    lift, drag = (
        float(getattr(craft.aerodynamics, f"{n}_coefficient")) for n in ("lift", "drag")
    )
    last = float(law.end.energy)
    first = 0.5 * 6000.0**2 - parameter / (radius + 46e3)

    def relative(y):
        return np.array([y[2], y[0] * (y[3] - rate)])

    def energy(y):
        return 0.5 * np.sum(relative(y) ** 2) - parameter / y[0]

    def slope(_, y):
        rise, along = relative(y)
        speed, density = (
            np.hypot(rise, along),
            1.225 * np.exp(-0.14e-3 * (y[0] - radius)),
        )
        share = (energy(y) - first) / (last - first)
        bank = np.pi / 2 * 0.75 + share * (np.pi / 3 - np.pi / 2 * 0.75)
        push = 0.5 * density * speed * area
        up = push * (lift * np.cos(bank) * along - drag * rise)
        ahead = push * (-lift * np.cos(bank) * rise - drag * along)
        climbs = up - parameter / y[0] ** 2 + y[0] * y[3] ** 2
        return [y[2], y[3], climbs, (ahead - 2.0 * y[2] * y[3]) / y[0]]

    def spent(_, y):
        return energy(y) - last

    spent.terminal = True
    level = 6000.0 * np.cos(1e-3)
    start = [radius + 46e3, 0.0, -6000.0 * np.sin(1e-3), rate + level / (radius + 46e3)]
    solved = solve_ivp(
        slope, (0, 2400), start, method="DOP853", rtol=1e-10, atol=1e-12, events=spent
    )
    end = solved.y[:, -1]
    # Steps of 4 s, of fourth order.
    assert float(found.time) == pytest.approx(solved.t[-1], rel=1e-5)
    along = end[1] - rate * solved.t[-1]
    assert float(found.state.longitude) == pytest.approx(along, rel=1e-5)
    assert float(found.state.altitude) == pytest.approx(end[0] - radius, abs=10.0)
    still = with_leaf(law, lambda law: law.model.planet.rotation_rate, 0.0)
    found = predicted(still, seen, jnp.array([0.25]), 1.0, False)
    assert float(found.state.longitude) < 0.97 * along


def test_an_end_must_be_given():
    with pytest.raises(ValueError, match="no velocity, no altitude and no energy"):
        GuidedEnd(ceiling=1e5)


# Flights


def test_nominal_flight_ends_at_its_target():
    miss = misses(in_plane(), underway()[0])
    assert abs(float(miss.downrange)) < 0.1
    assert int(underway()[0].outcome) == Outcome.REACHED


@functools.cache
def campaign():
    return monte_carlo(in_plane(), independent(), jax.random.key(0), 64)


@pytest.mark.slow
def test_every_vehicle_that_can_reach_the_target_does():
    flown = monte_carlo(entry(), independent(), jax.random.key(0), 64)
    reaches = flown.misses.downrange > 0.0
    assert 55 <= np.sum(reaches) < 64
    off = np.abs(campaign().misses.downrange)
    assert np.max(off[reaches]) < 1.0
    # The others come nearly as near as with all of their lift up, from the start on.
    lost = (flown.misses.downrange - campaign().misses.downrange)[~reaches]
    assert np.all(np.abs(lost) < 150.0)


@pytest.mark.slow
def test_a_run_of_a_campaign_is_the_flight_alone():
    flown = campaign()
    for i in (3, 40):
        alone = in_plane()
        for address, values in flown.inputs.items():
            where = functools.partial(_at, address)
            alone = with_leaf(alone, where, values[i])
        ended = misses(alone, fly(alone))
        assert float(ended.altitude) == pytest.approx(
            float(flown.misses.altitude[i]), abs=1e-3
        )


def _at(address, scenario):
    for name in address.split("."):
        scenario = getattr(scenario, name)
    return scenario


@pytest.mark.slow
def test_derivative_through_all_predictions_is_that_of_differences():
    """Of the duration: the range is met whatever the vehicle is, and here the altitude."""
    scenario = in_plane()

    def duration(mass):
        return fly(with_leaf(scenario, lambda s: s.vehicle.mass, mass)).time

    pushed = jax.jit(lambda mass: jax.jvp(duration, (mass,), (jnp.ones(()),)))
    at, step = 1000.0, 0.05
    _, slope = pushed(number(at))
    beside = [float(pushed(number(at + x * step))[0]) for x in (1, -1, 0.5, -0.5)]
    wide, narrow = (beside[0] - beside[1]) / (2 * step), (beside[2] - beside[3]) / step
    numeric = narrow + (narrow - wide) / 3.0
    assert numeric < -0.05
    # Rounding of 222 s over 0.05 kg.
    assert float(slope) == pytest.approx(numeric, rel=1e-6)
    pulled = jax.jit(jax.grad(duration))(number(at))
    assert float(pulled) == pytest.approx(float(slope), rel=1e-9)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*decisions without prediction")
def test_the_memory_of_the_factors_is_tuned(monkeypatch):
    """`tune` compares the gradient with a difference first, and would warn."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
    import mars_reach

    found = mars_reach.tuned(runs=32, held_out=128, steps=6)
    assert float(found.values[mars_reach.MEMORY]) < 5.0
    std = mars_reach.downrange_std(found.judgement)
    assert std.after.value < 0.8 * std.before.value
    assert std.change.high < 0.0


@pytest.mark.parametrize("in_turn", [False, True])
@pytest.mark.parametrize("count", [1, 2])
def test_effects_are_how_each_number_changes_the_misses(count, in_turn):
    def missed(numbers):
        both = jnp.stack([numbers[0] ** 3, numbers[0] * numbers[-1] ** 2])
        end = _End(numbers[0] > 1.0, numbers[0] > 2.0)
        return both[:count], end

    numbers = jnp.array([1.5, -0.7])[:count]
    misses, effects, end = _with_effects(missed, numbers, in_turn)
    a, b = 1.5, -0.7
    known = np.array([[3.0 * a**2, 0.0], [b**2, 2.0 * a * b]])[:count, :count]
    np.testing.assert_allclose(effects, known, rtol=1e-14)
    np.testing.assert_allclose(misses, [a**3, a * b**2][:count], rtol=1e-14)
    assert bool(end.is_there) and not bool(end.skips)
