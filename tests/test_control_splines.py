"""Splines of the controls in place of a law: where they lie, and which law gives way."""

import dataclasses

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import bank_profile, fly_compiled

from jentry.addresses import addresses_of
from jentry.flight import FixedStep, fly
from jentry.guidance import (
    AbstractContinuousLaw,
    Aim,
    AngleOfAttackProfile,
    Sampled,
    TargetOfScenario,
    TrimAngleOfAttack,
    compose,
)
from jentry.guidance.open_loop import ControlProfiles
from jentry.missions import find_mission
from jentry.motion import Controls
from jentry.motion.index import AltitudeIndex, EnergyIndex, TimeIndex, VelocityIndex
from jentry.motion.quantities import energy
from jentry.onboard.profiles import PolynomialProfile
from jentry.planning.control_splines import (
    control_coefficients,
    free_controls,
    free_part,
)
from jentry.units import degree


BANK = 50 * degree


def composed(law):
    profile = PolynomialProfile(jnp.array([10 * degree]))
    guidance = compose(AngleOfAttackProfile(profile), law)
    return dataclasses.replace(cheap.at_trim(), guidance=guidance)


@pytest.mark.slow
def test_constant_controls_fly_as_they_are():
    """The splines begin as what was constant: the same flight but for rounding."""
    start = free_controls(cheap.at_trim(), BANK, nodes=8)
    flight, before = (fly_compiled(s, cheap.SOLVER) for s in (start, cheap.at_trim()))
    assert float(flight.time) == pytest.approx(float(before.time), rel=1e-10)
    altitude = float(before.state.altitude)
    assert float(flight.state.altitude) == pytest.approx(altitude, rel=1e-8)


def test_breakpoints_are_at_equal_intervals_of_time():
    start = free_controls(cheap.at_trim(), BANK, nodes=8)
    controls = free_part(start)
    breakpoints = np.asarray(controls.bank.breakpoints)
    assert breakpoints.shape == (6,) and controls.bank.coefficients.shape == (8,)
    history = fly(cheap.at_trim(), history=1.0).history
    flown = np.isfinite(np.asarray(history.time))
    along = jax.vmap(lambda s: energy(cheap.at_trim().planet, s))(history.states)
    at = np.asarray(along)[flown][::-1]
    # Of the energy between two seconds, as a straight line.
    times = np.interp(breakpoints[::-1], at, np.asarray(history.time)[flown][::-1])
    np.testing.assert_allclose(np.diff(times), np.mean(np.diff(times)), atol=1.0)
    assert times[0] == pytest.approx(0.0, abs=1e-6)


def test_what_is_free():
    both = free_controls(cheap.at_trim(), BANK, 5 * degree, nodes=6)
    addresses = addresses_of(both, control_coefficients)
    assert addresses == [
        "guidance.bank.coefficients",
        "guidance.angle_of_attack.coefficients",
    ]
    one = free_controls(cheap.at_trim(), BANK, nodes=6)
    assert addresses_of(one, control_coefficients) == ["guidance.bank.coefficients"]
    coefficients = control_coefficients(both)
    np.testing.assert_allclose(coefficients[0], BANK)
    np.testing.assert_allclose(coefficients[1], 5 * degree)


@pytest.mark.slow
def test_the_angle_of_attack_stays_with_its_law():
    start = free_controls(composed(bank_profile()), BANK, nodes=6)
    assert isinstance(start.guidance.angle_of_attack, AngleOfAttackProfile)
    assert addresses_of(start, control_coefficients) == [
        "guidance.bank.bank.coefficients"
    ]
    flight = fly(start, cheap.SOLVER, history=20.0)
    angle = np.asarray(flight.history.controls.angle_of_attack)
    np.testing.assert_allclose(angle[np.isfinite(angle)], 10 * degree, rtol=1e-14)
    # And one that is given takes its place.
    given = free_controls(composed(bank_profile()), BANK, 5 * degree, nodes=6)
    assert isinstance(given.guidance, ControlProfiles)


@pytest.mark.parametrize(
    "index", [VelocityIndex(), TimeIndex()], ids=["velocity", "time"]
)
def test_other_indices(index):
    """The velocity of this entry rises at first, and the time throughout."""
    if isinstance(index, VelocityIndex):
        with pytest.raises(
            ValueError, match="VelocityIndex turns round .* EnergyIndex"
        ):
            free_controls(cheap.at_trim(), BANK, index=index)
        return
    start = free_controls(cheap.at_trim(), BANK, nodes=7, index=index)
    end = float(fly_compiled(cheap.at_trim(), cheap.SOLVER).time)
    breakpoints = free_part(start).bank.breakpoints
    np.testing.assert_allclose(breakpoints, np.linspace(0.0, end, 5), atol=1e-3)


def test_splines_begin_again():
    """Free controls of free controls: other nodes, another constant."""
    start = free_controls(cheap.at_trim(), BANK, nodes=6)
    again = free_controls(start, 30 * degree, nodes=9)
    assert free_part(again).bank.coefficients.shape == (9,)
    kept = compose(TrimAngleOfAttack(), free_part(start))
    composed_again = free_controls(
        dataclasses.replace(cheap.at_trim(), guidance=kept), BANK, nodes=5
    )
    assert isinstance(composed_again.guidance.angle_of_attack, TrimAngleOfAttack)


@pytest.mark.slow
def test_beside_a_law_with_a_cycle():
    """The other law is held for 2 s; the splines are laid on flights of such cycles."""
    held = Sampled(composed(bank_profile()).guidance.angle_of_attack, 2.0)
    guidance = compose(held, bank_profile())
    scenario = dataclasses.replace(cheap.at_trim(), guidance=guidance)
    start = free_controls(scenario, BANK, nodes=6)
    assert isinstance(start.guidance.angle_of_attack, Sampled)
    assert start.guidance.cycle.period == 2.0
    breakpoints = np.asarray(free_part(start).bank.breakpoints)
    assert np.all(np.diff(breakpoints) > 0.0)


REFUSED = {
    "own angle of splines": (
        lambda: free_controls(
            free_controls(cheap.at_trim(), BANK, 0.1, nodes=5), BANK, nodes=6
        ),
        "ControlProfiles commands an angle of attack of its own",
    ),
    "few nodes": (lambda: free_controls(cheap.at_trim(), BANK, nodes=3), "4 or more"),
    "own angle": (
        lambda: free_controls(cheap.scenario(), BANK),
        "ConstantBank commands an angle of attack of its own",
    ),
    "no splines": (
        lambda: control_coefficients(cheap.at_trim()),
        "BankProfile flies no splines of the controls",
    ),
    "altitude": (
        lambda: free_controls(cheap.at_trim(), 0.0, index=AltitudeIndex()),
        "AltitudeIndex turns round",
    ),
}


@pytest.mark.parametrize(("call", "said"), REFUSED.values(), ids=REFUSED)
def test_refused(call, said):
    with pytest.raises(ValueError) as refused:
        call()
    assert said in str(refused.value)


def test_the_energy_is_what_they_are_over():
    assert isinstance(
        free_part(free_controls(cheap.at_trim(), BANK)).index, EnergyIndex
    )


class ToTheTarget(AbstractContinuousLaw[None]):
    """Reads the target of its scenario at every step."""

    aim: Aim | TargetOfScenario = TargetOfScenario()

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        bank = 0.0 * measurement.drag + 1e-7 * self.aim.downrange
        return Controls.from_bank(bank, measurement.trim_angle_of_attack), None


def test_beside_a_law_that_flies_to_the_target_of_its_scenario():
    """The law knows its target in the scenario alone."""
    scenario = find_mission("mars-range-tracking").scenario()
    scenario = dataclasses.replace(scenario, guidance=ToTheTarget())
    free = free_controls(scenario, bank=60 * degree, nodes=4)
    flight = fly_compiled(free, FixedStep(1.0))
    assert np.isfinite(float(flight.state.altitude))
