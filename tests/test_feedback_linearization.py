"""Tracking a ground track by feedback linearization, against equations written again."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sx_2_by_hand as hand
from ground_track_laws import POINTS, as_state, by_hand, law_at
from sx_2_by_hand import along, differences

from jentry.flight import fly
from jentry.guidance import (
    AttitudeBand,
    FullLinearization,
    MeasuredForces,
    ReferencePlaneAngles,
    SmallAngleLinearization,
    TrackErrors,
)
from jentry.guidance.feedback_linearization import along_reference
from jentry.missions.sx_2.scenario import entry, reference_controls, track_model
from jentry.motion import EntryState
from jentry.onboard import Factors, Measurement, PolynomialProfile, quintic_table
from jentry.units import degree


NOMINAL = Factors(jnp.asarray(1.0), jnp.asarray(1.0))


@eqx.filter_jit
def dynamics(linearization, model, state, factors):
    return linearization.dynamics(model, state, factors)


def under(found, above, left):
    """y1''' and y2'' of what was found, under a lift."""
    third, second = found.under(jnp.asarray(above), jnp.asarray(-left))
    return float(third), float(second)


@pytest.mark.parametrize("name", POINTS)
def test_full_derivatives_are_those_of_the_flow(name):
    x = by_hand(name)

    slopes = [hand.track_slope(output) for output in (1, 2)]
    model = track_model()
    found = dynamics(FullLinearization(), model, as_state(x), NOMINAL)
    y1, y1_1, y1_2 = found.downrange
    y2, y2_1 = found.crossrange
    assert (y1, y2) == pytest.approx((x[1], x[2]), rel=1e-14)
    assert (y1_1, y2_1) == pytest.approx([slope(x) for slope in slopes], rel=1e-11)
    assert float(y1_2) == pytest.approx(hand.downrange_curvature(x), rel=1e-10)
    for above, left in ((0.0, 0.0), (5.0, 0.0), (0.0, 5.0), (-3.0, 4.0)):
        flow = hand.flow(x, above, left, hand.reference_drag(x))
        third, second = under(found, above, left)
        assert second == pytest.approx(along(slopes[1], x, flow), rel=1e-9)
        # Fourth-order differences over 2e-5 of the energy; the bank turns over 0.014 of it.
        expected = differences(hand.downrange_curvature, x, flow)
        assert third == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("name", POINTS)
def test_printed_derivatives_are_those_of_the_small_angle_flow(name):
    """With a constant drag coefficient, as (44) has it."""
    x = by_hand(name)
    angle = 15.0 * degree

    def modelled_drag(x):
        return hand.drag(x[0], x[3], angle)

    def slope(output):
        return lambda x: hand.small_flow(x, 0.0, 0.0, modelled_drag(x))[output]

    def curvature(x):
        return along(slope(1), x, hand.small_flow(x, 0.0, 0.0, modelled_drag(x)))

    steady = dataclasses.replace(
        track_model(), angle_of_attack=PolynomialProfile([angle])
    )
    found = dynamics(SmallAngleLinearization(), steady, as_state(x), NOMINAL)
    assert float(found.downrange[1]) == pytest.approx(slope(1)(x), rel=1e-12)
    assert float(found.crossrange[1]) == pytest.approx(slope(2)(x), rel=1e-12)
    assert float(found.downrange[2]) == pytest.approx(curvature(x), rel=1e-10)
    for above, left in ((0.0, 0.0), (5.0, 0.0), (0.0, 5.0), (-3.0, 4.0)):
        flow = hand.small_flow(x, above, left, modelled_drag(x))
        third, second = under(found, above, left)
        assert second == pytest.approx(along(slope(2), x, flow), rel=1e-10)
        assert third == pytest.approx(differences(curvature, x, flow), rel=1e-7)


@pytest.mark.parametrize(
    "linearization", [FullLinearization(), SmallAngleLinearization()]
)
def test_a_linearization_is_called_and_not_put_into_the_law(linearization):
    """For the sake of speed alone, see `apart`."""
    model, state = track_model(), as_state(by_hand("late"))
    whole = jax.jit(lambda state: dynamics(linearization, model, state, NOMINAL))
    lines = whole.lower(state).as_text().splitlines()
    assert any(" call @" in x and 'inlineable = "false"' in x for x in lines)


def test_reference_controls_are_those_of_the_notes():
    angle, bank = reference_controls()
    e = np.linspace(0.0, 1.02, 103)
    energies = jnp.asarray(hand.LAST + e * hand.SPAN)
    angles, banks = (jax.jit(jax.vmap(p))(energies) for p in (angle, bank))
    wanted = [hand.reference_angle(x) for x in e], [-hand.reference_bank(x) for x in e]
    np.testing.assert_allclose(angles, wanted[0], rtol=1e-12)
    np.testing.assert_allclose(banks, wanted[1], rtol=1e-10)


def test_angles_of_a_turned_plane():
    """A great circle elsewhere is the equator of its own frame."""
    model = track_model()
    origin = EntryState(60e3, 0.4, -0.3, 5000.0, 0.0, 70.0 * degree)
    turned = dataclasses.replace(model, track_angles=ReferencePlaneAngles(origin))
    x = by_hand("high")
    flat = as_state(x)
    # The same flight, seen from the pole of the other great circle.
    there = moved_to(origin, flat)
    for linearization in (FullLinearization(), SmallAngleLinearization()):
        one = dynamics(linearization, model, flat, NOMINAL)
        other = dynamics(linearization, turned, there, NOMINAL)
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            size = np.max(np.abs(jax.tree.leaves(one)))
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-13 * size)


def moved_to(origin: EntryState, state: EntryState) -> EntryState:
    """The rotation that takes the equator due east from (0, 0) to a great circle."""

    def frame(longitude, latitude):
        up = np.array(
            [
                np.cos(latitude) * np.cos(longitude),
                np.cos(latitude) * np.sin(longitude),
                np.sin(latitude),
            ]
        )
        east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
        return up, east, np.cross(up, east)

    up, east, north = frame(float(origin.longitude), float(origin.latitude))
    heading = float(origin.heading)
    ahead = np.sin(heading) * east + np.cos(heading) * north
    turn = np.stack([up, ahead, np.cross(up, ahead)], axis=1)
    here, there_east, there_north = frame(float(state.longitude), float(state.latitude))
    heading = float(state.heading)
    velocity = np.sin(heading) * there_east + np.cos(heading) * there_north
    here, velocity = turn @ here, turn @ velocity
    longitude, latitude = np.arctan2(here[1], here[0]), np.arcsin(here[2])
    _, east, north = frame(longitude, latitude)
    heading = np.arctan2(velocity @ east, velocity @ north)
    return EntryState(
        state.altitude,
        longitude,
        latitude,
        state.velocity,
        state.flight_path_angle,
        heading,
    )


def test_measured_factors_are_those_of_the_forces():
    model, state = track_model(), as_state(by_hand("high"))
    angle = jnp.asarray(17.0 * degree)
    lift, drag = model.forces(state, angle, NOMINAL)
    seen = Measurement(state, 1.3 * lift, 0.8 * drag, angle, 0.0 * angle)
    factors = MeasuredForces().factors(model, seen)
    assert float(factors.lift) == pytest.approx(1.3, rel=1e-14)
    assert float(factors.drag) == pytest.approx(0.8, rel=1e-14)
    found = model.forces(state, angle, factors)
    assert float(found[0] / lift) == pytest.approx(1.3, rel=1e-14)
    assert float(found[1] / drag) == pytest.approx(0.8, rel=1e-14)
    # Drag that is so much larger shortens the way over the energy by so much.
    one = dynamics(FullLinearization(), model, state, NOMINAL)
    other = dynamics(FullLinearization(), model, state, factors)
    ratio = float(other.downrange[1] / one.downrange[1])
    assert ratio == pytest.approx(1.0 / 0.8, rel=1e-12)


def commanded(law, state, memory=None, forces=(5.0, 4.0)):
    angle = jnp.asarray(17.0 * degree)
    seen = Measurement(state, *(jnp.asarray(f) for f in forces), angle, angle)
    memory = law.init(seen) if memory is None else memory
    return law(jnp.asarray(0.0), seen, memory)


@pytest.mark.parametrize("name", ["early", "late"])
@pytest.mark.parametrize(
    "linearization", [FullLinearization(), SmallAngleLinearization()]
)
def test_on_the_reference_the_controls_are_the_reference_controls(linearization, name):
    x = by_hand(name)
    e = hand.share(x[0], x[3])
    controls, rate = commanded(law_at(as_state(x), linearization), as_state(x))
    wanted = hand.reference_angle(e), -hand.reference_bank(e)
    assert float(controls.angle_of_attack) == pytest.approx(wanted[0], rel=1e-9)
    assert float(controls.bank_angle) == pytest.approx(wanted[1], rel=1e-9)
    assert float(rate.downrange) == float(rate.crossrange) == 0.0


def test_errors_are_fed_back_by_the_gains():
    """Equation (49) by hand: too far along, and to the left, by little."""
    x = by_hand("late")
    state = as_state(x)
    loose = AttitudeBand(1.0, -1.0, 1.5, 3.0)
    law = dataclasses.replace(law_at(state, FullLinearization()), band=loose)
    model, off = law.model, (3e-6, -2e-6)
    moved = as_state(x + np.array([0.0, *off, 0.0, 0.0, 0.0]))
    memory = TrackErrors(jnp.asarray(4e-7), jnp.asarray(-3e-7))
    controls, rate = commanded(law, moved, memory)
    there = dynamics(FullLinearization(), model, moved, NOMINAL)
    here = along_reference(FullLinearization(), model, state)
    k1, k2 = np.poly([18.0, 8.0, 8.0, 0.1])[1:], np.poly([30.0, 1.2, 1.2])[1:]
    w1 = here["downrange_third"] - k1 @ np.array(
        [
            there.downrange[2] - here["downrange_second"],
            there.downrange[1] - here["downrange_first"],
            off[0],
            4e-7,
        ]
    )
    w2 = here["crossrange_second"] - k2 @ np.array(
        [there.crossrange[1] - here["crossrange_first"], off[1], -3e-7]
    )
    lift, _ = model.forces(moved, controls.angle_of_attack, NOMINAL)
    third, second = there.under(lift * controls.cos_bank, lift * controls.sin_bank)
    assert float(third) == pytest.approx(float(w1), rel=1e-9)
    assert float(second) == pytest.approx(float(w2), rel=1e-9)
    # The integrals run over the energy, which falls by V D: 4 m/s2 are sensed.
    falls = -x[3] * 4.0 / hand.SPAN
    assert float(rate.downrange) == pytest.approx(off[0] * falls, rel=1e-6)
    assert float(rate.crossrange) == pytest.approx(off[1] * falls, rel=1e-6)


def test_commands_keep_to_their_band():
    x = by_hand("late")
    law = law_at(as_state(x), FullLinearization())
    e = hand.share(x[0], x[3])
    for off in (1e-2, -1e-2):
        moved = as_state(x + np.array([0.0, off, off, 0.0, 0.0, 0.0]))
        controls, _ = commanded(law, moved)
        deviation = float(controls.angle_of_attack) - hand.reference_angle(e)
        assert abs(deviation) <= 5.0 * degree * (1.0 + 1e-12)
        assert abs(float(controls.bank_angle)) <= 80.0 * degree * (1.0 + 1e-12)


def test_the_smallest_and_the_largest_angle_are_kept_as_well():
    x = by_hand("late")
    state = as_state(x)
    narrow = AttitudeBand(5.0 * degree, 11.0 * degree, 13.0 * degree, 1.4)
    law = dataclasses.replace(law_at(state, FullLinearization()), band=narrow)
    angles = set()
    for off in (1e-2, -1e-2):
        moved = as_state(x + np.array([0.0, off, off, 0.0, 0.0, 0.0]))
        angles.add(round(float(commanded(law, moved)[0].angle_of_attack) / degree, 9))
    assert angles <= {11.0, 13.0} and angles


def test_measured_lift_is_what_is_flown():
    """With 1.3 times the lift of the model the angle of attack is so much smaller."""
    x = by_hand("late")
    state = as_state(x)
    loose = AttitudeBand(1.0, -1.0, 1.5, 3.0)
    law = dataclasses.replace(
        law_at(state, FullLinearization()), band=loose, force_knowledge=MeasuredForces()
    )
    model, sensed_at = law.model, jnp.asarray(17.0 * degree)
    lift, drag = model.forces(state, sensed_at, NOMINAL)
    controls, _ = commanded(law, state, forces=(1.3 * lift, drag))
    factors = Factors(jnp.asarray(1.3), jnp.asarray(1.0))
    there = dynamics(FullLinearization(), model, state, factors)
    here = along_reference(FullLinearization(), model, state)
    k1 = np.poly([18.0, 8.0, 8.0, 0.1])[1]
    w1 = here["downrange_third"] - k1 * (there.downrange[2] - here["downrange_second"])
    flown = 1.3 * model.forces(state, controls.angle_of_attack, NOMINAL)[0]
    third, second = there.under(flown * controls.cos_bank, flown * controls.sin_bank)
    assert float(third) == pytest.approx(float(w1), rel=1e-9)
    assert float(second) == pytest.approx(float(here["crossrange_second"]), rel=1e-9)


def test_a_reference_of_other_columns_is_refused():
    law = law_at(as_state(by_hand("late")), FullLinearization())
    nothing = (jnp.zeros(2), jnp.zeros(2), jnp.zeros(2))
    other = quintic_table(jnp.array([2.0, 1.0]), {"downrange": nothing})
    with pytest.raises(ValueError, match="no downrange_first, .*plan_ground_track"):
        dataclasses.replace(law, reference=other)


def test_measured_forces_under_an_ideal_attitude_are_refused():
    """The command would depend on forces that depend on the command."""
    nominal = entry()
    law = law_at(as_state(by_hand("late")), FullLinearization())
    law = dataclasses.replace(law, force_knowledge=MeasuredForces())
    with pytest.raises(ValueError, match="GroundTrackTracking commands an angle"):
        jax.eval_shape(fly, dataclasses.replace(nominal, guidance=law))
