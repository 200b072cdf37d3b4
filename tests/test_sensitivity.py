"""Derivatives of a flight, and spreads predicted from them."""

import functools

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, mars_scenario, with_leaf
from pages import assert_says

from jentry.analysis import linear_covariance, sensitivity
from jentry.campaign import Constant, Dispersion, Normal, Uniform, add, monte_carlo
from jentry.campaign.dispersions import draw, scaled_dispersions
from jentry.flight import misses
from jentry.missions import find_mission
from jentry.units import degree


def miss_of(scenario):
    return misses(scenario, fly_compiled(scenario, cheap.SOLVER))


def two(s):
    return s.planet.density_scale, s.initial_state.flight_path_angle


def found(mode=None, outputs=misses):
    return sensitivity(cheap.scenario(), outputs, two, solver=cheap.SOLVER, mode=mode)


@pytest.mark.slow
def test_jacobian_matches_differences():
    result = found()
    for address, step in (
        ("planet.density_scale", 1e-4),
        ("initial_state.flight_path_angle", 1e-5),
    ):
        ends = []
        for sign in (1.0, -1.0):
            inputs = {a: np.atleast_1d(_leaf(a)) for a in result.jacobian["downrange"]}
            inputs[address] = inputs[address] + sign * step
            campaign = monte_carlo(cheap.scenario(), inputs=inputs, solver=cheap.SOLVER)
            ends.append(campaign.misses)
        for name, by_address in result.jacobian.items():
            up, down = (getattr(end, name)[0] for end in ends)
            # Steps of 1 s are coarse: the third derivative of what they make of it.
            np.testing.assert_allclose(
                by_address[address], (up - down) / (2.0 * step), rtol=2e-4, atol=1e-3
            )


def _leaf(address):
    part, name = address.split(".")
    return float(getattr(getattr(cheap.scenario(), part), name))


@pytest.mark.slow
def test_modes_agree_and_values_are_those_of_the_flight():
    forward, reverse = found("forward"), found("reverse")
    here = miss_of(cheap.scenario())
    for name, by_address in forward.jacobian.items():
        assert forward.values[name] == pytest.approx(float(getattr(here, name)))
        for address, slope in by_address.items():
            # Rounding; the velocity does not move where it ends the flight.
            np.testing.assert_allclose(
                reverse.jacobian[name][address], slope, rtol=1e-9, atol=1e-6
            )


def end_time(scenario, flight):
    return flight.time


@pytest.mark.slow
def test_one_number_and_one_table():
    result = found(outputs=end_time)
    assert list(result.values) == ["output"]
    assert result.ended_by in cheap.scenario().termination.names


@pytest.mark.slow
def test_the_initial_state_is_the_default_without_what_has_no_effect():
    result = sensitivity(mars_scenario(), solver=cheap.SOLVER)
    addresses = list(result.jacobian["downrange"])
    assert "initial_state.velocity" in addresses
    assert "initial_state.latitude" not in addresses
    # The entry point moves the vehicle and not the target: 1 rad is one radius.
    longitude = result.jacobian["downrange"]["initial_state.longitude"]
    assert longitude == pytest.approx(3397e3, rel=1e-9)


def distance(scenario, flight):
    return jnp.sqrt(0.0 * flight.time)


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (lambda s: s.initial_state.velocity, 400.0, "began where an end condition"),
        (lambda s: s.initial_state.latitude, 0.5 * np.pi, "singular over the poles"),
        (lambda s: s.vehicle.mass, 1e-300, "numbers were no longer finite"),
    ],
)
def test_a_flight_without_an_end_has_no_derivatives(where, value, message):
    scenario = with_leaf(cheap.scenario(), where, value)
    with pytest.raises(ValueError, match=message):
        sensitivity(scenario, misses, two, solver=cheap.SOLVER, mode="forward")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wrt": lambda s: ()}, "a lens reaches no leaf"),
        ({"mode": "both"}, "mode is 'both'"),
        ({"outputs": distance}, "derivative of output to .* is not finite"),
    ],
)
def test_what_has_no_derivative_is_an_error(options, message):
    with pytest.raises(ValueError, match=message):
        sensitivity(cheap.scenario(), solver=cheap.SOLVER, **options)


# Linear covariance.


def table():
    return {
        "mass": Dispersion(lambda s: s.vehicle.mass, Normal(0.0, 4.0), apply=add),
        "path": Dispersion(
            lambda s: s.initial_state.flight_path_angle,
            Uniform(-0.02 * degree, 0.02 * degree),
            apply=add,
        ),
    }


@functools.cache
def analysed(corner: bool):
    scenario = at_corner() if corner else cheap.scenario()
    return linear_covariance(
        scenario,
        scaled_dispersions(table(), 0.1),
        key=jax.random.key(2),
        runs=256,
        solver=cheap.SOLVER,
    )


@functools.cache
def at_corner():
    """The altitude of the nominal end is made an end condition as well."""
    flight = fly_compiled(cheap.scenario(), cheap.SOLVER)
    return with_leaf(
        cheap.scenario(),
        lambda s: s.termination.conditions["ground"].altitude,
        float(flight.state.altitude),
    )


@pytest.mark.slow
def test_one_end_condition_is_plain_linear_covariance():
    """The root of the sum of squares of derivative times standard deviation."""
    analysis = analysed(False)
    (model,) = analysis.models.values()
    slopes = sensitivity(
        cheap.scenario(),
        wrt=lambda s: (s.vehicle.mass, s.initial_state.flight_path_angle),
        solver=cheap.SOLVER,
    ).jacobian
    deviations = {
        "vehicle.mass": 0.4,
        "initial_state.flight_path_angle": 0.004 * degree / np.sqrt(12.0),
    }
    for name in ("downrange", "altitude"):
        expected = np.sqrt(
            sum((slopes[name][a] * d) ** 2 for a, d in deviations.items())
        )
        spread = analysis.spreads[name]
        # A standard deviation of 100 000 draws.
        assert spread.standard_deviation == pytest.approx(expected, rel=0.01)
        # What is not linear at a tenth of these dispersions.
        assert spread.ratio == pytest.approx(1.0, abs=2e-3)
    assert analysis.runs == 256 and analysis.failed == 0 and not analysis.without_model


@pytest.mark.slow
def test_on_the_bend_of_two_end_conditions_both_are_needed():
    """There the plain one is wrong by tens of per cent, however small the dispersions."""
    analysis = analysed(True)
    assert set(analysis.models) == {"ground", "velocity"}
    for name in ("downrange", "altitude", "velocity"):
        assert analysis.spreads[name].ratio == pytest.approx(1.0, abs=0.01)
    plain = analysed(False).spreads["altitude"].standard_deviation
    both = analysis.spreads["altitude"].standard_deviation
    assert both < 0.8 * plain


SHALLOW = 20.0
"""Slope over the path on one side of the corner; 1 on the other"""


def with_bend(scenario, flight):
    """An output with a corner where the end changes, as that of a law that plans for it."""
    away = scenario.initial_state.flight_path_angle - _leaf(
        "initial_state.flight_path_angle"
    )
    return {"bend": jnp.where(away > 0.0, SHALLOW * away, away)}


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["exact", "difference"])
def test_each_end_has_its_slopes_where_the_flights_end_by_it(mode):
    """The derivative of the nominal flight is that of one side, for both ends."""
    path = {"path": table()["path"]}
    given = {"key": jax.random.key(2), "solver": cheap.SOLVER, "mode": mode}
    analysis = linear_covariance(at_corner(), path, with_bend, **given)
    assert set(analysis.models) == {"ground", "velocity"}
    slopes = sorted(m.slopes["bend"]["path"] for m in analysis.models.values())
    half = 0.02 * degree
    one = half / np.sqrt(3.0)
    assert slopes == pytest.approx([one, SHALLOW * one], rel=1e-6)
    # The mean and the mean square of a line on each half of the draws.
    mean = 0.25 * half * (SHALLOW - 1.0)
    by_hand = np.sqrt((1.0 + SHALLOW**2) * half**2 / 6.0 - mean**2)
    # A standard deviation of 100 000 draws.
    spread = analysis.spreads["bend"].standard_deviation
    assert spread == pytest.approx(by_hand, rel=0.01)


@pytest.mark.slow
def test_spread_is_the_root_of_the_sum_of_squares_of_the_slopes():
    """Slopes per standard deviation, which the flown effects confirm below."""
    analysis = analysed(False)
    (model,) = analysis.models.values()
    for name in ("downrange", "altitude"):
        slopes = np.array(list(model.slopes[name].values()))
        spread = analysis.spreads[name]
        # A standard deviation of 100 000 draws: 2e-3, and four times that.
        expected = np.sqrt(np.sum(slopes**2))
        assert spread.standard_deviation == pytest.approx(expected, rel=0.01)
        assert spread.mean == pytest.approx(model.values[name], abs=0.02 * expected)
        assert spread.nominal == pytest.approx(model.values[name], rel=1e-9)
        for dispersion, slope in model.slopes[name].items():
            linear = analysis.effects[name][dispersion].linear
            assert linear == pytest.approx(slope, rel=1e-9)


@pytest.mark.slow
def test_effects_of_each_dispersion_are_flown_as_predicted():
    for by_dispersion in analysed(False).effects.values():
        for effect in by_dispersion.values():
            assert effect.linear == pytest.approx(effect.flown, rel=2e-3, abs=1e-6)


PERIOD, STEEP = 0.02, 30.0
"""Of a sawtooth (s), far shorter than the end time varies; and its slope"""


def with_constant():
    """A table as missions have them: with a number that is not drawn."""
    lift = Dispersion(lambda s: s.vehicle.lift_scale, Constant(1.0))
    return table() | {"lift": lift}


def with_teeth(scenario, flight):
    return {"end": flight.time, "teeth": flight.time + STEEP * (flight.time % PERIOD)}


@functools.cache
def of_teeth(mode):
    return linear_covariance(
        cheap.scenario(),
        with_constant(),
        with_teeth,
        key=jax.random.key(2),
        runs=256,
        solver=cheap.SOLVER,
        mode=mode,
    )


@pytest.mark.slow
def test_a_dispersion_that_is_constant_spoils_no_prediction():
    """Of a table that has one, as that of cav-h has; its draws have no deviation."""
    for mode in (None, "difference"):
        spread = of_teeth(mode).spreads["end"]
        # What is not linear.
        assert spread.ratio == pytest.approx(1.0, abs=0.02)
        assert spread.standard_deviation > 0.0


@pytest.mark.slow
def test_mean_differences_go_across_the_teeth_that_derivatives_see_alone():
    """As the phase of the last guidance cycle makes them."""
    exact, mean = of_teeth(None), of_teeth("difference")
    assert exact.spreads["teeth"].ratio > 10.0
    flown = mean.spreads["teeth"]
    end = mean.spreads["end"]
    # The mean slope is that of what the teeth stand on; they are spread evenly.
    teeth = STEEP * PERIOD / np.sqrt(12.0)
    by_hand = np.hypot(end.flown_standard_deviation, teeth)
    # Of 256 flights, 4.4 % in the mean.
    assert flown.flown_standard_deviation == pytest.approx(by_hand, rel=0.2)
    (model,) = mean.models.values()
    for name, slope in model.slopes["end"].items():
        if name == "lift":
            continue
        lacking = model.slopes["teeth"][name] - slope
        # A mean of 64 differences of two teeth, over two; four standard errors.
        assert abs(lacking) < 4.0 * teeth / np.sqrt(2.0 * 64)
        assert abs(lacking) < 4.0 * np.hypot(
            model.errors["teeth"][name], model.errors["end"][name]
        )


@pytest.mark.slow
def test_mean_differences_are_derivatives_where_nothing_jumps():
    """And those of flights that are flown one by one."""
    (exact,) = of_teeth(None).models.values()
    (mean,) = of_teeth("difference").models.values()
    assert exact.errors["end"] == {"mass": 0.0, "path": 0.0, "lift": 0.0}
    assert mean.slopes["end"]["lift"] == mean.errors["end"]["lift"] == 0.0
    slopes = {n: slope for n, slope in exact.slopes["end"].items() if n != "lift"}
    for name, slope in slopes.items():
        # What is not linear over two standard deviations.
        assert mean.slopes["end"][name] == pytest.approx(slope, rel=0.05)
        assert 0.0 < mean.errors["end"][name] < 0.1 * abs(slope)
    assert mean.time_slope == mean.slopes["end"]
    draws = {n: np.asarray(x) for n, x in _others().items()}
    times = []
    for sign in (1.0, -1.0):
        path = draws["path"] + _leaf("initial_state.flight_path_angle")
        inputs = {
            "vehicle.mass": np.full(64, _leaf("vehicle.mass") + 4.0 * sign),
            "initial_state.flight_path_angle": path,
        }
        campaign = monte_carlo(cheap.scenario(), inputs=inputs, solver=cheap.SOLVER)
        times.append(campaign.flights.time)
    each = 0.5 * (times[0] - times[1])
    assert mean.slopes["end"]["mass"] == pytest.approx(np.mean(each), rel=1e-9)
    error = np.std(each, ddof=1) / 8.0
    assert mean.errors["end"]["mass"] == pytest.approx(error, rel=1e-6)


def _others():
    """Draws of what is not moved itself."""
    key = jax.random.fold_in(jax.random.key(2), 2)
    return jax.vmap(lambda run: draw(with_constant(), key, run))(jnp.arange(64))


@pytest.mark.slow
def test_what_the_nominal_flight_never_meets_is_told():
    """Flights that skip out through the ceiling, of a nominal one that does not."""
    wide = {
        "path": Dispersion(
            lambda s: s.initial_state.flight_path_angle,
            Uniform(-1.0 * degree, 8.0 * degree),
            apply=add,
        )
    }
    shallow = with_leaf(
        cheap.scenario(), lambda s: s.initial_state.flight_path_angle, -14.4 * degree
    )
    analysis = linear_covariance(
        shallow, wide, key=jax.random.key(0), runs=128, solver=cheap.SOLVER
    )
    ends = {*analysis.models, *analysis.without_model}
    assert len(ends) > 1
    assert all(0.0 < share < 1.0 for share in analysis.without_model.values())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dispersions": {}}, "nothing is dispersed"),
        ({"runs": 1, "key": jax.random.key}, "runs is 1"),
        ({"runs": 100}, "runs is 100: give 2 or more with a key"),
        ({"mode": "forward"}, "mode is 'forward': it must be \"exact\""),
    ],
)
def test_what_cannot_be_analysed_is_an_error(options, message):
    if "key" in options:
        options = options | {"key": jax.random.key(0)}
    given = {"dispersions": table()} | options
    with pytest.raises(ValueError, match=message):
        linear_covariance(cheap.scenario(), **given)


@pytest.mark.slow
def test_mars_mission_is_predicted_at_a_tenth_and_departs_at_full_size():
    mission = find_mission("mars-drag-tracking")
    ratios = []  # predicted over flown
    for factor in (0.1, 1.0):
        analysis = linear_covariance(
            mission.scenario(),
            scaled_dispersions(mission.dispersion_table(), factor),
            key=jax.random.key(0),
            runs=1000,
        )
        assert set(analysis.models) == {"altitude", "velocity"}
        ratios.append(analysis.spreads["downrange"].ratio)
    small, full = (100.0 * abs(ratio - 1.0) for ratio in ratios)
    assert_says(
        "to 0.4 % at a tenth of the dispersions and is 5 % off at full size",
        small,
        full,
    )
