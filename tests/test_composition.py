"""An angle-of-attack law and a bank law as one: order, cycles, derivatives, refusals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from composed_laws import (
    Asking,
    at_start,
    flown,
    lagging,
    lifting,
    modulation,
    reference,
    steady,
)
from helpers import ConstantBank, fly_compiled, mars_entry, mars_scenario, with_leaf
from laws import all_laws, observer_law

from jentry.fields import Scalar
from jentry.flight import FixedStep, fly
from jentry.guidance import (
    AbstractContinuousLaw,
    AbstractSampledLaw,
    AngleOfAttackCommand,
    AngleOfAttackProfile,
    BankLimits,
    FixedCycle,
    Sampled,
    ShorteningCycle,
    TrimAngleOfAttack,
    VelocityReversals,
    compose,
)
from jentry.motion import Controls, EntryDynamics
from jentry.onboard import PolynomialProfile
from jentry.units import degree


# The identity.


ALONE = ("bank profile", "observer", "gated", "range tracking", "neural")
"""One of each kind, since what is composed does not look into a law: without memory, with
memory, with another law within, with a side and with caveats"""


@pytest.mark.optimized
@pytest.mark.slow
@pytest.mark.parametrize("name", ALONE)
def test_beside_the_trim_angle_a_bank_law_flies_bit_for_bit_as_alone(name):
    law = all_laws[name](reference())
    ends = []
    for one in (law, compose(TrimAngleOfAttack(), law)):
        scenario = mars_scenario(one, dynamics=EntryDynamics(), time_limit=150.0)
        scenario = with_leaf(scenario, lambda s: s.vehicle.trim_angle_of_attack, 0.1)
        ends.append(fly_compiled(scenario, FixedStep(0.5)))
    for a, b in zip(jax.tree.leaves(ends[0]), jax.tree.leaves(ends[1]), strict=True):
        np.testing.assert_array_equal(a, b)
    assert float(ends[0].state.altitude) < float(mars_entry().altitude)


@pytest.mark.slow
def test_two_ways_to_one_angle_of_attack():
    """A schedule beside a bank law, and the vehicle trimmed at the same constant."""
    beside = lifting(
        compose(AngleOfAttackProfile(PolynomialProfile([0.2])), steady(0.6))
    )
    alone = with_leaf(
        lifting(steady(0.6)), lambda s: s.vehicle.trim_angle_of_attack, 0.2
    )
    first, second = (fly_compiled(s, FixedStep(0.5)) for s in (beside, alone))
    for a, b in zip(
        jax.tree.leaves(first.state), jax.tree.leaves(second.state), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-12)


# Order, and what each of the two is told.


class Telling(AbstractContinuousLaw[None]):
    """A bank law that banks by the trim angle of attack that it measures."""

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        angle = measurement.trim_angle_of_attack
        return Controls.from_bank(3.0 * angle, angle), None


@pytest.mark.parametrize("kind", ["continuous", "bank", "angle", "both", "together"])
def test_the_bank_law_is_told_the_commanded_angle_of_attack(kind):
    first, second = Asking(0.0), Telling()
    if kind in ("angle", "both"):
        first = Sampled(first, 1.0)
    if kind in ("bank", "both"):
        second = Sampled(second, 1.0)
    law = compose(first, second)
    law = Sampled(law, 1.0) if kind == "together" else law
    assert isinstance(law, AbstractSampledLaw) == (kind != "continuous")
    found = at_start(law)
    assert float(found.angle_of_attack) == 0.1
    assert float(found.bank_angle) == pytest.approx(0.3, rel=1e-12)


class Counting(AbstractSampledLaw[Scalar, Scalar]):
    """Holds the number of its cycles as the angle of attack; memory is the time."""

    cycle: FixedCycle = FixedCycle(2.0)

    def init(self, measurement):
        nothing = 0.0 * measurement.drag
        return nothing, nothing

    def update(self, time, measurement, memory, held):
        return memory, held + 1.0

    def __call__(self, time, measurement, memory, held):
        return AngleOfAttackCommand(1e-3 * held), jnp.ones_like(held)

    def caveats(self, held):
        return {"cycles": 1e-3 * held}


def test_decisions_and_memories_of_both_go_on():
    """The bank law in the same cycle sees the angle of this cycle, not of the last."""
    law = compose(Counting(), Sampled(Telling(), 2.0))
    flight = fly_compiled(lifting(law), FixedStep(0.5), 1.0)
    history = flown(flight.history)
    wanted = 1e-3 * (1.0 + np.floor(history.time / 2.0))
    np.testing.assert_allclose(history.controls.angle_of_attack, wanted, rtol=1e-12)
    sine = history.controls.sin_bank
    np.testing.assert_allclose(sine, np.sin(3.0 * wanted), rtol=1e-12)
    # What the laws say of their decisions is passed on.
    assert float(flight.caveats["cycles"]) == pytest.approx(wanted[-1])
    np.testing.assert_allclose(
        history.decisions.angle_of_attack, wanted / 1e-3, rtol=1e-12
    )


def test_a_continuous_half_acts_between_the_cycles_of_the_other():
    profile = PolynomialProfile([0.0, 0.4], 0.0, 6750.0)
    law = compose(AngleOfAttackProfile(profile), Sampled(steady(0.5), 4.0))
    history = flown(fly_compiled(lifting(law), FixedStep(0.5), 1.0).history)
    wanted = 0.4 * history.states.velocity / 6750.0
    np.testing.assert_allclose(history.controls.angle_of_attack, wanted, rtol=1e-12)


@pytest.mark.slow
def test_the_side_is_decided_as_by_the_bank_law_alone():
    law = compose(
        Sampled(modulation(), 1.0),
        Sampled(steady(0.5, lateral=VelocityReversals([5000.0, 2000.0])), 1.0),
        BankLimits(12 * degree, 80 * degree),
    )
    history = flown(fly_compiled(lifting(law), FixedStep(0.5), 1.0).history)
    passed = np.sum(history.states.velocity[:, None] <= [5000.0, 2000.0], axis=1)
    np.testing.assert_array_equal(np.sign(history.controls.sin_bank), (-1.0) ** passed)
    assert set(passed) == {0, 1, 2}


# Modulation in flight.


@pytest.mark.slow
@pytest.mark.parametrize("attitude", ["lagging", "ideal"])
def test_modulation_moves_the_angle_of_attack_and_the_bank(attitude):
    """About their schedules, within the limits; commands are held over a cycle where the
    attitude is ideal."""
    change = {"attitude": lagging()} if attitude == "lagging" else {}
    limits = BankLimits(12 * degree, 80 * degree)

    def flight(gain):
        pair = compose(modulation(gain=gain), steady(0.5), limits)
        law = pair if change else Sampled(pair, 0.5)
        return fly_compiled(lifting(law, **change), FixedStep(0.1), 1.0)

    for gain in (0.0, 0.002):
        history = flown(flight(gain).history)
        wish = history.commands if change else history.controls
        speed = history.states.velocity
        deviation = wish.angle_of_attack - (0.15 + 0.1 * (speed - 500.0) / 6000.0)
        bank = np.degrees(np.abs(np.arctan2(wish.sin_bank, wish.cos_bank)))
        if gain == 0.0:
            np.testing.assert_allclose(deviation, 0.0, atol=1e-12)
            np.testing.assert_allclose(bank, 60.0, atol=1e-9)
            continue
        # More drag than it is to have: a smaller angle, and less bank.
        assert np.min(deviation) < -1 * degree
        assert np.min(bank) == pytest.approx(48.0, abs=1e-9)
        assert np.max(bank) <= 72.0 + 1e-9
        early = speed > 6500.0
        np.testing.assert_allclose(bank[early], 60.0, atol=1e-9)


def test_modulation_by_the_drag_of_the_instant_is_refused_where_it_is_flown_at_once():
    with pytest.raises(ValueError, match="algebraic|sensed at the same instant"):
        fly(lifting(compose(modulation(), steady())), FixedStep(1.0))


@pytest.mark.slow
def test_held_through_ever_shorter_cycles_it_is_the_continuous_one():
    """Under an attitude that takes its time; at first order in the period."""
    pair = compose(modulation(), steady(0.5))

    def end(law):
        scenario = lifting(law, attitude=lagging())
        return float(fly_compiled(scenario, FixedStep(0.25)).state.longitude)

    limit = end(pair)
    far = [abs(end(Sampled(pair, period)) - limit) for period in (4.0, 1.0)]
    assert far[1] < 0.4 * far[0]


@pytest.mark.slow
@pytest.mark.parametrize("leaf", ["angle_of_attack.gain", "bank.cos_bank.coefficients"])
def test_derivatives_reach_both_halves(leaf):
    given = lifting(compose(modulation(), steady(0.5)), attitude=lagging())
    where = eqx.filter_jit(lambda s: fly(s, FixedStep(0.5)).state.longitude)
    names = leaf.split(".")

    def lens(s):
        for name in ("guidance", *names):
            s = getattr(s, name)
        return s

    def at(x):
        return where(with_leaf(given, lens, jnp.reshape(x, jnp.shape(lens(given)))))

    start = jnp.sum(lens(given))
    _, slope = jax.jvp(at, (start,), (jnp.ones_like(start),))
    h = 1e-5 * start
    difference = (at(start + h) - at(start - h)) / (2.0 * h)
    # Second order in the step of a smooth flight.
    np.testing.assert_allclose(slope, difference, rtol=1e-5)
    assert abs(float(slope)) > 1e-4


# What is refused.


def test_cycles_that_differ_are_refused():
    with pytest.raises(ValueError, match="angle-of-attack law is 1.0 s and .* 2.0 s"):
        compose(Sampled(modulation(), 1.0), Sampled(steady(), 2.0))

    class Shortening(Counting):
        cycle: ShorteningCycle = ShorteningCycle()  # type: ignore

    with pytest.raises(ValueError, match="ShorteningCycle cannot be composed"):
        compose(Shortening(), steady())


@pytest.mark.parametrize("hold", [lambda law: law, lambda law: Sampled(law, 1.0)])
def test_a_bank_law_with_an_angle_of_attack_of_its_own_is_refused(hold):
    for law in (steady(angle_of_attack=0.2), ConstantBank(0.5)):
        pair = compose(modulation(), hold(law))
        with pytest.raises(ValueError, match="an angle of attack of its own"):
            fly(lifting(pair, attitude=lagging()), FixedStep(1.0))


def test_half_a_law_is_refused():
    with pytest.raises(ValueError, match=r"DragModulation commands .*compose\(law"):
        fly(lifting(modulation(), attitude=lagging()), FixedStep(1.0))
    with pytest.raises(ValueError, match="BankProfile commands .*AngleOfAttackCommand"):
        fly(lifting(compose(steady(), steady())), FixedStep(1.0))
    with pytest.raises(ValueError, match=r"Asking commands .*compose\(law"):
        fly(lifting(compose(Asking(0.1), Asking(0.1))), FixedStep(1.0))


@pytest.mark.slow
def test_an_observer_law_flies_beside_modulation():
    pair = compose(modulation(), observer_law(reference()))
    scenario = lifting(Sampled(pair, 1.0))
    flight = fly_compiled(scenario, FixedStep(0.5))
    assert np.isfinite(float(flight.state.velocity))
    assert set(flight.caveats) == set()
