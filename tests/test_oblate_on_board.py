"""What laws and plans take on board: an oblate planet, or a clear refusal."""

import dataclasses

import helpers
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import all_laws
from test_every_model import command_of, measured
from worlds import WGS_84

from jentry import write_trajectory
from jentry.flight import (
    AltitudeBelow,
    FixedStep,
    Termination,
    navigation_errors,
)
from jentry.guidance import AbstractSampledLaw, GuidedEnd
from jentry.guidance.drag_tracking import drag_dynamics
from jentry.motion import (
    Controls,
    EntryDynamics,
    EntryState,
    air_data,
    entry_dynamics,
    geodetic_position,
)
from jentry.onboard import (
    Altimeter,
    InertialNavigation,
    KnowledgeError,
    LongitudinalModel,
    LongitudinalState,
    NavigationFilter,
    OnboardModel,
    PerfectNavigation,
    PolynomialProfile,
    measure,
    propagate,
)
from jentry.planning import ExactInverse, plan_glide
from jentry.units import degree, km
from jentry.world import ConstantWind, InverseSquareGravity, Planet, ZonalGravity


def with_j2(planet):
    parameter = getattr(planet.gravity, "gravitational_parameter", 4.28e13)
    gravity = ZonalGravity(parameter, planet.radius, {"j2": 1.9566e-3})
    return dataclasses.replace(planet, gravity=gravity)


def flattened(planet):
    shape = dataclasses.replace(WGS_84, equatorial_radius=planet.radius)
    return dataclasses.replace(planet, shape=shape)


OBLATE = {"gravity with J2": with_j2, "ellipsoid": flattened}

REFUSING = (
    "range tracking",
    "predictor-corrector",  # in the vertical plane
    "Bézier",
    "pseudospectral",
    "stored gains",
    "neural",
    "neural beside another",
    "neural with an angle of attack",
    "recorded",  # by inputs of a neural law
    "modulation composition",
    "terminal point",  # by its early end
    "Apollo",  # by the early end of its final phase
    "aerocapture",
)
"""Laws whose equations are those of a sphere with a central gravity"""


def on_board(law, change):
    """The law with another planet in its model."""
    is_planet = lambda node: isinstance(node, Planet)
    return jax.tree.map(
        lambda n: change(n) if is_planet(n) else n, law, is_leaf=is_planet
    )


def command(law, measurement):
    memory_and_held = law.init(measurement)
    if not isinstance(law, AbstractSampledLaw):
        memory_and_held = memory_and_held, None
    return command_of(law, *memory_and_held, measurement)


@pytest.mark.parametrize("change", OBLATE)
@pytest.mark.parametrize("name", all_laws)
def test_a_law_flies_with_an_oblate_planet_in_its_model_or_refuses_it(
    name, change, reference
):
    law = helpers.mars_scenario(all_laws[name](reference)).law
    state = EntryState(40 * km, 0.1, 0.4, 5000.0, -8 * degree, 80 * degree)
    measurement = measured(law, state)
    other = on_board(law, OBLATE[change])
    if name in REFUSING:
        with pytest.raises(ValueError, match="InverseSquareGravity"):
            jax.eval_shape(lambda m: command(other, m), measurement)
    else:
        assert np.all(np.isfinite(command(other, measurement)))


@pytest.mark.parametrize("change", OBLATE)
def test_a_prediction_in_space_takes_an_oblate_planet(change):
    state = EntryState(60 * km, 0.1, 0.4, 5000.0, -8 * degree, 80 * degree)
    planet = OBLATE[change](helpers.mars_planet())
    model = OnboardModel(planet, helpers.mars_vehicle())
    level = lambda time, state: Controls(0.0 * time, 1.0 + 0.0 * time, 0.0 * time)
    margin = GuidedEnd(altitude=20 * km).margins(planet)
    found = propagate(model, state, level, margin, step=1.0, steps=200)
    flown = dataclasses.replace(
        helpers.mars_scenario(helpers.ConstantBank(0.0), dynamics=EntryDynamics()),
        planet=planet,
        initial_state=state,
        termination=Termination({"low": AltitudeBelow(20 * km)}, 200.0),
    )
    flight = helpers.fly_compiled(flown, FixedStep(1.0))
    # The same steps: rounding, and the search for the end.
    assert float(found.time) == pytest.approx(float(flight.time), abs=1e-8)
    assert float(found.state.latitude) == pytest.approx(
        float(flight.state.latitude), abs=1e-12
    )


@pytest.mark.parametrize("change", OBLATE)
def test_the_modelled_drag_changes_as_along_the_motion(change):
    planet, vehicle = OBLATE[change](helpers.mars_planet()), helpers.mars_vehicle()
    state = EntryState(40 * km, 0.1, 0.7, 5000.0, -8 * degree, 30 * degree)
    angle = jnp.asarray(0.0)
    flat = Controls(angle, angle, 1.0 + angle)
    rates = entry_dynamics(planet, vehicle, state, flat)
    drag = lambda state: air_data(planet, vehicle, state, angle).drag
    expected = jax.jvp(drag, (state,), (rates,))[1]
    measurement = measure(planet, vehicle, state, angle)
    found = drag_dynamics(OnboardModel(planet, vehicle), measurement, angle)
    assert float(found.rate) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.parametrize("change", OBLATE)
def test_plans_in_a_plane_refuse_an_oblate_planet(change):
    planet, vehicle = OBLATE[change](helpers.mars_planet()), helpers.mars_vehicle()
    nothing = PolynomialProfile([0.0])
    refused = pytest.raises(ValueError, match="a sphere with a central gravity")
    with refused:
        plan_glide(planet, vehicle, nothing)
    with refused:
        ExactInverse(planet, vehicle, nothing, PolynomialProfile([20.0])).at(
            jnp.asarray(3000.0)
        )
    state = LongitudinalState(*map(jnp.asarray, (40e3, 5000.0, -0.1, 0.0)))
    with refused:
        model = LongitudinalModel(OnboardModel(planet, vehicle), nothing)
        model.rates(state, jnp.asarray(0.1))


def over_oblate_mars(navigation):
    """From its middle latitudes, in a wind."""
    wind = ConstantWind(30.0, 20.0)
    planet = flattened(with_j2(helpers.mars_planet(wind=wind, rotation_rate=7e-5)))
    state = EntryState(100 * km, 0.1, 0.7, 5500.0, -14 * degree, 30 * degree)
    return dataclasses.replace(
        helpers.mars_scenario(helpers.ConstantBank(0.9), dynamics=EntryDynamics()),
        planet=planet,
        initial_state=state,
        termination=Termination({"low": AltitudeBelow(15 * km)}, 400.0),
        navigation=navigation,
    )


def navigated(navigation):
    flown = over_oblate_mars(navigation)
    return flown, helpers.fly_compiled(flown, FixedStep(0.5))


@pytest.mark.slow
def test_inertial_navigation_knows_the_gravity_and_the_shape():
    flown, flight = navigated(InertialNavigation())
    off = navigation_errors(flown, flight)
    # Rounding of the equations, which are the same.
    assert abs(float(off.altitude)) < 1e-5 and float(off.distance) < 1e-5


@pytest.mark.slow
def test_inertial_navigation_with_a_central_gravity_drifts():
    """By half of the missing acceleration, 1.5 J2 g sin(2 latitude) to the south, t^2."""
    central = InverseSquareGravity(4.28283e13)
    flown, flight = navigated(InertialNavigation(gravity=central))
    off = navigation_errors(flown, flight)
    missing = 1.5 * 1.9566e-3 * 4.28283e13 / 3450e3**2 * np.sin(1.4)
    drift = 0.5 * missing * float(flight.time) ** 2
    # Half of it along the track and more across; the radial part adds a third.
    assert 0.7 * drift < float(off.distance) < 1.6 * drift


@pytest.mark.slow
def test_an_altimeter_measures_the_geodetic_altitude():
    sensor = Altimeter(noise=1.0, largest_altitude=80 * km, cycle=1.0)
    knowledge = KnowledgeError(up=300.0)
    deviations = KnowledgeError(1.0, 1.0, 300.0, 0.1, 0.1, 0.1, 1e-5, 1e-5, 1e-5)
    aided = NavigationFilter(deviations, {"altimeter": sensor})
    flown, flight = navigated(InertialNavigation(knowledge, filter=aided))
    # It would be off by kilometres if one of the two altitudes were above the sphere.
    assert abs(float(navigation_errors(flown, flight).altitude)) < 5.0


def test_paths_over_a_globe_are_geodetic(tmp_path):
    pytest.importorskip("simplekml")
    flown = over_oblate_mars(PerfectNavigation())
    flight = helpers.fly_compiled(flown, FixedStep(0.5), 10.0)
    write_trajectory(flown, flight, tmp_path / "flight.kml")
    text = (tmp_path / "flight.kml").read_text()
    last = text.split("</coordinates>")[0].split()[-1]
    longitude, latitude, altitude = (float(x) for x in last.split(","))
    expected = geodetic_position(flown.planet, flight.state)
    assert altitude == pytest.approx(15 * km, abs=1e-3)
    assert np.radians(latitude) == pytest.approx(float(expected[1]), abs=1e-9)
    assert np.radians(longitude) == pytest.approx(float(flight.state.longitude))
