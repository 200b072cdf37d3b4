"""What is tuned is found by a lens, starts where it was and stays where it may be."""

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_scenario, with_leaf

from jentry.addresses import leaves_by_address, replace_leaves
from jentry.motion import EntryDynamics, EquatorialDynamics
from jentry.parameters.maps import Between, Bounds, Positive, Scale, Unbounded
from jentry.parameters.parameters import Parameters


def parameters_of(scenario, where, bounds=None, scales=None):
    """With bounds as pairs and scales as numbers, by address."""
    ranges = {a: Scale(size) for a, size in (scales or {}).items()}
    ranges |= {a: Bounds(*pair) for a, pair in (bounds or {}).items()}
    return Parameters.of(scenario, where, ranges)


mass = lambda s: s.vehicle.mass
bank = lambda s: s.guidance.bank_angle
coefficients = lambda s: s.guidance.cos_bank.coefficients
COEFFICIENTS = "guidance.cos_bank.coefficients"

HUGE = 1e3
"""A free number far beyond where an exponential overflows, as a bad step may give it."""

MAPS = {
    "positive": Positive(0.3),
    "positive table": Positive([2e-7, 4.0, 3e8]),
    "unbounded": Unbounded(-14.4, 14.4),
    "unbounded, zero": Unbounded(0.0, 2.5),
    "unbounded table": Unbounded([3.0, 0.0, -4.0], [5.0 / np.sqrt(3.0)] * 3),
    "unbounded, zero, at its least": Unbounded(0.0, 2.5, least=0.0),
    "unbounded, zero, at its largest": Unbounded(0.0, 2.5, largest=0.0),
    "between": Between(0.9, 0.7, 1.3),
    "between, negative": Between(-0.25, -0.3, -0.1),
    "between, rounded up": Between(0.0, -0.2, 0.1),  # -0.2 + (0.1 - -0.2) > 0.1
    "between, near a bound": Between(1e-6, 0.0, 1.0),
    "between, table": Between([0.1, 0.2, -5.0], [-0.3, 0.1, -7.0], [0.3, 0.7, 11.0]),
}

SLOPES = {
    "positive": 0.3,
    "positive table": [2e-7, 4.0, 3e8],
    "unbounded": 14.4,
    "unbounded, zero": 2.5,
    "unbounded, zero, at its least": 2.5,
    "unbounded, zero, at its largest": 2.5,
    "unbounded table": np.full(3, 5.0 / np.sqrt(3.0)),
    # Of a logistic curve: the distances to both bounds, their product over their sum.
    "between": 0.2 * 0.4 / 0.6,
    "between, negative": 0.05 * 0.15 / 0.2,
    "between, rounded up": 0.2 * 0.1 / 0.3,
    "between, near a bound": 1e-6 * (1.0 - 1e-6),
    "between, table": [0.4 * 0.2 / 0.6, 0.1 * 0.5 / 0.6, 2.0 * 16.0 / 18.0],
}


def at(free, map):
    """Of one free number for all of its numbers."""
    return map(jnp.full(map.start.shape, free))


@pytest.mark.parametrize("name", MAPS)
def test_zero_is_the_start(name):
    map = MAPS[name]
    found = at(0.0, map)
    # Exact, but for the way through the logistic curve: rounding of the width.
    rounding = 4e-16 * (map.upper - map.lower) if isinstance(map, Between) else 0.0
    assert np.all(np.abs(found - map.start) <= rounding)
    assert found.shape == map.start.shape
    assert found.dtype == jnp.float64


@pytest.mark.parametrize("name", MAPS)
def test_slope_at_the_start_is_of_the_size_that_is_promised(name):
    slope = jax.jvp(lambda x: at(x, MAPS[name]), (0.0,), (1.0,))[1]
    # A handful of operations on numbers whose difference was taken.
    np.testing.assert_allclose(slope, SLOPES[name], rtol=1e-13)


@pytest.mark.parametrize("name", [n for n in MAPS if "zero" not in n])
def test_a_step_of_a_tenth_changes_positive_and_free_numbers_by_about_a_tenth(name):
    """And moves one between bounds by no more than a tenth of the way to the nearer."""
    map = MAPS[name]
    change = np.abs(at(0.1, map) - map.start)
    if isinstance(map, Between):
        nearer = np.minimum(map.start - map.lower, map.upper - map.start)
        # A tenth of the way, or up to half of that in the middle; the curve bends.
        assert np.all((0.04 * nearer < change) & (change < 0.11 * nearer))
    else:
        size = (
            np.sqrt(np.mean(map.start**2)) if isinstance(map, Unbounded) else map.start
        )
        assert np.all((0.09 * size < change) & (change < 0.11 * size))


@pytest.mark.parametrize("free", [-HUGE, -40.0, 40.0, HUGE])
@pytest.mark.parametrize("name", [n for n in MAPS if n.startswith("between")])
def test_bounds_hold_for_free_numbers_of_any_size(name, free):
    map = MAPS[name]
    found = at(free, map)
    assert np.all((map.lower <= found) & (found <= map.upper))
    # exp(-40) of the way is left, or a million of that from near the other bound.
    bound = map.lower if free < 0.0 else map.upper
    np.testing.assert_allclose(found, bound, rtol=1e-15, atol=1e-11)


@pytest.mark.parametrize("free", [-HUGE, -40.0, 40.0, HUGE])
@pytest.mark.parametrize("name", ["positive", "positive table"])
def test_what_is_positive_stays_so_and_finite_for_free_numbers_of_any_size(name, free):
    found = at(free, MAPS[name])
    assert np.all((found > 0.0) & np.isfinite(found))


@pytest.mark.parametrize("name", MAPS)
def test_the_way_back_from_far_off_has_a_finite_derivative(name):
    for free in (-HUGE, HUGE):
        slope = jax.jvp(lambda x: at(x, MAPS[name]), (free,), (1.0,))[1]
        if not (isinstance(MAPS[name], Positive) and free > 0.0):  # which overflows
            assert np.all(np.isfinite(slope))


# By lenses.


@pytest.mark.parametrize(
    ("where", "maps"),
    [
        (mass, {"vehicle.mass": Positive}),
        (
            lambda s: (bank(s), mass(s)),
            {"guidance.bank_angle": Unbounded, "vehicle.mass": Positive},
        ),
        (
            lambda s: s.initial_state,
            {
                "initial_state.altitude": Unbounded,
                "initial_state.longitude": Unbounded,
                "initial_state.latitude": Unbounded,
                "initial_state.velocity": Positive,
                "initial_state.flight_path_angle": Unbounded,
                "initial_state.heading": Unbounded,
            },
        ),
    ],
    ids=["a number", "two", "a module"],
)
def test_a_lens_reaches_numbers_and_modules(where, maps):
    scenario = cheap.scenario()
    zero = ("initial_state.longitude", "initial_state.latitude")
    scales = {address: 0.1 for address in zero if address in maps}
    parameters = parameters_of(scenario, where, None, scales)
    assert {a: type(m) for a, m in parameters.maps.items()} == maps
    assert parameters.addresses == list(maps)
    assert parameters.count == len(maps)
    leaves = leaves_by_address(scenario)
    values = parameters.values(parameters.zeros())
    assert values == {address: leaves[address] for address in maps}


def test_a_lens_reaches_a_table_of_numbers():
    scenario = mars_scenario()
    parameters = parameters_of(scenario, lambda s: (coefficients(s), mass(s)), None)
    assert parameters.count == 3
    free = parameters.zeros()
    assert {a: x.shape for a, x in free.items()} == {
        COEFFICIENTS: (2,),
        "vehicle.mass": (),
    }
    assert all(np.all(x == 0.0) for x in free.values())
    values = parameters.values(free)
    assert np.array_equal(values[COEFFICIENTS], scenario.guidance.cos_bank.coefficients)
    # Of its own each number of a table moves alone.
    free[COEFFICIENTS] = jnp.array([0.0, 1.0])
    moved = parameters.values(free)[COEFFICIENTS]
    size = np.hypot(0.62, 0.05) / np.sqrt(2.0)
    np.testing.assert_allclose(moved, [0.62, 0.05 + size], rtol=1e-15)
    assert np.array_equal(
        coefficients(replace_leaves(scenario, {COEFFICIENTS: moved})), moved
    )


def test_bounds_are_by_address_and_for_a_table_one_for_all_or_each():
    bounds = {COEFFICIENTS: (-1.0, 1.0), "vehicle.mass": (900.0, 1100.0)}
    where = lambda s: (coefficients(s), mass(s))
    parameters = parameters_of(mars_scenario(), where, bounds)
    assert {type(m) for m in parameters.maps.values()} == {Between}
    assert parameters.maps[COEFFICIENTS].lower.shape == (2,)
    assert list(bounds) == [COEFFICIENTS, "vehicle.mass"]  # the caller's own
    each = {COEFFICIENTS: ([0.0, 0.0], [1.0, 0.1])}
    parameters = parameters_of(mars_scenario(), coefficients, each)
    np.testing.assert_array_equal(parameters.maps[COEFFICIENTS].upper, [1.0, 0.1])


def test_a_leaf_that_is_reached_twice_keeps_its_bounds():
    where = lambda s: (s.vehicle.mass, s.vehicle)
    parameters = parameters_of(
        cheap.scenario(),
        where,
        {"vehicle.mass": (900.0, 1100.0)},
        {"vehicle.trim_angle_of_attack": 0.1},
    )
    assert isinstance(parameters.maps["vehicle.mass"], Between)


@pytest.mark.parametrize("lower", [0.0, -100.0])
def test_what_is_positive_stays_so_within_bounds_that_are_not(lower):
    """As the documentation of `tune` has it; to refuse such bounds would do as well."""
    try:
        parameters = parameters_of(
            cheap.scenario(), mass, {"vehicle.mass": (lower, 1100.0)}
        )
    except ValueError:
        return
    value = parameters.values({"vehicle.mass": jnp.asarray(-HUGE)})["vehicle.mass"]
    assert value > 0.0


@pytest.mark.parametrize(
    ("where", "bounds", "message"),
    [
        (
            mass,
            {"vehicle.mas": (900.0, 1100.0)},
            "vehicle.mas has a Bounds and is not tuned; nearest: vehicle.mass",
        ),
        (
            mass,
            {"vehicle.mass": (900.0, 1100.0), "planet.density_scale": (0.5, 2.0)},
            "planet.density_scale has a Bounds and is not tuned",
        ),
        *(
            (mass, {"vehicle.mass": bounds}, "bounds of vehicle.mass .* both sides")
            for bounds in [
                (1000.0, 1100.0),
                (900.0, 950.0),
                (992.0, 1100.0),
                (900.0, 992.0),
                (1100.0, 900.0),
            ]
        ),
        *(
            (bank, {"guidance.bank_angle": bounds}, "bank_angle .* must be finite")
            for bounds in [
                (0.0, np.nan),
                (0.0, np.inf),
                (-np.inf, 1.0),
                (-np.inf, np.inf),
            ]
        ),
        (lambda s: s.termination.names, None, "a lens reaches no leaf"),
        (lambda s: s.vehicle.mass + "!", None, "a lens reaches no leaf"),
        (lambda s: (), None, "a lens reaches no leaf"),
    ],
)
def test_what_cannot_be_tuned_is_an_error(where, bounds, message):
    with pytest.raises(ValueError, match=message):
        parameters_of(cheap.scenario(), where, bounds)


def test_bounds_of_a_table_hold_for_each_of_its_numbers():
    with pytest.raises(ValueError, match=f"bounds of {COEFFICIENTS} .* both sides"):
        parameters_of(mars_scenario(), coefficients, {COEFFICIENTS: (0.1, 1.0)})


@pytest.mark.parametrize("name", ["latitude", "heading"])
def test_a_number_without_effect_is_not_tuned(name):
    where = lambda s: getattr(s.initial_state, name)
    with pytest.raises(ValueError, match=f"initial_state.{name} has no effect"):
        parameters_of(mars_scenario(dynamics=EquatorialDynamics()), where, None)
    scales = {"initial_state.latitude": 0.1} if name == "latitude" else None
    flown = mars_scenario(dynamics=EntryDynamics())
    assert parameters_of(flown, where, None, scales).count == 1


LATITUDE = "initial_state.latitude"


def latitude(s):
    return s.initial_state.latitude


def test_a_number_that_is_zero_moves_by_the_scale_that_is_given():
    parameters = parameters_of(cheap.scenario(), latitude, None, {LATITUDE: 0.02})
    moved = parameters.values({LATITUDE: jnp.asarray(3.0)})[LATITUDE]
    np.testing.assert_allclose(moved, 0.06, rtol=1e-15)


def test_a_scale_takes_the_place_of_the_size():
    """And in a table each number may have its own."""
    given = {COEFFICIENTS: [0.1, 2.0]}
    parameters = parameters_of(mars_scenario(), coefficients, None, given)
    moved = parameters.values({COEFFICIENTS: jnp.ones(2)})[COEFFICIENTS]
    np.testing.assert_allclose(moved, [0.72, 2.05], rtol=1e-15)


@pytest.mark.parametrize(
    ("where", "bounds", "scales", "message"),
    [
        (latitude, None, None, r'is 0, .*ranges=\{"initial_state.latitude": Scale'),
        (latitude, None, {LATITUDE: 0.0}, "the scale of .* is 0.0: it must be finite"),
        (latitude, None, {LATITUDE: np.nan}, "the scale of .* is nan"),
        (latitude, None, {LATITUDE: [1.0, 2.0]}, "give a number, or an array"),
        (mass, None, {"vehicle.mass": 10.0}, "mass must be positive, from which"),
        (mass, None, {LATITUDE: 10.0}, "latitude has a Scale and is not tuned"),
    ],
)
def test_scales_that_tell_nothing_are_refused(where, bounds, scales, message):
    with pytest.raises(ValueError, match=message):
        parameters_of(cheap.scenario(), where, bounds, scales)


@pytest.mark.parametrize(
    ("bounds", "said"),
    [
        ((900.0, 1100.0), 0),
        ((992.0 - 0.21, 1192.0), 0),  # 0.105 %
        ((992.0 - 0.19, 1192.0), 1),
        ((792.0, 992.0 + 1e-9), 1),
    ],
)
def test_a_start_next_to_a_bound_is_said(bounds, said):
    parameters = parameters_of(cheap.scenario(), mass, {"vehicle.mass": bounds})
    remarks = parameters.near_bounds()
    assert len(remarks) == said
    assert all("vehicle.mass starts within" in remark for remark in remarks)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.nan, "vehicle.mass is nan: it must be a finite number"),
        (-1.0, "vehicle.mass is -1 kg: it must be greater than zero"),
    ],
)
def test_a_start_that_cannot_be_flown_is_an_error(value, message):
    with pytest.raises(ValueError, match=message):
        parameters_of(with_leaf(cheap.scenario(), mass, value), mass, None)


def test_a_whole_number_has_no_gradient():
    scenario = cheap.scenario()
    counted = eqx.tree_at(mass, scenario, jnp.asarray(992))
    with pytest.raises(ValueError, match="vehicle.mass is of type int64"):
        parameters_of(counted, mass, None)
