"""The neural law: what it commands, its limits, its memory, and its derivatives."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled
from jax.flatten_util import ravel_pytree
from neural_laws import (
    ANGLES,
    PERIOD,
    SOLVER,
    assert_same,
    flown,
    gliding_scenario_of,
    law_of,
    network_of,
    other_law,
    scenario_of,
)

from jentry.flight import misses
from jentry.flight.scenario_checks import check
from jentry.guidance import BankProfile, Sampled
from jentry.guidance.neural_law import (
    INPUTS,
    AngleOfAttackLimits,
)
from jentry.onboard import (
    PolynomialProfile,
    RecurrentNetwork,
)
from jentry.units import degree


def test_a_cycle_turns_as_fast_as_the_vehicle_can():
    law = law_of(turn_rate=2.0 * degree, largest_bank=1.2)
    most = 2.0 * degree * PERIOD
    for bank, output in ((0.0, 50.0), (0.5, -50.0), (-1.1, 50.0)):
        turned = float(law.turned(jnp.asarray(bank), jnp.asarray(output)))
        assert turned - bank == pytest.approx(math.copysign(most, output), rel=1e-6)
    close = float(law.turned(jnp.asarray(0.3), jnp.arctanh(jnp.asarray(0.301 / 1.2))))
    assert close == pytest.approx(0.301, abs=1e-6)


def test_the_bank_of_a_flight_keeps_its_limits():
    law = law_of(network_of(size=300.0), largest_bank=0.9, turn_rate=5.0 * degree)
    history = flown(law).history
    bank = np.asarray(history.decisions.bank)
    bank = bank[np.isfinite(np.asarray(history.time))]
    assert np.max(np.abs(bank)) <= 0.9
    assert np.max(np.abs(np.diff(bank))) <= 5.0 * degree * PERIOD + 1e-12
    assert np.ptp(bank) > 0.2


def test_the_first_bank_is_that_before_the_first_decision():
    """A slow vehicle still has most of it after the first one."""
    law = law_of(first_bank=1.0, turn_rate=0.1 * degree)
    held = flown(law).history.decisions.bank
    assert float(held[0]) == pytest.approx(1.0, abs=0.1 * degree * PERIOD + 1e-12)


def test_the_law_remembers():
    """The same network without what its memory adds flies elsewhere."""
    network = network_of(size=20.0)
    forgetful = eqx.tree_at(
        lambda n: n.layers[0].weight,
        network,
        replace_fn=lambda w: w.at[:, len(INPUTS) :].set(0.0),
    )
    a, b = (flown(law_of(n)).state.longitude for n in (network, forgetful))
    assert abs(float(a - b)) > 1e-5


def test_the_memory_goes_from_decision_to_decision():
    """A cell that reads nothing: its memory alone moves it, by the formula of the cell."""
    network = network_of()
    blind = eqx.tree_at(lambda n: n.cell.weight_ih, network, replace_fn=jnp.zeros_like)
    blind = eqx.tree_at(lambda n: n.cell.bias, blind, replace_fn=lambda b: 0.3 + b)
    memory = flown(law_of(blind)).history.decisions.memory[:5]
    expected = jnp.zeros(3)
    for found in memory:
        expected = blind.cell(jnp.zeros(len(INPUTS)), expected)
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert np.all(np.abs(np.diff(memory, axis=0)).max(axis=1) > 1e-4)


def test_decisions_beyond_the_training_are_a_caveat():
    network = network_of()
    assert float(flown(law_of(network)).caveats["decisions_beyond_training"]) == 0.0
    narrow = eqx.tree_at(
        lambda n: n.input_ranges, network, network.input_ranges.at[0].set([0.5, 2.0])
    )
    flight = flown(law_of(narrow))
    velocity = np.asarray(flight.history.states.velocity) / 6750.0
    velocity = velocity[np.isfinite(velocity)]
    share = float(flight.caveats["decisions_beyond_training"])
    assert share == pytest.approx(np.mean(velocity < 0.5), abs=2.0 / len(velocity))
    assert 0.1 < share < 0.9


def test_a_network_of_zeros_corrects_nothing():
    zero = jax.tree.map(jnp.zeros_like, network_of().layers)
    network = eqx.tree_at(lambda n: n.layers, network_of(), zero)
    beside = law_of(network, beside=other_law(), corrects=True)
    assert_same(flown(beside).state, flown(other_law()).state)


def test_a_correction_adds_to_the_bank():
    beside = law_of(network_of(size=20.0), beside=other_law(), corrects=True)
    history = flown(beside).history
    flying = np.isfinite(np.asarray(history.time))
    command = np.arctan2(history.controls.sin_bank, history.controls.cos_bank)[flying]
    correction = np.asarray(history.decisions.bank)[flying]
    held = history.decisions.beside.command
    other = np.arctan2(held.sin_bank, held.cos_bank)[flying]
    np.testing.assert_allclose(np.sin(command - other - correction), 0.0, atol=1e-12)
    assert np.max(np.abs(correction)) > 0.1


def test_beyond_the_training_the_law_beside_flies():
    network = network_of(size=20.0)
    never = eqx.tree_at(
        lambda n: n.input_ranges, network, jnp.full((len(INPUTS), 2), 1e3)
    )
    assert_same(
        flown(law_of(never, beside=other_law())).state, flown(other_law()).state
    )
    assert_same(
        flown(law_of(never, beside=other_law(), corrects=True)).state,
        flown(other_law()).state,
    )
    alone, beside = law_of(network), law_of(network, beside=other_law())
    assert_same(flown(beside).state, flown(alone).state)


def test_the_law_beside_does_not_give_back_the_command():
    """Beyond only while the velocity is between two values: it flies to the end."""
    network = network_of(size=20.0)
    ranges = network.input_ranges.at[0].set([0.6, 2.0])
    slow = eqx.tree_at(lambda n: n.input_ranges, network, ranges)
    history = flown(law_of(slow, beside=other_law())).history
    flying = np.isfinite(np.asarray(history.time))
    beyond = np.asarray(history.decisions.beyond)[flying]
    velocity = np.asarray(history.states.velocity)[flying] / 6750.0
    np.testing.assert_array_equal(beyond, (velocity < 0.6).astype(float))
    # The other way about: fast at first, which is beyond, and slow later.
    ranges = network.input_ranges.at[0].set([-1.0, 0.99])
    fast = eqx.tree_at(lambda n: n.input_ranges, network, ranges)
    flight = flown(law_of(fast, beside=other_law()))
    assert_same(flight.state, flown(other_law()).state)
    assert float(flight.caveats["decisions_beyond_training"]) < 0.9


@pytest.mark.parametrize("address", ["downrange", "origin.altitude"])
def test_an_aim_whose_numbers_cannot_be_units_is_refused(address):
    """All inputs would be over zero, and the flight not finite."""
    scenario = scenario_of(law_of())
    target = scenario.place
    origin = dataclasses.replace(
        target.origin or scenario.initial_state,
        **({"altitude": 0.0} if "." in address else {}),
    )
    changed = {"origin": origin} if "." in address else {"downrange": 0.0}
    wrong = dataclasses.replace(target, **changed)
    with pytest.raises(ValueError, match=f"^guidance, NeuralLaw: {address} of the aim"):
        check(dataclasses.replace(scenario, target=wrong))
    aim = dataclasses.replace(scenario.law.aim, **changed)
    with pytest.raises(ValueError, match=f"{address} of the aim is zero"):
        law_of(aim=aim)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="corrects is True and beside is None"):
        law_of(corrects=True)
    other = Sampled(BankProfile(PolynomialProfile(jnp.ones(1))), 2.0)
    with pytest.raises(ValueError, match="both must decide together"):
        law_of(beside=other)
    with pytest.raises((ValueError, TypeError), match="beside"):
        law_of(beside=BankProfile(PolynomialProfile(jnp.ones(1))))
    samples = {name: np.zeros(2) for name in ("a", "b")}
    wrong = RecurrentNetwork.untrained(samples, 2, (3,), 1, jax.random.key(0))
    with pytest.raises(
        ValueError, match="it lacks 'velocity'.*the law has no 'a', 'b';"
    ):
        law_of(wrong)
    two = RecurrentNetwork.untrained(
        dict.fromkeys(INPUTS, np.zeros(2)), 2, (3,), 2, jax.random.key(0)
    )
    with pytest.raises(
        ValueError, match="has 2 outputs, and this law 1: the bank. .* lacks none"
    ):
        law_of(two)
    with pytest.raises(ValueError, match="this law 2: bank and angle of attack"):
        law_of(network_of(), angles=ANGLES)
    for lowest, highest in ((14.0, 2.0), (5.0, 5.0)):
        with pytest.raises(
            ValueError, match=f"lowest is {lowest:g} degrees and highest"
        ):
            AngleOfAttackLimits(lowest * degree, highest * degree, 0.1)
    turned = eqx.tree_at(
        lambda s: s.guidance.angles.lowest,
        gliding_scenario_of(law_of(angles=ANGLES)),
        jnp.asarray(26.0 * degree),
    )
    with pytest.raises(ValueError, match="lowest is 26 degrees and highest 25 degrees"):
        check(turned)
    with pytest.raises(ValueError, match="a correction is of the bank alone"):
        law_of(angles=ANGLES, beside=other_law(), corrects=True)
    with pytest.raises(ValueError, match="turn_rate"):
        check(scenario_of(law_of(turn_rate=-1.0)))


@pytest.mark.parametrize("options", [{}, {"angles": ANGLES}], ids=["bank", "angle"])
@pytest.mark.slow
def test_the_derivatives_by_all_weights_are_those_of_differences(options):
    """Along a random direction, in forward and in reverse mode."""
    law = law_of(network_of(size=10.0, angle=bool(options)), **options)
    vector, put_back = ravel_pytree(law.network.trained)

    @jax.jit
    def missed(vector):
        network = eqx.tree_at(lambda n: n.trained, law.network, put_back(vector))
        scenario = gliding_scenario_of(dataclasses.replace(law, network=network))
        return misses(scenario, fly_compiled(scenario, SOLVER, None)).downrange

    along = np.random.default_rng(2).normal(0.0, 1.0, vector.shape)
    along = jnp.asarray(along / np.linalg.norm(along))
    _, forward = jax.jvp(missed, (vector,), (along,))
    backward = jax.grad(missed)(vector) @ along

    def difference(size):
        return (
            (missed(vector + size * along) - missed(vector - size * along)) / size / 2
        )

    # Richardson: the error of a central difference is of the second order.
    coarse, fine = difference(2e-4), difference(1e-4)
    expected = fine + (fine - coarse) / 3.0
    assert abs(float(expected)) > 1.0
    np.testing.assert_allclose(forward, expected, rtol=1e-6)
    np.testing.assert_allclose(backward, forward, rtol=1e-10)
