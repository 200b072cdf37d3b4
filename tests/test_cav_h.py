"""The CAV-H mission as the paper flies it, against what its notes expect.

Bounds on dispersed flights hold for any seed. They are taken from 16 sets of 500 runs,
`python benchmarks/populations.py cav-h`: means and medians as so many spreads of a set from
the mean of the sets, outliers as so many as can be by chance where a share of all flights
are. Where a few of the 8000 are, three more are reckoned with.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from first_sets import assert_first_set
from helpers import (
    SPREADS,
    ahead,
    along_each,
    fly_compiled,
    least_by_chance,
    most_by_chance,
    truths,
)
from pages import assert_says

from jentry.addresses import leaves_by_address
from jentry.campaign.campaign import drawn_inputs, monte_carlo
from jentry.flight import Outcome, misses
from jentry.guidance import BezierParameters, FlownModel, ShorteningCycle
from jentry.missions import find_mission
from jentry.missions.cav_h.scenario import constraints, glide, stored
from jentry.onboard import Measurement
from jentry.planning.bezier_curve import k2_polynomial, plan_parameters, velocity_map
from jentry.units import degree


MISSION = find_mission("cav-h")
RUNS = 500
HISTORY = 50.0
"""Of single flights of the same law, which one program flies, s"""
ALL = 16 * RUNS
"""That the bounds are taken from"""


@functools.cache
def flown(variant, reading="normal"):
    """500 dispersed runs and the nominal one, by the same compiled program."""
    scenario = MISSION.scenario_of(variant)
    table = MISSION.dispersion_table(reading)
    drawn = drawn_inputs(scenario, table, jax.random.key(0), np.arange(RUNS))
    nominal = leaves_by_address(scenario)
    inputs = {
        address: np.append(np.asarray(values), float(nominal[address]))
        for address, values in drawn.items()
    }
    campaign = monte_carlo(scenario, inputs=inputs)
    one = jax.tree.map(lambda x: x[-1], (campaign.flights, campaign.misses))
    rest = jax.tree.map(lambda x: x[:-1], campaign)
    assert np.all(rest.flights.outcome == Outcome.REACHED)
    assert_first_set(MISSION.name, variant, reading, scenario, rest)
    return rest, one


@pytest.fixture(scope="module")
def as_printed():
    return flown("stored")


@pytest.mark.slow
@pytest.mark.optimized
def test_nominal_velocity_at_the_target(as_printed):
    """2630 m/s with the guidance cycle of the notes, and the paper's k1 and k2."""
    _, (flight, _) = as_printed
    # As the README has it, to the digits there.
    assert_says("flight ends at 2630.00 m/s", float(flight.state.velocity))


@pytest.mark.slow
@pytest.mark.optimized
def test_position_and_angles_at_the_target(as_printed):
    campaign, _ = as_printed
    missed = campaign.misses
    # One of all 8000 passes the target by 28 m, and with it the heading is off.
    far = np.asarray(missed.distance) > 0.01
    assert np.sum(far) <= most_by_chance(RUNS, (1 + 3) / ALL)
    turned = np.abs(missed.heading) > 0.004 * degree
    assert np.sum(turned) <= most_by_chance(RUNS, (2 + 3) / ALL)
    # The largest of a set is 0.00162 with a spread of 0.00007.
    assert np.max(np.abs(missed.flight_path_angle)) <= 0.002 * degree
    error = np.mean(np.abs(missed.velocity))
    assert error == pytest.approx(140.8, abs=SPREADS * 5.1)


@pytest.mark.slow
@pytest.mark.optimized
def test_no_limit_is_exceeded(as_printed):
    campaign, _ = as_printed
    peaks = campaign.flights.peaks
    assert np.max(peaks.heat_rate) < 2e6
    # 198 kPa in all 8000, and 192.5 in a set, with a spread of 3.7.
    dense = np.asarray(peaks.dynamic_pressure) >= 200e3
    assert np.sum(dense) <= most_by_chance(RUNS, 3 / ALL)
    assert np.max(peaks.load_factor) < 2.0


@pytest.mark.slow
def test_continuous_law():
    """2624.6 m/s: the hold of the command moves the velocity by metres per second."""
    velocity = []
    for period in (0.1, 0.05):
        scenario = glide(
            BezierParameters(0.848, 0.717), cycle=ShorteningCycle(period, shorter=())
        )
        velocity.append(float(fly_compiled(scenario).state.velocity))
    coarse, fine = velocity
    assert abs(fine - 2624.6) < 0.5
    # The difference to the limit halves with the cycle.
    assert_says("hold of a cycle, it ends at 2624.6", 2.0 * fine - coarse)


@pytest.mark.slow
def test_adjusted_once():
    """Equation (38), with the velocity predicted by flying the model."""
    campaign, (flight, _) = flown("adjusted-once")
    error = np.abs(campaign.misses.velocity)
    assert np.mean(error) <= 6.24 + SPREADS * 0.50
    assert np.median(error) <= 2.43 + SPREADS * 0.10
    # Those that are beyond what k2 can do.
    assert np.sum(error > 20.0) <= most_by_chance(RUNS, 326 / ALL)
    # The nominal flight is left as it is.
    assert float(flight.state.velocity) == pytest.approx(2630.0, abs=0.2)


@pytest.mark.slow
def test_the_variants_differ_in_their_epochs():
    """The paper's adjusts at the first cycle alone; the tables are the same."""
    once, at_epochs = (
        MISSION.scenario(f"adjusted-{name}").guidance.velocity_control
        for name in ("once", "at-epochs")
    )
    assert once.epochs.every is None and at_epochs.epochs.every == 25
    assert once.epochs.last == at_epochs.epochs.last == 60.0
    assert float(once.nominal_k2) == 0.717
    same = dataclasses.replace(at_epochs, epochs=once.epochs)
    assert eqx.tree_equal(once, same)
    # The nominal k2 is kept; far from the target more k2 is less velocity.
    np.testing.assert_allclose(once.polynomials[:, 0], 0.717, rtol=1e-12)
    assert np.all(np.asarray(once.polynomials[-20:, 1]) < 0.0)
    assert np.all(np.diff(once.to_go) > 0.0)


@pytest.mark.slow
def test_the_polynomial_gives_back_the_k2_that_was_flown():
    """At the entry: of the velocity that the model reaches with a k2, that k2."""
    law = MISSION.scenario("adjusted-once").guidance
    control = law.velocity_control
    start = stored().initial_state
    _, held = law.init(Measurement(start, *4 * [jnp.asarray(0.0)]))

    @jax.jit
    def reached(k2):
        moved = eqx.tree_at(lambda d: d.shape.second, held, k2)
        return FlownModel().predict(
            law.glide(constraints()), law.situation(start, moved)
        )

    np.testing.assert_allclose(control.to_go[-1], 55.9067 * degree, rtol=1e-8)
    nominal = float(reached(jnp.asarray(0.717)))
    assert float(control.nominal_velocity[-1]) == pytest.approx(nominal, abs=1e-6)
    p0, p1, p2 = np.asarray(control.polynomials[-1])
    for k2 in (0.6, 0.8):
        x = (float(reached(jnp.asarray(k2))) - nominal) / 100.0
        # What a quadratic leaves of nine values from 0.417 to 1.017.
        assert p0 + x * (p1 + x * p2) == pytest.approx(k2, abs=0.02)


@pytest.mark.optimized
@pytest.mark.slow
def test_the_printed_inversion_loses_flights():
    """An unknown lift factor of 10 % loses more than a third of them: 2951 of 8000."""
    scenario = MISSION.scenario("model-inversion")
    table = MISSION.dispersion_table("normal")
    campaign = monte_carlo(scenario, table, jax.random.key(0), RUNS)
    # The lost flights hang on rounding: with other options of XLA 71 of the 500 end more
    # than 1 mm/s off, up to 13 m/s, and on another processor the median moves by 0.34 %.
    assert_first_set(
        MISSION.name, "model-inversion", "normal", scenario, campaign, rel=5e-3
    )
    lost = int(np.sum(np.asarray(campaign.flights.outcome) != Outcome.REACHED))
    share = 2951 / ALL
    assert least_by_chance(RUNS, share) <= lost <= most_by_chance(RUNS, share)


@pytest.mark.slow
def test_any_heading_and_place_flies_the_same():
    """The whole scene turned on the globe: the same flight, to rounding."""
    scenario = stored()
    start = scenario.initial_state
    # Over the pole: from 70 degrees north at a heading of 20 degrees.
    latitude, heading = 70 * degree, 20 * degree
    longitude, target, arrival = np.radians(ahead((0.0, 70.0), 20.0, 55.9067))
    numbers = [jnp.asarray(x) for x in (latitude, heading, arrival, longitude, target)]
    latitude, heading, arrival, longitude, target = numbers
    track = dataclasses.replace(
        scenario.guidance.track,
        start_latitude=latitude,
        target_longitude=longitude,
        target_latitude=target,
    )
    turned = eqx.tree_at(
        lambda s: (
            s.initial_state.latitude,
            s.initial_state.heading,
            s.guidance.track,
            s.guidance.arrival.heading,
            s.termination.conditions["target"].track,
        ),
        scenario,
        (latitude, heading, track, arrival, track),
    )
    ends = [fly_compiled(s, history=HISTORY).state for s in (scenario, turned)]
    for name in ("velocity", "altitude", "flight_path_angle"):
        # Rounding of sines near the pole, over 1800 guidance cycles.
        assert float(getattr(ends[1], name)) == pytest.approx(
            float(getattr(ends[0], name)), rel=1e-7
        )
    assert float(ends[1].latitude) == pytest.approx(float(target), abs=1e-9)
    assert float(start.latitude) == 0.0


@pytest.mark.slow
def test_history_is_on_one_clock_while_the_cycles_become_shorter():
    flight = fly_compiled(stored(), history=HISTORY)
    time = np.asarray(flight.history.time)
    there = np.isfinite(time)
    expected = np.arange(0.0, float(flight.time), HISTORY)
    np.testing.assert_allclose(time[there], expected, atol=1e-6)
    durations = np.asarray(flight.history.decisions.duration)[there]
    assert durations[0] == 1.0 and durations[-1] == 0.1
    error = misses(stored(), flight)
    assert float(error.distance) < 0.01


@pytest.mark.slow
def test_gradient_through_the_flight_matches_differences():
    """k1 and k2 to the velocity at the target: what the planner follows."""
    scenario = stored()

    def velocity(k):
        given = eqx.tree_at(
            lambda s: s.guidance.parameters, scenario, BezierParameters(k[0], k[1])
        )
        return fly_compiled(given).state.velocity

    k = jnp.array([0.848, 0.717])
    forward, differences = along_each(velocity, k, [1e-6, 1e-6])
    reverse = eqx.filter_jit(jax.grad(velocity))(k)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8)  # rounding, there and back
    np.testing.assert_allclose(forward, differences, rtol=1e-5)


@pytest.mark.slow
def test_planned_parameters_fly_the_wanted_velocity():
    planned = plan_parameters(stored(), 2700.0)
    assert float(planned.k1) == 0.848
    scenario = eqx.tree_at(lambda s: s.guidance.parameters, stored(), planned)
    flight = fly_compiled(scenario, history=HISTORY)
    assert float(flight.state.velocity) == pytest.approx(2700.0, abs=2e-3)


@pytest.mark.slow
def test_no_parameters_for_a_velocity_out_of_reach():
    with pytest.raises(ValueError, match="no curve was found that ends at 6000 m/s"):
        plan_parameters(stored(), 6000.0)


@pytest.mark.slow
def test_map_and_polynomial_are_those_of_the_paper():
    """Figure 10, and (37) as far as its own dependence on the grid of k2 goes."""
    k2 = np.linspace(0.3, 1.0, 15)
    flown = velocity_map(stored(), np.array([0.8, 0.848]), k2)
    # The velocity rises with k1 and falls with k2.
    assert np.all(np.diff(flown.velocity, axis=0) > 0.0)
    assert np.all(np.diff(flown.velocity, axis=1) < 0.0)
    printed = truths("zhou.csv")["polynomial"]
    some = slice(5, 13)  # 0.55 to 0.9
    assert k2[some][[0, -1]] == pytest.approx([0.55, 0.9])
    # As the function and the README say, half a digit to either side.
    said = (
        (some, (2.81e-7, -0.00240, 5.10)),
        (slice(2, None), (2.53e-7, -0.00226, 4.92)),
        (slice(None), (2.09e-7, -0.00204, 4.63)),
    )
    for where, expected in said:
        found = k2_polynomial(flown.velocity[1][where], k2[where])
        for value, printed_value, half in zip(
            found, expected, (5e-10, 5e-6, 5e-3), strict=True
        ):
            assert value == pytest.approx(printed_value, abs=half)
        assert found == pytest.approx(list(printed.values()), rel=0.25)
    # The narrower one goes through the nominal flight.
    a, b, c = k2_polynomial(flown.velocity[1][some], k2[some])
    assert a * 2630.0**2 + b * 2630.0 + c == pytest.approx(0.717, abs=2e-3)


def test_polynomial_takes_three_flights():
    with pytest.raises(ValueError, match="2 flights reached the target"):
        k2_polynomial(np.array([2600.0, np.nan, 2700.0]), np.array([0.6, 0.7, 0.8]))
