"""Every model and law of the package is in the lists that the tests go through."""

import dataclasses
import importlib
import pkgutil

import equinox as eqx
import helpers
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from laws import all_laws
from worlds import all_aerodynamics, all_atmospheres, all_gravities, all_winds

import jentry
from jentry.guidance import (
    AbstractLaw,
    AbstractSampledLaw,
    BezierGuidance,
    ReplannedTracking,
)
from jentry.motion import EntryState
from jentry.onboard import measure
from jentry.units import degree, km
from jentry.world import (
    AbstractAerodynamics,
    AbstractAtmosphere,
    AbstractGravity,
    AbstractWind,
)


def of_the_package(abstract):
    """Names of the classes of the package that are of a kind and can be made."""
    for module in pkgutil.walk_packages(jentry.__path__, "jentry."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    found, kinds = set(), [abstract]
    while kinds:
        kind = kinds.pop()
        kinds += kind.__subclasses__()
        ours = kind.__module__.startswith("jentry.")
        if ours and not kind.__name__.startswith("Abstract"):
            found.add(kind.__name__.partition("[")[0])
    return found


@pytest.mark.parametrize(
    ("abstract", "makers"),
    [
        (AbstractAtmosphere, all_atmospheres),
        (AbstractAerodynamics, all_aerodynamics),
        (AbstractWind, all_winds),
        (AbstractGravity, all_gravities),
    ],
)
def test_every_model_is_in_the_list_of_its_kind(abstract, makers):
    assert {type(make()).__name__ for make in makers.values()} == of_the_package(
        abstract
    )


def test_every_law_is_in_the_list(reference):
    laws = [make(reference) for make in all_laws.values()]
    # Those that choose the angle of attack or the bank alone are parts of others.
    for law in laws:
        laws += [part for part in vars(law).values() if isinstance(part, AbstractLaw)]
    assert {type(law).__name__ for law in laws} == of_the_package(AbstractLaw)


@pytest.mark.parametrize("name", all_gravities)
def test_gravity_is_the_slope_of_its_potential(name):
    gravity = all_gravities[name]()
    radius, latitude = jnp.asarray(3.5e6), jnp.asarray(0.7)
    slope, aside = jax.grad(gravity.potential_at, (0, 1))(radius, latitude)
    down, north = gravity.components(radius, latitude)
    # Towards the centre is down: rounding of one product.
    assert float(down) == pytest.approx(float(slope), rel=1e-14)
    assert float(slope) > 0.0
    assert (north is None) == gravity.is_central
    assert float(aside) == pytest.approx(0.0 if north is None else -north * radius)


# Every law, without a flight: what it commands and remembers at one instant.


def command_of(law, memory, held, measurement):
    """All that a law says at one time, as a vector: a decision, a command, a rate."""
    time = jnp.asarray(80.0)
    if isinstance(law, AbstractSampledLaw):
        memory, held = law.update(time, measurement, memory, held)
        said = memory, held, law(time, measurement, memory, held)
    else:
        said = law(time, measurement, memory)
    return ravel_pytree(eqx.filter(said, eqx.is_inexact_array))[0]


@eqx.filter_jit
def pushed_and_near(law, measurement, direction, step):
    """The derivative of what a law says along a direction, and two values beside it."""
    numbers, structure = eqx.partition(law, eqx.is_inexact_array)
    memory_and_held = law.init(measurement)
    if not isinstance(law, AbstractSampledLaw):
        memory_and_held = memory_and_held, None

    def said(numbers, measurement):
        return command_of(
            eqx.combine(numbers, structure), *memory_and_held, measurement
        )

    at = numbers, measurement
    _, pushed = jax.jvp(said, at, direction)
    beside = jax.lax.map(
        lambda h: said(*jax.tree.map(lambda x, d: x + h * d, at, direction)),
        step * jnp.array([1.0, -1.0, 0.5, -0.5]),
    )
    wide = (beside[0] - beside[1]) / (2.0 * step)
    narrow = (beside[2] - beside[3]) / step
    return beside[0], pushed, narrow + (narrow - wide) / 3.0


def measured(law, state, drag=1.002, lift=0.97):
    """In this state on Mars, or for the glider on its way; not as modelled."""
    if isinstance(law, BezierGuidance):
        planet, vehicle = law.model.planet, law.model.vehicle
        numbers = (0.002, 0.4, 5200.0, -0.3 * degree, 0.5 * degree)
        state = EntryState(39 * km, *(jnp.asarray(x) for x in numbers))
    else:
        planet, vehicle = helpers.mars_planet(), helpers.mars_vehicle()
    if isinstance(law, ReplannedTracking):
        # Its prediction is that of a glider.
        vehicle = eqx.tree_at(
            lambda v: v.trim_angle_of_attack,
            law.law.model.onboard.vehicle,
            jnp.asarray(20.0 * degree),
        )
    truth = measure(planet, vehicle, state, vehicle.trim_angle_of_attack)
    return dataclasses.replace(
        truth, state=state, lift=lift * truth.lift, drag=drag * truth.drag
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", all_laws)
def test_what_a_law_says_has_the_derivatives_of_differences(name, planned):
    _, flight, references = planned
    law = helpers.mars_scenario(all_laws[name](references["energy"])).law
    if isinstance(law, BezierGuidance):
        # Its drag has a corner at 10 degrees, which is where it is trimmed.
        trim = lambda law: law.model.vehicle.trim_angle_of_attack
        law = eqx.tree_at(trim, law, jnp.asarray(11.5 * degree))
    # On the planned flight after 80 s, where the command is not at its limit.
    measurement = measured(law, jax.tree.map(lambda x: x[800], flight.states))
    numbers = eqx.filter(law, eqx.is_inexact_array)
    # Each number by a share of its own; those of the tables together.
    share = iter(np.random.default_rng(3).uniform(-1.0, 1.0, 500))
    direction = jax.tree.map(lambda x: next(share) * x, (numbers, measurement))
    # What replanning predicts, far ahead and over the energy, bends more.
    step = 1e-5 if isinstance(law, ReplannedTracking) else 1e-4
    value, pushed, numeric = pushed_and_near(law, measurement, direction, step)
    assert np.all(np.isfinite(value))
    assert np.count_nonzero(pushed) >= 2  # cosine and sine of the bank at least
    # Richardson's fourth order of such a share, and rounding over it.
    close = 1e-10 * np.max(np.abs(value)) + 1e-6 * np.max(np.abs(pushed))
    np.testing.assert_allclose(pushed, numeric, rtol=1e-6, atol=close)
