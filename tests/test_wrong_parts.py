"""Parts of a scenario that are of another class or shape are refused by name."""

import copy
import dataclasses

import cheap
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jentry import find_mission
from jentry.flight.scenario_checks import check
from jentry.onboard import (
    Altimeter,
    InertialNavigation,
    KnowledgeError,
    NavigationFilter,
)
from jentry.units import degree


WRONG = {
    "planet": "Planet",
    "vehicle": "Vehicle",
    "initial_state": "EntryState",
    "guidance": "AbstractLaw",
    "termination": "Termination",
    "target": "Target or OrbitTarget",
    "accelerometers": "AbstractAccelerometers",
    "navigation": "AbstractNavigation",
    "attitude": "AbstractAttitude",
    "dynamics": "AbstractDynamics",
    "constraints": "Mapping",
}


@pytest.mark.parametrize("name", WRONG)
def test_a_part_of_another_class(name):
    """`eqx.tree_at` does not look, so that `check` must."""
    lens = lambda s: getattr(s, name)
    for wrong, kind in ((None, "NoneType"), (type(cheap.scenario()), "Scenario")):
        other = eqx.tree_at(lens, cheap.scenario(), wrong, is_leaf=lambda x: x is None)
        said = f"{name} is of {kind}: it must be an object of {WRONG[name]}$"
        with pytest.raises(ValueError, match=said):
            other.__check_init__()


def test_a_part_that_is_left_out():
    with pytest.raises(ValueError, match="navigation is of NoneType"):
        check(eqx.tree_at(lambda s: s.navigation, cheap.scenario(), None))


def test_several_numbers_for_one():
    lens = lambda s: s.vehicle.mass
    other = eqx.tree_at(lens, cheap.scenario(), jnp.array([900.0, 950.0]))
    said = r"vehicle\.mass has the shape \(2,\): it must be one number.*inputs="
    with pytest.raises(ValueError, match=said):
        check(other)


def test_a_step_is_no_array():
    """It is compared with others: an array would fail there, without its name."""
    for wrong in (jnp.asarray(0.5), np.asarray(0.5)):
        with pytest.raises(ValueError, match=r"step is the array 0\.5: .* step=0\.5"):
            with_step(wrong)
    with_step(np.float64(0.5))


def with_step(step):
    """Checked as when it is made. Annotations, which are enforced here, are not."""
    made = copy.copy(cheap.scenario())
    object.__setattr__(made, "step", step)
    made.__check_init__()


@pytest.mark.parametrize("name", ["tilt_east", "tilt_north", "tilt_up"])
def test_a_tilt_that_is_not_small(name):
    """The navigation leaves out its square, 12 % of the force at 0.5 rad."""
    scenario = dataclasses.replace(
        find_mission("mars-range-tracking").scenario(), navigation=InertialNavigation()
    )
    lens = lambda s: getattr(s.navigation.knowledge, name)
    for wrong, hint in ((0.5, "; did you mean 0.5deg"), (-10.0 * degree, "")):
        with pytest.raises(ValueError, match=f"{name} is .* 5.72958 deg{hint}"):
            check(eqx.tree_at(lens, scenario, jnp.asarray(wrong)))
    check(eqx.tree_at(lens, scenario, jnp.asarray(5.7 * degree)))


def test_sensors_of_another_class():
    knowledge = KnowledgeError(*9 * [1e-3])
    altimeter = Altimeter(noise=1.0, largest_altitude=1e4, cycle=1.0)
    for wrong, said in (
        ([altimeter], r'sensors is of list: .* \{"altimeter": Altimeter'),
        ({"radar": None}, r"sensors\.radar is of NoneType: it must be an Abstract"),
    ):
        with pytest.raises(ValueError, match=said):
            NavigationFilter(knowledge, wrong)  # pyright: ignore[reportArgumentType]
    NavigationFilter(knowledge, {"radar": altimeter})


def test_correlations_that_are_not_finite():
    matrix = np.eye(9)
    matrix[3, 4] = matrix[4, 3] = np.nan
    knowledge = KnowledgeError(*9 * [1e-3])
    with pytest.raises(ValueError, match="correlations .* must be finite numbers"):
        NavigationFilter(knowledge, {}, correlations=matrix)
