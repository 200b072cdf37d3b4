"""Gains from eigenvalues that vary with the energy, and the loss that tunes them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sx_2_by_hand as hand
from ground_track_laws import as_state, by_hand, law_at

from jentry.analysis import FrozenLoop
from jentry.flight import Flight, Scenario
from jentry.guidance import FullLinearization, ScheduledEigenvalues, TrackingGains
from jentry.missions.sx_2.scenario import entry
from jentry.missions.sx_2.tuning import Ends, MissAndZeros, ends, zero_pair
from jentry.motion import ConstraintValues
from jentry.motion.index import EnergyIndex


def test_gains_are_the_polynomials_of_their_eigenvalues():
    gains = TrackingGains.from_eigenvalues((18.0, 8.0, 8.0, 0.1), (30.0, 1.2, 1.2))
    np.testing.assert_allclose(gains.downrange, [-34.1, 355.4, -1187.2, 115.2])
    np.testing.assert_allclose(gains.crossrange, [-32.4, 73.44, -43.2])
    with pytest.raises(ValueError, match="expected 4 gains"):
        TrackingGains.from_eigenvalues((1.0, 2.0), (30.0, 1.2, 1.2))


ENERGIES = np.array([1.0, 3.0, 4.0]) * 1e6


def schedule() -> ScheduledEigenvalues:
    rng = np.random.default_rng(1)
    return ScheduledEigenvalues(
        ENERGIES, rng.uniform(0.1, 30.0, (3, 4)), rng.uniform(0.1, 30.0, (3, 3))
    )


@pytest.mark.parametrize("energy", [0.2e6, 1.0e6, 2.2e6, 3.0e6, 3.9e6, 5.0e6])
def test_scheduled_gains_are_the_polynomials_of_the_eigenvalues_there(energy):
    gains = schedule()
    for found, given in zip(
        gains.at(jnp.asarray(energy)), (gains.downrange, gains.crossrange), strict=True
    ):
        there = [np.interp(energy, ENERGIES, column) for column in np.asarray(given).T]
        np.testing.assert_allclose(found, np.poly(there)[1:], rtol=1e-13)


def test_a_schedule_that_stays_has_the_gains_of_its_eigenvalues():
    down, cross = (18.0, 8.0, 8.0, 0.1), (30.0, 1.2, 1.2)
    constant = ScheduledEigenvalues(ENERGIES, 3 * [down], 3 * [cross])
    expected = TrackingGains.from_eigenvalues(down, cross).at(jnp.asarray(0.0))
    for one, other in zip(constant.at(jnp.asarray(2.5e6)), expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14)


def test_a_schedule_of_other_shapes_is_refused():
    given = schedule()
    with pytest.raises(ValueError, match=r"downrange has shape \(3, 3\): expected 4"):
        ScheduledEigenvalues(ENERGIES, given.crossrange, given.crossrange)
    with pytest.raises(ValueError, match=r"crossrange has shape \(3, 4\): expected 3"):
        ScheduledEigenvalues(ENERGIES, given.downrange, given.downrange)
    with pytest.raises(ValueError, match="of which the shape is"):
        ScheduledEigenvalues(ENERGIES[:2], given.downrange, given.crossrange)


def test_the_loss_of_the_schedule():
    zeros = np.array([5.0, 10.0, 20.0])
    gains = schedule()
    both = np.concatenate([gains.downrange, gains.crossrange], axis=1)
    misses = np.random.default_rng(2).normal(size=(2, 5))
    every = jax.vmap(Ends)
    flown = every(*jnp.asarray(misses), jnp.tile(both, (5, 1, 1)))
    found = MissAndZeros(zeros, 0.8, 0.3)(flown)
    near = np.maximum(np.log(both / (0.8 * zeros[:, None])), 0.0)
    expected = np.mean(np.hypot(*misses) ** 4) ** 0.25 + 0.3 * np.mean(near**2)
    assert float(found) == pytest.approx(expected, rel=1e-14)
    # Well below the pair there is no penalty.
    below = every(*jnp.zeros((2, 5)), 0.1 * jnp.ones((5, 3, 7)))
    assert MissAndZeros(zeros)(below) == 0.0


def scheduled_entry() -> Scenario:
    law = law_at(as_state(by_hand("late")), FullLinearization())
    law = dataclasses.replace(law, gains=schedule())
    return dataclasses.replace(entry(), guidance=law)


def test_the_ends_of_a_flight_are_in_nautical_miles():
    """Along the equator and across it, beside the eigenvalues that were flown with."""
    scenario, given = scheduled_entry(), schedule()
    nothing, code = jnp.zeros(()), jnp.asarray(0)
    x = by_hand("late")
    flight = Flight(
        nothing, as_state(x), code, code, ConstraintValues({}), {}, {}, None
    )
    found = ends(scenario, flight)
    wanted = hand.R0 * x[1:3] / 1852.0
    # Arcs from the sines of a frame, whose east is that of a heading of 90 degrees.
    assert (found.downrange, found.crossrange) == pytest.approx(wanted, rel=1e-9)
    np.testing.assert_array_equal(found.eigenvalues[:, :4], given.downrange)
    np.testing.assert_array_equal(found.eigenvalues[:, 4:], given.crossrange)


def test_the_zero_pair_is_per_span_at_the_energies_of_the_schedule(monkeypatch):
    """The smallest that is there at each point: a zero of zero is none of the pair."""
    per_joule = 1e-7 * np.array(
        [[-3.0, 3.0, 0.0], [4j, -4j, 9.0], [9.0, -7.0, np.nan], [11j, -11j, np.nan]]
    )
    sizes, energies = (
        np.array([3.0, 4.0, 7.0, 11.0]),
        1e6 * np.array([4.5, 3.5, 2, 0.5]),
    )
    loop = FrozenLoop(
        *("energy", "J/kg", energies, np.arange(4.0), 2e7, ("altitude",), "velocity"),
        *((), (), np.zeros((4, 1, 1)), None, np.zeros((4, 1), complex), per_joule),
        *("", "energy"),
    )
    asked = []

    def linearize(*given):
        asked.append(given)
        return loop

    monkeypatch.setattr("jentry.missions.sx_2.tuning.linearize", linearize)
    scenario = scheduled_entry()
    found = zero_pair(scenario, 4)
    assert asked == [(scenario, EnergyIndex(), 4)]
    wanted = np.interp(ENERGIES, energies[::-1], 2.0 * sizes[::-1])
    np.testing.assert_allclose(found, wanted, rtol=1e-14)
    loop = dataclasses.replace(loop, zeros=None, without_zeros="nothing is tracked")
    with pytest.raises(ValueError, match="has no zeros here: nothing is tracked"):
        zero_pair(scenario)


def test_the_zero_pair_is_asked_of_a_schedule():
    with pytest.raises(ValueError, match="ControlProfiles has no schedule of eigen"):
        zero_pair(entry())
