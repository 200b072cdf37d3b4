"""Damping of a closed loop as a function of its gains, and tuning that is kept damped."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from level_hold import (
    GAINS,
    PERIOD,
    deadbeat_gains,
    held_map,
    hold,
    level,
    with_integral,
)

from jentry.analysis import Damping, linearize
from jentry.analysis.damping import eigenvalues_of
from jentry.flight import FixedStep
from jentry.guidance import Sampled
from jentry.motion.index import DownrangeIndex
from jentry.tuning import DampingBelow


SOLVER = FixedStep(1.0)
EVERY = ("gains", "path_gain", "integral_gain")
"""The gains of the law that GAINS has, without that on the velocity"""


def by_hand(gains, sampled):
    """Damping ratios in ascending order of all but the neutral mode, in numpy."""
    if sampled:
        found = np.log(np.linalg.eigvals(held_map(gains)).astype(complex)) / PERIOD
    else:
        a, b, k = with_integral(gains)
        found = np.linalg.eigvals(a - np.outer(b, k))
    found = found[np.abs(found) > 1e-7]
    return np.sort(-found.real / np.abs(found))


def flown(gains=GAINS, sampled=False):
    return level(Sampled(hold(gains), PERIOD) if sampled else hold(gains))


@pytest.fixture(scope="module", params=[False, True], ids=["continuous", "sampled"])
def case(request):
    solver = FixedStep(0.1) if request.param else SOLVER
    scenario = flown(sampled=request.param)
    made = Damping.of(scenario, points=2, faster_than=1e-6, solver=solver)

    @jax.jit
    def ratios(gains):
        law = hold(gains)
        law = Sampled(law, PERIOD) if request.param else law
        return jnp.sort(made(level(law)), axis=1)

    return request.param, made, ratios, scenario


def test_the_ratios_are_those_of_the_closed_form(case):
    sampled, made, ratios, _ = case
    assert made.points == 2
    found = np.asarray(ratios(jnp.asarray(GAINS)))
    for row in found:
        # The neutral mode, of the energy, is slower than what counts.
        assert row[-1] == 1.0
        expected = by_hand(GAINS, sampled)
        np.testing.assert_allclose(row[: len(expected)], expected, rtol=0, atol=1e-6)


def test_the_derivative_is_that_of_the_closed_form(case):
    """In the gains, for each mode; to what differences of 1e-5 have."""
    sampled, _, ratios, _ = case
    slopes = np.asarray(jax.jit(jax.jacfwd(ratios))(jnp.asarray(GAINS)))
    for place in (0, 2, 3):
        nudge = np.zeros(4)
        nudge[place] = 1e-5
        ahead, behind = (by_hand(GAINS + s * nudge, sampled) for s in (1.0, -1.0))
        expected = (ahead - behind) / 2e-5
        assert np.max(np.abs(expected)) > 1e-3
        for point in slopes:
            found = point[: len(expected), place]
            np.testing.assert_allclose(found, expected, rtol=1e-5, atol=2e-7)


def test_the_least_is_that_of_linearize(case):
    sampled, made, _, scenario = case
    solver = FixedStep(0.1) if sampled else SOLVER
    loop = linearize(scenario, points=2, solver=solver)
    found = float(eqx.filter_jit(made.least)(scenario))
    assert found == pytest.approx(loop.least_damping_of(1e-6).value, abs=1e-9)


def test_what_is_slower_does_not_count():
    """Of two modes the one beyond a magnitude between them."""
    scenario = flown()
    a, b, k = with_integral(GAINS)
    rates = np.linalg.eigvals(a - np.outer(b, k))
    sizes = np.sort(np.abs(rates))
    between = float(np.sqrt(sizes[-1] * sizes[-3]))
    made = Damping.of(scenario, points=2, faster_than=between, solver=SOLVER)
    counted = rates[np.abs(rates) > between]
    expected = np.min(-counted.real / np.abs(counted))
    assert float(made.least(scenario)) == pytest.approx(expected, abs=1e-7)
    # What is damped better than asked for costs nothing.
    assert expected > 0.5 and float(DampingBelow(made, 0.4)(scenario)) == 0.0
    loop = linearize(scenario, points=2, solver=SOLVER)
    found = loop.least_damping_of(between)
    assert found.value == pytest.approx(expected, abs=1e-7)
    assert abs(found.eigenvalue) > between
    assert np.isnan(loop.least_damping_of(1e3).value)


@pytest.mark.slow
def test_a_deadbeat_mode_is_damped_and_has_a_derivative():
    gains = jnp.asarray(deadbeat_gains())
    scenario = level(Sampled(hold(gains), PERIOD))
    made = Damping.of(scenario, points=2, faster_than=1e-3, solver=FixedStep(0.1))

    def ratios(gains):
        return made(level(Sampled(hold(gains), PERIOD)))

    found = np.asarray(jax.jit(ratios)(gains))
    np.testing.assert_allclose(found, 1.0, atol=1e-6)
    assert np.isfinite(jax.jit(jax.jacfwd(ratios))(gains)).all()


def test_a_multiple_eigenvalue_leaves_the_others_their_derivative():
    """JAX's own derivative of all is not a number then."""

    def matrix(x):
        double = jnp.array([[2.0, 1.0], [0.0, 2.0]])
        single = jnp.array([[x, 1.0], [-1.0, x]])
        return jnp.block([[double, jnp.zeros((2, 2))], [jnp.zeros((2, 2)), single]])

    values, slopes = jax.jvp(lambda x: eigenvalues_of(matrix(x)), (0.5,), (1.0,))
    pair = np.abs(np.asarray(values).imag) > 0.5
    np.testing.assert_allclose(np.sort_complex(values[pair]), [0.5 - 1j, 0.5 + 1j])
    np.testing.assert_allclose(slopes[pair], 1.0, rtol=1e-12)
    np.testing.assert_allclose(slopes[~pair], 0.0)


def test_the_penalty_is_of_the_worst_mode(case):
    sampled, made, _, scenario = case
    worst = by_hand(GAINS, sampled)[0]
    assert worst < 0.0  # the phugoid of the level flight grows
    for least in (0.2, 0.9):
        short = max(1.0 - worst / least, 0.0)
        found = DampingBelow(made, float(least), weight=3.0)
        assert float(eqx.filter_jit(found)(scenario)) == pytest.approx(
            3.0 * short**2, rel=1e-5, abs=1e-12
        )
    for given, message in (
        ({"least": 0.0}, "least is 0.0: it must be above 0, at most 1"),
        ({"least": 1.1}, "least is 1.1"),
        ({"weight": 0.0}, "weight is 0.0: it must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            DampingBelow(made, **given)


def test_what_has_no_damping_is_refused():
    with pytest.raises(
        ValueError, match="faster_than is -1.0: it must not be negative"
    ):
        Damping.of(flown(), faster_than=-1.0)
    with pytest.raises(ValueError, match="faster_than is nan"):
        Damping.of(flown(), faster_than=np.nan)
    with pytest.raises(ValueError, match="points is 0: it must be 1 or more"):
        Damping.of(flown(), points=0)


def test_coordinates_that_depend_on_one_another_are_one_block(case):
    """Altitude, velocity, path angle and integral; the others stand alone."""
    sampled, made, _, scenario = case
    loop = linearize(scenario, points=2, solver=FixedStep(0.1) if sampled else SOLVER)
    (block,) = (block for block in made.blocks if len(block) > 1)
    assert len(block) == len(loop.coordinates) == 4
    alone = [place for block in made.blocks for place in block if len(block) == 1]
    assert not set(alone) & set(block)
    assert sorted([*alone, *block]) == list(range(len(alone) + 4))


def test_a_dependence_that_was_not_there_is_not_passed_over():
    """A gain of zero links no integral: with another gain the modes are others."""
    without = GAINS * np.array([1.0, 1.0, 1.0, 0.0])
    made = Damping.of(flown(without), points=2, faster_than=1e-6, solver=SOLVER)
    expected = by_hand(without, False)
    found = np.sort(made(flown(without)), axis=1)
    for row in found:
        np.testing.assert_allclose(row[: len(expected)], expected, rtol=0, atol=1e-6)
    assert np.isnan(made(flown())).all()


def test_over_the_ground_the_ratios_are_the_same():
    """In level flight over the ground each rate is divided by one number."""
    scenario = flown()
    index = DownrangeIndex(scenario.initial_state)
    made = Damping.of(scenario, index, 2, faster_than=1e-9, solver=SOLVER)
    expected = by_hand(GAINS, False)
    for row in np.sort(made(scenario), axis=1):
        np.testing.assert_allclose(row[: len(expected)], expected, rtol=0, atol=1e-5)
