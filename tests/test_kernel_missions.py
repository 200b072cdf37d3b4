"""The kernel of each mission, as a program in C, against the same flights by XLA."""

import functools
import shutil

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filter_flights import ALTIMETER, aided
from first_sets import populations, small_batches

from jentry.addresses import replace_leaves
from jentry.campaign import monte_carlo
from jentry.campaign.campaign import _fly_one, drawn_inputs
from jentry.flight import FixedStep, fly
from jentry.kernel import NotInKernel, kernel_of, with_tangents
from jentry.missions import ALL


RUNS = populations.FIRST_RUNS
"""As many as in `first_sets`: XLA flies some of them by a program of other tests"""

LAWS = {
    "mars-drag-tracking": "energy-index",
    "mars-range-tracking": "range-tracking",
    "cav-h": "newton",
    "sx-2": "small-angle",
    "rlv": "modulation",
    "x-33": "tracking",
    "apollo-10": "predictor-corrector",
    "cav-h-glide": "predictor-corrector",
    "msl": "terminal-point",
    "mars-aerocapture": "predictor-corrector",
    "neptune-aerocapture": "predictor-corrector",
}
"""The law of each mission whose kernel is flown"""


def flown_by_kernel(scenario, table, form, solver=FixedStep()):
    if form == "c" and shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    inputs = drawn_inputs(scenario, table, jax.random.key(0), np.arange(RUNS))
    inputs = {address: jnp.asarray(x) for address, x in inputs.items()}
    one = functools.partial(_fly_one, (scenario, solver, None))
    kernel = kernel_of(one, jax.tree.map(lambda x: x[0], inputs), form=form)
    return kernel(inputs)


def assert_same_flights(found, campaign, metres, apoapsis=0.0):
    """Outcomes are equal, and places at the end within some metres.

    With the altitude of the apoapsis of a target orbit: its error is a difference of two
    numbers of that size, each good to twelve digits.
    """
    flights, misses, believed, off = found
    theirs = campaign.misses
    assert believed is None and off is None
    np.testing.assert_array_equal(flights.outcome, campaign.flights.outcome)
    for name in ("downrange", "crossrange", "altitude"):
        if getattr(misses, name) is None:  # the target is an orbit
            continue
        apart = getattr(misses, name) - getattr(theirs, name)
        np.testing.assert_allclose(apart, 0.0, atol=metres, err_msg=name)
    if apoapsis > 0.0:
        off = misses.apoapsis - theirs.apoapsis
        np.testing.assert_allclose(off, 0.0, atol=1e-12 * apoapsis)
        misses, theirs = (
            eqx.tree_at(lambda m: m.apoapsis, x, None) for x in (misses, theirs)
        )
    leaves = [
        jax.tree.leaves(x) for x in ((flights, misses), (campaign.flights, theirs))
    ]
    for a, b in zip(*leaves, strict=True):
        assert a.dtype == b.dtype and a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)


def test_every_mission_with_dispersions_is_named():
    assert {name for name, m in ALL.items() if m.dispersions} == set(LAWS)


def test_a_flight_of_a_constant_bank():
    """What the missions do in the slow tests, every day."""
    scenario, table = cheap.scenario(), cheap.dispersions()
    found = flown_by_kernel(scenario, table, "c", cheap.SOLVER)
    campaign = monte_carlo(scenario, table, 0, RUNS, solver=cheap.SOLVER)
    assert_same_flights(found, campaign, 1e-6)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*decisions without prediction")
@pytest.mark.parametrize("name", LAWS)
def test_the_kernel_of_a_mission_flies_as_xla_does(name):
    mission = ALL[name]
    scenario, table = mission.scenario(LAWS[name]), mission.dispersion_table()
    found = flown_by_kernel(scenario, table, "c")
    with small_batches():
        campaign = monte_carlo(scenario, table, 0, RUNS)
    apoapsis = float(getattr(scenario.target, "apoapsis_altitude", 0.0))
    assert_same_flights(found, campaign, 1e-6, apoapsis)


@pytest.mark.slow
def test_the_kernel_of_a_flight_with_a_navigation_filter_flies_as_xla_does():
    scenario = aided({"altimeter": ALTIMETER}, 60.0)
    runs = {
        "navigation.seed": jnp.array([0.3, 0.33]),
        "navigation.knowledge.up": jnp.array([100.0, -700.0]),
    }
    one = functools.partial(_fly_one, (scenario, FixedStep(1.0), None))
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    example = jax.tree.map(lambda x: x[0], runs)
    found, expected = (
        kernel_of(one, example, form="c")(runs),
        jax.jit(jax.vmap(one))(runs),
    )
    # The filter has measured, and the errors at the end are not those at the start.
    assert np.all(np.asarray(expected[0].knowledge.measured["altimeter"]) > 40.0)
    assert np.all(np.abs(np.asarray(expected[0].knowledge.error.up)) < 30.0)
    for a, b in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_tangents_of_a_flight_are_its_derivatives():
    """The stop event included: of the place at the end, by the rule of the whole flight."""

    def end(run):
        angle, mass = run
        moved = {"initial_state.flight_path_angle": angle, "vehicle.mass": mass}
        flight = fly(replace_leaves(cheap.scenario(), moved), cheap.SOLVER)
        return flight.state.altitude, flight.time

    runs = jnp.array([-0.2, -0.21]), jnp.array([2750.0, 2850.0])
    directions = jnp.array([[1.0, 0.0]] * 2), jnp.array([[0.0, 1.0]] * 2)
    push = with_tangents(end)
    example = jax.tree.map(lambda x: x[0], (runs, directions))
    _, found = kernel_of(push, example, form="xla")((runs, directions))
    expected = jax.vmap(jax.jacfwd(end))(runs)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, jnp.stack(other, -1), rtol=1e-9)


@pytest.mark.slow
def test_a_law_with_a_large_system_is_refused_with_its_line():
    scenario = ALL["x-33"].scenario("receding")
    with pytest.raises(NotInKernel, match="solves 60 equations for each flight"):
        flown_by_kernel(scenario, ALL["x-33"].dispersion_table(), "xla")
