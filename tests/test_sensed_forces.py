"""Forces are sensed at the angle of attack that is flown, and a law cannot make a loop."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, mars_planet, mars_scenario, with_leaf

from jentry._dependence import Traced
from jentry.campaign import Dispersion, Uniform, monte_carlo
from jentry.fields import Scalar
from jentry.flight import FixedStep, fly
from jentry.flight.closed_loop import start
from jentry.flight.lane import Moving
from jentry.flight.scenario_checks import check
from jentry.flight.sensing import command, first_measurement, sense
from jentry.guidance import (
    AbstractContinuousLaw,
    AbstractSampledLaw,
    BankProfile,
    FixedCycle,
    Sampled,
    SmoothReversals,
)
from jentry.motion import Controls
from jentry.motion.index import EnergyIndex
from jentry.onboard import Accelerometers, PolynomialProfile
from jentry.planning.reference_flight import ReferenceFlight, plan_drag_reference
from jentry.world import PolynomialAerodynamics, Vehicle


LIFT, DRAG = (0.1, 1.0), (0.5, 0.0, 12.0)
"""Coefficients over the angle of attack: the drag doubles at 0.2 rad"""

TRIM = 0.05

TICK = 5.0


class Recording(AbstractContinuousLaw[Scalar]):
    """Commands an angle of attack, and tells what it senses by the cosine of the bank.

    With the sine, for the lift, that is less than a bank: a surrogate may command it.
    Memory begins with the first drag that is sensed, and its rate is the drag.
    """

    angle: float = eqx.field(static=True)
    per_drag: float = eqx.field(default=0.0, static=True)
    per_velocity: float = eqx.field(default=0.0, static=True)
    per_memory: float = eqx.field(default=0.0, static=True)
    surrogate: SmoothReversals = SmoothReversals()

    def init(self, measurement):
        return measurement.drag

    def __call__(self, time, measurement, memory):
        angle = self.angle + self.per_velocity * measurement.state.velocity
        # What is multiplied by zero counts as used.
        if self.per_memory:
            angle = angle + self.per_memory * memory
        if self.per_drag:
            angle = angle + self.per_drag * measurement.drag
        lift, drag = measurement.lift, measurement.drag
        return Controls(angle, drag / 1e3, lift / 1e3), drag


class Acting(AbstractSampledLaw[Scalar, Scalar]):
    """Decides its angle of attack by the drag, or acts on it between its decisions."""

    between: bool = eqx.field(default=False, static=True)
    cycle: FixedCycle = FixedCycle(TICK)
    surrogate: SmoothReversals = SmoothReversals()

    def init(self, measurement):
        return measurement.drag, 0.1 + 0.0 * measurement.drag

    def update(self, time, measurement, memory, held):
        return memory, 0.1 + 1e-3 * measurement.drag

    def __call__(self, time, measurement, memory, held):
        angle = 1e-3 * measurement.drag if self.between else held
        return Controls(angle, measurement.drag / 1e3, 0.0 * held), 0.0 * held


def vehicle() -> Vehicle:
    aerodynamics = PolynomialAerodynamics(jnp.array(LIFT), jnp.array(DRAG))
    return Vehicle(
        992.0, 16.0, aerodynamics=aerodynamics, trim_angle_of_attack=jnp.asarray(TRIM)
    )


def scenario(law, time_limit=60.0):
    """At 40 km, where the drag is large, for a minute."""
    flown = dataclasses.replace(mars_scenario(law, time_limit), vehicle=vehicle())
    places = lambda s: (s.initial_state.altitude, s.initial_state.flight_path_angle)
    return eqx.tree_at(places, flown, (jnp.asarray(60e3), jnp.asarray(-0.05)))


def forces(states, angle):
    """Specific lift and drag by the textbook, of an exponential atmosphere."""
    density = 0.0158 * np.exp(-np.asarray(states.altitude) / 9354.5)
    loading = 0.5 * density * np.asarray(states.velocity) ** 2 * 16.0 / 992.0
    lift = LIFT[0] + LIFT[1] * angle
    return loading * lift, loading * (DRAG[0] + DRAG[2] * angle**2)


def test_a_continuous_law_senses_the_forces_that_it_flies():
    """Also where its angle of attack moves; today's trim would be 40 % too little."""
    law = Recording(0.5, per_velocity=-5e-5)
    flight = fly_compiled(scenario(law), FixedStep(1.0), TICK)
    history = flight.history
    there = np.isfinite(np.asarray(history.time))
    assert there.sum() > 8
    velocity = np.asarray(history.states.velocity)
    lift, drag = forces(history.states, 0.5 - 5e-5 * velocity)
    sensed = 1e3 * np.asarray(history.controls.cos_bank)
    np.testing.assert_allclose(sensed[there], drag[there], rtol=1e-13)
    np.testing.assert_allclose(
        1e3 * np.asarray(history.controls.sin_bank)[there], lift[there], rtol=1e-13
    )
    # What is counted as a peak is sensed too.
    np.testing.assert_allclose(
        history.constraints.drag[there], sensed[there], rtol=1e-15
    )


@pytest.mark.slow
@pytest.mark.parametrize("wrapped", [False, True])
def test_a_sampled_law_senses_the_angle_of_attack_that_is_held(wrapped):
    """The angle of attack may then depend on the drag: on that before the decision."""
    law = Acting()
    if wrapped:
        law = Sampled(Recording(0.1, per_drag=1e-3), TICK)
    flight = fly_compiled(scenario(law), FixedStep(1.0), TICK)
    history = flight.history
    there = np.isfinite(np.asarray(history.time))
    angle = np.asarray(history.controls.angle_of_attack)
    # Before the first cycle: what `init` holds, decided at trim if by the drag at all.
    before = 0.1
    if wrapped:
        before += 1e-3 * forces(scenario(law).initial_state, TRIM)[1]
    _, sensed = forces(history.states, np.append(before, angle[:-1]))
    np.testing.assert_allclose(angle[there], 0.1 + 1e-3 * sensed[there], rtol=1e-13)


def test_a_memory_begins_with_the_forces_that_are_flown():
    law = Recording(0.2)
    lane = start(scenario(law), 1.0)
    _, drag = forces(lane.state, 0.2)
    assert float(lane.memory) == pytest.approx(drag, rel=1e-13)
    # The first angle of attack may not depend on what is sensed at it: then at trim.
    lane = start(scenario(Recording(0.2, per_memory=1e-3)), 1.0)
    _, drag = forces(lane.state, TRIM)
    assert float(lane.memory) == pytest.approx(drag, rel=1e-13)


def test_guidance_may_be_told_another_angle_of_attack_than_is_flown():
    """The forces stay those of the one that is flown."""
    mistaken = dataclasses.replace(scenario(Recording(0.2)), angle_of_attack_error=0.03)
    lane = start(mistaken, 1.0)
    told = sense(mistaken, lane.flown, lane.moving, lane.held)
    lift, drag = forces(lane.state, 0.2)
    assert float(told.angle_of_attack) == pytest.approx(0.23, rel=1e-13)
    assert float(told.drag) == pytest.approx(drag, rel=1e-13)
    assert float(told.lift) == pytest.approx(lift, rel=1e-13)
    assert float(first_measurement(mistaken).angle_of_attack) == pytest.approx(0.23)
    flown, _ = command(mistaken, lane.flown, lane.moving, lane.held)
    assert float(flown.angle_of_attack) == 0.2


def test_trim_of_the_vehicle_moves_no_sensor_alone():
    """A law that commands the trim of its model flies and senses that one."""
    held = scenario(Recording(0.2))
    moved = with_leaf(held, lambda s: s.vehicle.trim_angle_of_attack, 0.3)
    sensed = [
        command(
            s, jnp.asarray(0.0), Moving(s.initial_state, None, jnp.asarray(1.0)), None
        )
        for s in (held, moved)
    ]
    assert float(sensed[0][1]) == float(sensed[1][1])


def refused(law, transform=lambda f: f):
    flown = scenario(law)
    velocity = lambda s: fly(s, FixedStep(1.0)).state.velocity
    with pytest.raises(ValueError) as caught:
        transform(velocity)(flown)
    return str(caught.value)


@pytest.mark.parametrize(
    "transform",
    [
        jax.jit,
        jax.grad,
        lambda f: (
            lambda s: jax.vmap(
                lambda v: f(with_leaf(s, lambda s: s.initial_state.velocity, v))
            )(jnp.linspace(6000.0, 6100.0, 3))
        ),
    ],
)
def test_an_algebraic_loop_is_refused(transform):
    said = refused(Recording(0.1, per_drag=1e-3), transform)
    assert said.startswith("Recording commands an angle of attack that depends on")
    assert "Sampled(law, period)" in said
    said = refused(Acting(between=True), transform)
    assert said.startswith("Acting commands") and "decide it at the guidance" in said


X = jnp.asarray(1.0)


def value_without(function, x):
    return Traced(function, x).independent(lambda out: out)


def depends_on(function, x):
    return Traced(function, x).depends()


@pytest.mark.parametrize(
    "hidden",
    [
        lambda x: jnp.where(x > 0.0, 1.0, 2.0),
        jax.lax.stop_gradient,
        lambda x: jnp.where(True, 1.0, jax.jit(jnp.sin)(x)),
        lambda x: jax.lax.cond(x > 1e9, lambda: 1.0, lambda: 2.0),
        lambda x: jax.lax.while_loop(lambda i: i < x, lambda i: i + 1.0, 0.0),
        lambda x: jax.lax.scan(lambda c, _: (X + x, c), X, None, 3)[0],
        lambda x: jax.checkpoint(lambda x: jnp.floor(x))(x),
        lambda x: jnp.round(0.1 * x).astype(int) * 1.0,
        lambda x: jax.vmap(lambda y: y * x)(jnp.ones(2))[0],
        lambda x: jnp.zeros(3).at[jnp.round(x).astype(int)].set(1.0)[0],
    ],
)
def test_no_dependence_is_overlooked(hidden):
    """Where a derivative, or a NaN, would not tell."""
    assert depends_on(hidden, X)
    assert value_without(hidden, X) is None


def test_what_does_not_depend_is_not_taken_for_it():
    y = jnp.asarray(0.3)

    @jax.jit
    def both(x):
        return jnp.sin(y), jnp.cos(x)

    independent = [
        lambda x: y,
        lambda x: 0.3,
        lambda x: jnp.zeros_like(x),
        lambda x: both(x)[0],
        lambda x: jax.checkpoint(both)(x)[0],
        lambda x: jnp.clip(y, 0.0, 1.0),
    ]
    for function in independent:
        assert not depends_on(function, X)
        found = value_without(function, X)
        assert float(found) == float(function(X))
    # Of several outputs each is judged by itself, and all can be called.
    traced = Traced(lambda x: {"a": 2.0 * y, "b": x * y}, X)
    assert float(traced.independent(lambda out: out["a"])) == 0.6
    assert traced.independent(lambda out: out["b"]) is None
    found = traced(jnp.asarray(3.0))
    assert (float(found["a"]), float(found["b"])) == (0.6, 3.0 * 0.3)
    # With a tangent and under a batch it is the value of these.
    slope = jax.grad(lambda y: value_without(lambda x: jnp.sin(y) + 0 * y, X))(y)
    assert float(slope) == pytest.approx(np.cos(0.3), rel=1e-15)
    batch = jax.vmap(lambda y: value_without(lambda x: 2.0 * y, X))(jnp.arange(3.0))
    np.testing.assert_array_equal(batch, 2.0 * np.arange(3.0))


def test_noise_needs_a_law_that_reads_at_its_cycles():
    """Told by what the law does, not by what it says."""
    noisy = lambda law: dataclasses.replace(
        scenario(law), accelerometers=Accelerometers(noise=1e-3)
    )
    for law in (Recording(0.2), Acting()):
        with pytest.raises(ValueError, match=f"{type(law).__name__} reads its sensors"):
            fly(noisy(law))
        # Nor is it smuggled in by a dispersion.
        silent = dataclasses.replace(scenario(law), accelerometers=Accelerometers())
        table = {
            "noise": Dispersion(lambda s: s.accelerometers.noise, Uniform(0, 1e-3))
        }
        with pytest.raises(
            ValueError, match="accelerometers.noise is varied: .* reads"
        ):
            monte_carlo(silent, table, jax.random.key(0), 2)
    check(noisy(Held()))


class Held(AbstractSampledLaw[tuple, Controls]):
    """All that it does it decides at its cycles."""

    cycle: FixedCycle = FixedCycle(1.0)

    def init(self, measurement):
        nothing = 0.0 * measurement.drag
        return (), Controls(nothing, nothing + 1.0, nothing)

    def update(self, time, measurement, memory, held):
        return (), Controls(1e-3 * measurement.drag, held.cos_bank, held.sin_bank)

    def __call__(self, time, measurement, memory, held):
        return held, ()


@pytest.mark.slow
def test_a_reference_is_the_drag_of_the_angle_of_attack_that_it_flies():
    """0.2 rad, where the vehicle trims at 0.05: at trim it would be half of it."""
    law = BankProfile(PolynomialProfile([0.6], 503.0, 6247.0), jnp.asarray(0.2))
    flown = scenario(law, 40.0)
    flight = ReferenceFlight.of(flown, 1.0)
    reference = plan_drag_reference(flight, EnergyIndex(), intervals=8)
    first = flown.initial_state
    planet = mars_planet()
    energy = EnergyIndex().value(planet, jnp.asarray(0.0), first)
    _, drag = forces(first, 0.2)
    assert float(reference.drag(energy)) == pytest.approx(drag, rel=1e-9)
