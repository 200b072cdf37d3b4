"""Air that departs from its model, by waves and a trend, and air without corners."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import free_scenario, over
from worlds import all_atmospheres

from jentry.campaign import Dispersion, Uniform, monte_carlo
from jentry.flight import Outcome, fly
from jentry.motion import EntryState
from jentry.motion.forces import air_data
from jentry.onboard import OnboardModel
from jentry.world import (
    ConstantAerodynamics,
    DensityWave,
    ExponentialAtmosphere,
    GroundWave,
    InverseSquareGravity,
    PerturbedAtmosphere,
    Planet,
    RandomAltitudeProfile,
    RandomAtmosphere,
    USStandardAtmosphere1976,
    Vehicle,
    smoothed,
    without_zero_perturbations,
)


def test_departures_of_the_density_add_up():
    air = all_atmospheres["perturbed"]()
    for altitude, share in ((20e3, 0.03), (55e3, 0.055), (90e3, 0.08)):
        expected = 1.0 + 1.2 * share
        expected += 0.05 * np.sin(2 * np.pi * altitude / 25e3 + 0.3)
        expected += 0.02 * np.sin(2 * np.pi * altitude / 8e3)
        expected += 0.02 * np.sin(1.0)  # the ground wave, at its origin
        altitude = jnp.asarray(altitude)
        ratio = air.density(altitude) / air.undisturbed.density(altitude)
        assert float(ratio) == pytest.approx(expected, rel=1e-13)
        for name in ("temperature", "speed_of_sound"):
            theirs = getattr(air.undisturbed, name)(altitude)
            assert float(getattr(air, name)(altitude)) == float(theirs)


def test_without_departures_it_is_the_model_itself():
    air = PerturbedAtmosphere(
        ExponentialAtmosphere(1.225, 7200.0), (DensityWave(0, 8e3),)
    )
    altitude = jnp.asarray(33e3)
    assert float(air.density(altitude)) == float(air.undisturbed.density(altitude))


AT_REST = PerturbedAtmosphere(
    ExponentialAtmosphere(0.0158, 9354.0),
    (DensityWave(0.0, 8e3), DensityWave(0.0, 25e3, 0.3)),
    share_low=0.1,
    share_high=0.3,
    ground_waves=(GroundWave(0.0, 800e3, 3397e3, 1.0),),
)


def test_air_whose_departures_are_zero_is_the_undisturbed_one():
    assert without_zero_perturbations({"air": AT_REST}) == {"air": AT_REST.undisturbed}
    level = eqx.tree_at(lambda a: (a.share_low, a.share_high), AT_REST, (0.0, 0.0))
    level = eqx.tree_at(lambda a: a.trend, level, jnp.asarray(2.0))
    assert without_zero_perturbations(level) == AT_REST.undisturbed
    for share in (lambda a: a.share_low, lambda a: a.share_high):
        trend = eqx.tree_at(share, level, jnp.asarray(0.1))
        assert isinstance(without_zero_perturbations(trend), PerturbedAtmosphere)


@pytest.mark.parametrize(
    ("departs", "kept"),
    [
        (lambda a: a.trend, (0, 0)),
        (lambda a: a.waves[0].amplitude, (2, 0)),
        (lambda a: a.waves[1].amplitude, (2, 0)),
        (lambda a: a.ground_waves[0].amplitude, (0, 1)),
    ],
)
def test_what_departs_stays(departs, kept):
    air = eqx.tree_at(departs, AT_REST, jnp.asarray(0.02))
    spared = without_zero_perturbations(air)
    assert isinstance(spared, PerturbedAtmosphere)
    assert (len(spared.waves), len(spared.ground_waves)) == kept
    for altitude in (10e3, 47e3, 95e3):
        altitude = jnp.asarray(altitude)
        assert float(spared.density(altitude)) == float(air.density(altitude))


def test_what_is_not_known_yet_or_is_varied_stays():
    seen = []

    @jax.jit
    def look(amplitude):
        air = eqx.tree_at(lambda a: a.waves[1].amplitude, AT_REST, amplitude)
        seen.append(len(without_zero_perturbations(air).waves))
        return amplitude

    look(jnp.asarray(0.0))
    assert seen == [2]
    tree = {"air": AT_REST, "aircraft": jnp.asarray(1.0)}
    spared = [
        without_zero_perturbations(tree, [address])["air"] is not AT_REST
        for address in ("air.waves.1.phase", "air.undisturbed.scale_height", "aircraft")
    ]
    assert spared == [False, False, True]


class AtItsOwn(DensityWave):
    """A wave that departs by more than its amplitude."""

    def departure(self, altitude):
        return self.amplitude + 0.5


class DenserAir(PerturbedAtmosphere):
    """Air that departs by more than its waves and its trend."""

    def factor(self, altitude):
        return super().factor(altitude) + 0.5


@pytest.mark.parametrize(
    "air",
    [
        DenserAir(AT_REST.undisturbed),
        dataclasses.replace(AT_REST, waves=(AtItsOwn(0.0, 8e3),)),
    ],
)
def test_what_departs_by_more_than_its_amplitude_stays(air):
    altitude = jnp.asarray(40e3)
    spared = without_zero_perturbations(air)
    ratio = spared.density(altitude) / AT_REST.undisturbed.density(altitude)
    assert float(ratio) == pytest.approx(1.5, rel=1e-12)


def test_air_within_air():
    within = dataclasses.replace(AT_REST, undisturbed=AT_REST)
    assert without_zero_perturbations(within) == AT_REST.undisturbed
    departing = eqx.tree_at(lambda a: a.trend, within, jnp.asarray(0.1))
    spared = without_zero_perturbations(departing)
    assert spared.undisturbed == AT_REST.undisturbed and spared.waves == ()
    assert without_zero_perturbations(AT_REST, ["waves.0.amplitude"]) is AT_REST


def test_air_that_varies_over_the_ground_does_so_within_other_air():
    wave = GroundWave(0.2, 2000e3, 3397e3)
    inner = PerturbedAtmosphere(AT_REST.undisturbed, ground_waves=(wave,))
    own = GroundWave(-0.1, 900e3, 3397e3)
    about = {"trend": 1.0, "share_low": 0.05, "share_high": 0.05}
    plain = PerturbedAtmosphere(inner, **about)
    both = PerturbedAtmosphere(inner, ground_waves=(own,), **about)
    random = RandomAtmosphere(inner, RandomAltitudeProfile(10e3), 0.0)
    altitude = jnp.asarray(40e3)
    along, across = (np.sin(2 * np.pi * 0.1 * 3397e3 / x) for x in (2000e3, 900e3))
    for air, share in ((plain, 1.05), (both, 1.05 - 0.1 * across)):
        for within in (air, dataclasses.replace(air, undisturbed=random)):
            above = within.column(jnp.asarray(0.1), jnp.asarray(0.0))
            ratio = float(above.density(altitude) / inner.undisturbed.density(altitude))
            assert ratio == pytest.approx(share * (1.0 + 0.2 * along), rel=1e-9)
    alone = PerturbedAtmosphere(AT_REST.undisturbed, **about)
    assert alone.column(jnp.asarray(0.1), jnp.asarray(0.0)) is alone


def test_no_flight_goes_through_air_of_negative_density():
    """Without path constraints too, of which the heat rate would have told."""
    scenario = dataclasses.replace(free_scenario(), constraints={})
    air = scenario.planet.atmosphere
    for depth, lost in ((0.9, []), (1.0, [0.0]), (1.5, [0.0, 39e3])):
        departing = PerturbedAtmosphere(air, (DensityWave(-depth, 40e3, np.pi / 2),))
        altitudes = [0.0, 20e3, 39e3]
        found = [float(departing.density(jnp.asarray(h))) for h in altitudes]
        assert [h for h, x in zip(altitudes, found, strict=True) if np.isnan(x)] == lost
        if depth != 1.0:  # which is at one altitude alone, where no step need be
            flown = eqx.tree_at(lambda s: s.planet.atmosphere, scenario, departing)
            assert (flight_of(flown).outcome == Outcome.NOT_FINITE) == bool(lost)


flight_of = eqx.filter_jit(fly)


def test_what_does_not_depart_is_not_computed(monkeypatch):
    def departure(wave, altitude):
        raise AssertionError("a wave of amplitude zero is computed")

    monkeypatch.setattr(DensityWave, "departure", departure)
    scenario = free_scenario(time_limit=60.0)
    known = scenario.planet.atmosphere
    air = dataclasses.replace(AT_REST, undisturbed=known)
    scenario = eqx.tree_at(lambda s: s.planet.atmosphere, scenario, air)
    jax.eval_shape(lambda mass: fly(with_mass(scenario, mass)), jnp.asarray(900.0))
    inputs = {"vehicle.mass": [900.0, 990.0]}
    spared = monte_carlo(scenario, inputs=inputs)
    scenario = eqx.tree_at(lambda s: s.planet.atmosphere, scenario, known)
    alone = monte_carlo(scenario, inputs=inputs)
    assert jax.tree.all(jax.tree.map(np.array_equal, spared, alone))


def with_mass(scenario, mass):
    return eqx.tree_at(lambda s: s.vehicle.mass, scenario, mass)


@pytest.mark.slow
def test_a_campaign_has_the_departures_that_it_disperses():
    scenario = free_scenario(time_limit=60.0)
    air = dataclasses.replace(AT_REST, undisturbed=scenario.planet.atmosphere)
    departing = eqx.tree_at(lambda s: s.planet.atmosphere, scenario, air)
    amplitude = lambda s: s.planet.atmosphere.waves[0].amplitude
    inputs = {"planet.atmosphere.waves.0.amplitude": [0.0, 0.1]}
    still, given = monte_carlo(departing, inputs=inputs).flights.state.velocity
    drawn = monte_carlo(
        departing,
        {"wave": Dispersion(amplitude, Uniform(0.1, 0.1000001))},
        jax.random.key(0),
        1,
    )
    mass = {"vehicle.mass": [float(scenario.vehicle.mass)]}
    (before,) = monte_carlo(scenario, inputs=mass).flights.state.velocity
    assert still == pytest.approx(before, rel=1e-12)
    assert drawn.flights.state.velocity == pytest.approx([given], abs=1e-4)
    assert abs(given - before) > 1e-2


def test_a_ground_wave_goes_with_the_distance_from_its_origin():
    """By the spherical law of cosines, at a place that is not on the way of any axis."""
    radius, length = 6371e3, 800e3
    wave = GroundWave(0.02, length, radius, 1.0, 0.3, -0.2)
    air = PerturbedAtmosphere(
        ExponentialAtmosphere(1.225, 7200.0), ground_waves=(wave,)
    )
    altitude = jnp.asarray(50e3)
    nominal = float(air.undisturbed.density(altitude))
    for longitude, latitude in ((0.3, -0.2), (0.7, 0.1), (-0.5, 0.4), (0.3001, -0.2)):
        cosine = np.sin(-0.2) * np.sin(latitude)
        cosine += np.cos(-0.2) * np.cos(latitude) * np.cos(longitude - 0.3)
        distance = np.arccos(min(cosine, 1.0))
        expected = 0.02 * np.sin(2.0 * np.pi * distance * radius / length + 1.0)
        column = air.column(jnp.asarray(longitude), jnp.asarray(latitude))
        found = float(column.density(altitude)) / nominal - 1.0
        # The arc cosine of a number near one has half of the digits.
        assert found == pytest.approx(expected, abs=2e-8)
    assert float(air.density(altitude)) / nominal - 1.0 == pytest.approx(
        0.02 * np.sin(1.0), rel=1e-9
    )


def test_the_force_is_that_of_the_air_above_the_place():
    wave = GroundWave(0.1, 800e3, 6371e3, 0.4)
    air = PerturbedAtmosphere(
        ExponentialAtmosphere(1.225, 7200.0), ground_waves=(wave,)
    )
    gravity = InverseSquareGravity(3.986e14)
    planet = Planet(6371e3, gravity=gravity, atmosphere=air)
    vehicle = Vehicle(1e3, 1.0, aerodynamics=ConstantAerodynamics(0.3, 1.0))
    state = EntryState(50e3, 0.05, 0.0, 5e3, 0.0, 0.0)
    found = air_data(
        planet, vehicle, jax.tree.map(jnp.asarray, state), jnp.asarray(0.0)
    )
    angle = 2.0 * np.pi * 0.05 * 6371e3 / 800e3 + 0.4
    nominal = 1.225 * np.exp(-50e3 / 7200.0)
    assert float(found.density) == pytest.approx(
        nominal * (1.0 + 0.1 * np.sin(angle)), rel=1e-12
    )


def test_a_model_on_board_knows_the_air_above_the_place():
    """Its scale height by differences of the force, which the test above checks."""
    waves = (GroundWave(0.1, 800e3, 6371e3, 0.4),)
    air = PerturbedAtmosphere(
        ExponentialAtmosphere(1.225, 7200.0), trend=1.0, share_high=0.5
    )
    air = PerturbedAtmosphere(air, ground_waves=waves)
    planet = Planet(6371e3, gravity=InverseSquareGravity(3.986e14), atmosphere=air)
    vehicle = Vehicle(1e3, 1.0, aerodynamics=ConstantAerodynamics(0.3, 1.0))
    model = OnboardModel(planet, vehicle)
    angle = jnp.asarray(0.0)

    def there(altitude, longitude):
        state = EntryState(altitude, longitude, 0.1, 5e3, 0.0, 0.0)
        return jax.tree.map(jnp.asarray, state)

    def logarithm(*place):
        return float(jnp.log(air_data(planet, vehicle, there(*place), angle).drag))

    for longitude in (0.0, 0.05, 0.2):
        place = there(50e3, longitude)
        change = logarithm(50e3, longitude) - logarithm(50e3, 0.11)
        known = model.logarithm_of_drag(place, angle)
        known = float(known - model.logarithm_of_drag(there(50e3, 0.11), angle))
        assert known == pytest.approx(change, abs=1e-13)
        slope = logarithm(50.01e3, longitude) - logarithm(49.99e3, longitude)
        height = float(model.scale_height(place))
        assert height == pytest.approx(-20.0 / slope, rel=1e-7)


def test_smoothing_takes_the_corners_off_and_leaves_the_rest():
    """The mean of a layer of constant temperature is itself; an exponential stays."""
    air = all_atmospheres["smoothed"]()
    altitudes = jnp.linspace(1e3, 120e3, 60)
    exact = ExponentialAtmosphere(1.225, 7200.0)
    ratio = over(air.density)(altitudes) / over(exact.density)(altitudes)
    np.testing.assert_allclose(ratio, 1.0, rtol=1e-11)
    for altitude in (-3e3, 170e3):  # beyond the table
        altitude = jnp.asarray(altitude)
        ratio = float(air.density(altitude) / exact.density(altitude))
        assert ratio == pytest.approx(1.0, rel=1e-9)


@pytest.mark.slow
def test_the_smoothed_standard_is_its_mean():
    """Against a quadrature at some altitudes, corners among them."""
    layers = USStandardAtmosphere1976()
    air = eqx.filter_jit(smoothed)(layers)
    away = np.linspace(-6.0, 6.0, 2001)
    weights = np.exp(-0.5 * away**2) / np.sum(np.exp(-0.5 * away**2))
    for altitude in (20e3, 33.3e3, 47.3e3, 51.4e3, 71.8e3, 86e3):
        where = jnp.asarray(altitude + 1500.0 * away)
        mean = weights @ np.log(np.asarray(over(layers.density)(where)))
        found = float(jnp.log(air.density(jnp.asarray(altitude))))
        # The spline is of fourth order in 250 m over 1500.
        assert found == pytest.approx(mean, abs=1e-6)
        sound = np.asarray(over(layers.speed_of_sound)(where))
        mean = np.sqrt(weights @ sound**2)
        found = float(air.speed_of_sound(jnp.asarray(altitude)))
        assert found == pytest.approx(mean, rel=2e-6)


@pytest.mark.parametrize(
    "given", [{"width": 0.0}, {"spacing": -1.0}, {"lowest": 1e3, "highest": 1e3}]
)
def test_a_table_of_means_must_have_a_size(given):
    with pytest.raises(ValueError, match="both must be positive, and the table"):
        smoothed(ExponentialAtmosphere(1.225, 7200.0), **given)


def test_a_gas_that_is_not_the_one_of_the_table_is_refused():
    carbon_dioxide = {"gas_constant": 188.92, "heat_capacity_ratio": 1.29}
    air = ExponentialAtmosphere(0.0158, 9354.0, **carbon_dioxide)
    for given in ({}, {"gas_constant": 188.92}, {"heat_capacity_ratio": 1.29}):
        with pytest.raises(ValueError, match=r"of a gas with gas_constant=188.92 J"):
            smoothed(air, **given)
    found = smoothed(air, **carbon_dioxide)
    altitude = jnp.asarray(30e3)
    for name in ("density", "temperature", "pressure", "speed_of_sound"):
        ours, theirs = (float(getattr(x, name)(altitude)) for x in (found, air))
        assert ours == pytest.approx(theirs, rel=1e-9), name
