"""The guidance cycle is data of a law: a wrapper that forwards all changes nothing."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ConstantBank, mars_scenario
from laws import all_laws

from jentry.fields import Scalar
from jentry.flight import FixedStep, fly
from jentry.flight.effect import require_felt
from jentry.guidance import (
    AbstractContinuousLaw,
    AbstractSampledLaw,
    AbstractTimedDecision,
    FixedCycle,
    Sampled,
    ShorteningCycle,
)
from jentry.missions import find_mission
from jentry.missions.mars.range_tracking import three_dimensional
from jentry.motion import Controls, EntryDynamics


class Continuous(AbstractContinuousLaw):
    """Forwards all."""

    law: AbstractContinuousLaw

    def init(self, measurement):
        return self.law.init(measurement)

    def __call__(self, time, measurement, memory):
        return self.law(time, measurement, memory)


class Cycling(AbstractSampledLaw):
    """Forwards all."""

    law: AbstractSampledLaw

    @property
    def cycle(self):
        return self.law.cycle

    def caveats(self, held):
        return self.law.caveats(held)

    def init(self, measurement):
        return self.law.init(measurement)

    def update(self, time, measurement, memory, held):
        return self.law.update(time, measurement, memory, held)

    def __call__(self, time, measurement, memory, held):
        return self.law(time, measurement, memory, held)


def wrapped(law):
    return Continuous(law) if isinstance(law, AbstractContinuousLaw) else Cycling(law)


class Timed(AbstractTimedDecision):
    duration: Scalar
    sign: Scalar


class Untimed(eqx.Module):
    sign: Scalar


class Switching(AbstractSampledLaw):
    """Reverses its bank at cycles that become shorter; a toy of the glider's law."""

    timed: bool = eqx.field(default=True, static=True)
    cycle: ShorteningCycle = ShorteningCycle(4.0, shorter=((30.0, 1.0), (8.0, 0.5)))

    def init(self, measurement):
        one = 1.0 + 0.0 * measurement.drag
        return (), Timed(4.0 * one, one) if self.timed else Untimed(one)

    def update(self, time, measurement, memory, held):
        if not self.timed:
            return (), held
        duration = self.cycle.duration(60.0 - time, held.duration)
        return (), Timed(duration, -held.sign)

    def __call__(self, time, measurement, memory, held):
        nothing = jnp.zeros_like(held.sign)
        return Controls(nothing, nothing + 0.6, 0.8 * held.sign), ()


def test_minute_guidance_periods_are_refused():
    """They would be a flight that never ends, in steps that nobody has asked for."""
    law = Sampled(ConstantBank(0.8), 1e-9)
    with pytest.raises(
        ValueError, match=r"guidance period is 1e-09 s: .* 1e\+09 cycles"
    ):
        fly(mars_scenario(law, 300.0))


class Numpy(AbstractContinuousLaw):
    """A law whose author has forgotten `table`."""

    banks: np.ndarray

    def init(self, measurement):
        return ()

    def __call__(self, time, measurement, memory):
        bank = jnp.asarray(self.banks)[1]
        return Controls(jnp.zeros_like(bank), jnp.cos(bank), jnp.sin(bank)), ()


def test_effects_are_found_of_a_law_with_arrays_of_numpy():
    scenario = mars_scenario(Numpy(np.array([0.1, 0.8])))
    require_felt(scenario, ["vehicle.mass"])
    with pytest.raises(ValueError, match="vehicle.trim_angle_of_attack has no"):
        require_felt(scenario, ["vehicle.trim_angle_of_attack"])


def program(law, scenario, history):
    """What is compiled for a flight: the same text is the same numbers, bit by bit."""
    flown = eqx.tree_at(lambda s: s.guidance, scenario, law)
    numbers, rest = eqx.partition(flown, eqx.is_array)

    def end(numbers):
        return eqx.filter(
            fly(eqx.combine(numbers, rest), FixedStep(), history), eqx.is_array
        )

    return jax.jit(end).lower(numbers).as_text()


def scenarios():
    reference = three_dimensional().guidance.reference
    table = {name: mars_scenario(law(reference)) for name, law in all_laws.items()}
    # No limits are meant for this one, which would keep them.
    table["Bézier"] = dataclasses.replace(table["Bézier"], constraints={})
    table["range tracking"] = three_dimensional()
    table["shortening cycle"] = mars_scenario(Switching(), 60.0)
    return table


HISTORIES = {
    None: (*list(all_laws)[::2], "shortening cycle"),
    # The loops that keep a history ask for the cycle of a law, and for nothing else.
    20.0: ("observer", "range tracking", "composition", "shortening cycle"),
}


@pytest.mark.slow
@pytest.mark.parametrize("history", HISTORIES)
def test_a_wrapper_that_forwards_all_is_the_identity(history):
    given = scenarios()
    for name in HISTORIES[history]:
        scenario = given[name]
        law = scenario.guidance
        alone, inside = (program(x, scenario, history) for x in (law, wrapped(law)))
        assert alone == inside, name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variant", "history"), [("stored", None), ("stored", 20.0), ("newton", None)]
)
def test_the_glider_in_a_wrapper_flies_the_same(variant, history):
    scenario = find_mission("cav-h").scenario_of(variant)
    law = scenario.guidance
    alone, inside = (program(x, scenario, history) for x in (law, wrapped(law)))
    assert alone == inside


def test_a_cycle_that_becomes_shorter_decides_when_it_should():
    """From 4 s on the clock to 1 s inside 30 s of the end and 0.5 s inside 8 s."""
    decided = [0.0]
    while decided[-1] < 60.0:
        left = 60.0 - decided[-1]
        decided.append(
            decided[-1] + (0.5 if left < 8.0 else 1.0 if left < 30.0 else 4.0)
        )
    scenario = mars_scenario(Switching(), 60.0, dynamics=EntryDynamics())
    flight = eqx.filter_jit(fly)(scenario, FixedStep(), 4.0)
    signs = [float(x) for x in flight.history.decisions.sign]
    times = [float(x) for x in flight.history.time]
    count = [sum(d <= t for d in decided) for t in times]
    assert times == [4.0 * k for k in range(15)]
    assert signs == [(-1.0) ** n for n in count]


def test_what_is_held_must_tell_its_duration():
    with pytest.raises(ValueError, match="ShorteningCycle and holds a Untimed"):
        fly(mars_scenario(Switching(timed=False), 10.0))


@pytest.mark.parametrize("period", [0.0, -1.0, float("nan")])
def test_a_period_is_positive(period):
    for cycle in (FixedCycle, ShorteningCycle):
        with pytest.raises(ValueError, match="it must be positive"):
            cycle(period)


def test_most_cycles_of_a_flight():
    assert FixedCycle(0.1).most_cycles(10.0) == 100
    assert FixedCycle(3.0).most_cycles(10.0) == 4
    cycle = ShorteningCycle(1.0, shorter=((120.0, 0.1), (15.0, 0.02)))
    assert cycle.most_cycles(2000.0) == 2000 + 2400 + 1500


class Odd(AbstractContinuousLaw):
    """Gives what it is told to."""

    given: Callable = eqx.field(static=True)

    def init(self, measurement):
        return jnp.zeros(2)

    def __call__(self, time, measurement, memory):
        return self.given(memory)


LEVEL = Controls.from_bank(jnp.asarray(0.0), jnp.asarray(0.0))

ODD = {
    "no pair": (lambda memory: LEVEL, "Odd.__call__ gives .*two things, its command"),
    "an angle": (
        lambda memory: (jnp.asarray(0.3), memory),
        r"Odd commands .*: it must be Controls, such as Controls.from_bank",
    ),
    "many": (
        lambda memory: (eqx.tree_at(lambda c: c.cos_bank, LEVEL, memory), memory),
        r"Odd commands a cos_bank of shape \(2,\): it must be one number",
    ),
    "another shape": (
        lambda memory: (LEVEL, jnp.zeros(3)),
        r"rate of its memory of Odd is \(3,\): it must be like .*, \(2,\)",
    ),
    "another tree": (
        lambda memory: (LEVEL, {"a": memory}),
        "rate of its memory of Odd is PyTreeDef.*'a'",
    ),
}


@pytest.mark.parametrize("given, said", ODD.values(), ids=ODD)
def test_a_law_that_gives_something_else_is_named(given, said):
    with pytest.raises(ValueError, match=said):
        eqx.filter_eval_shape(fly, mars_scenario(Odd(given)), FixedStep(1.0))
