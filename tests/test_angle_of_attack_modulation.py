"""Laws that modulate the angle of attack: one cycle after another, by hand."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from jentry.guidance import (
    AttitudeLag,
    BankGains,
    DynamicalModulation,
    ModulationGains,
    ShuttleBank,
    ShuttleModulation,
)
from jentry.motion import EntryState, VelocityIndex
from jentry.onboard import Measurement, OnboardModel, PolynomialProfile, Reference
from jentry.onboard.velocity_domain import VelocityDomain
from jentry.units import degree, foot
from jentry.world import (
    ExponentialAtmosphere,
    InverseSquareGravity,
    Planet,
    PolynomialAerodynamics,
    Vehicle,
)


RADIUS, GRAVITY, HEIGHT = 6371e3, 9.80665, 7200.0
CIRCULAR = np.sqrt(GRAVITY * RADIUS)
LIFT, DRAG = (0.1, 1.1), (0.3, -0.4, 2.5)
ANGLE, BANK, PATH = 35.0 * degree, 60.0 * degree, -1.0 * degree
DRAG_HERE, LIFT_HERE = 10.0, 11.0
"""m/s2, of a reference that is the same at all velocities"""


@pytest.fixture(scope="module")
def model():
    planet = Planet(
        RADIUS,
        gravity=InverseSquareGravity(GRAVITY * RADIUS**2),
        atmosphere=ExponentialAtmosphere(1.225, HEIGHT),
    )
    aerodynamics = PolynomialAerodynamics(list(LIFT), list(DRAG))
    return OnboardModel(planet, Vehicle(3500.0, 5.0, aerodynamics=aerodynamics))


@pytest.fixture(scope="module")
def reference():
    constant = {
        "altitude": 55e3,
        "flight_path_angle": PATH,
        "bank": BANK,
        "drag": DRAG_HERE,
        "lift": LIFT_HERE,
        "angle_of_attack": ANGLE,
        "altitude_rate": -80.0,
        "lift_to_drag_up": 0.5,
    }
    profiles = {name: PolynomialProfile([x]) for name, x in constant.items()}
    return Reference(VelocityIndex(), profiles)


def sensed(velocity, drag=DRAG_HERE, lift=LIFT_HERE, angle=ANGLE, path=PATH):
    zero = jnp.asarray(0.0)
    state = EntryState(55e3, 0.0, 0.0, velocity, path, 0.5 * np.pi)
    state = jax.tree.map(lambda x: jnp.asarray(x, float), state)
    numbers = (jnp.asarray(x) + zero for x in (lift, drag, angle, 40.0 * degree))
    return Measurement(state, *numbers)


@eqx.filter_jit
def begin(law, measurement):
    return law.init(measurement)[1]


@eqx.filter_jit
def update(law, measurement, held):
    return law.update(jnp.asarray(0.0), measurement, None, held)[1]


def by_hand(velocity):
    """Entries of (14) and (15) at the reference, and chi."""
    v, d, l = velocity / CIRCULAR, DRAG_HERE / GRAVITY, LIFT_HERE / GRAVITY
    c_d = DRAG[0] + DRAG[1] * ANGLE + DRAG[2] * ANGLE**2
    slope_d = (DRAG[1] + 2.0 * DRAG[2] * ANGLE) / c_d
    slope_l = LIFT[1] / (LIFT[0] + LIFT[1] * ANGLE)
    d_r, up = -RADIUS / HEIGHT * d, l * np.cos(BANK)
    a_rr = v * d_r * np.sin(PATH) / d**2
    a_rg, a_gr = -v / d, d_r * (v**2 - 1.0) / (v * d**2)
    a_gg = ((v**2 - 1.0) + up) / (v * d**2)
    b_g = (-up * slope_l + (up + v**2 - 1.0) * slope_d) / (v * d)
    return a_rr, a_rg, a_gr, a_gg, b_g, d_r, d * slope_d


GAINS = ModulationGains(300.0, 0.7, 1000.0, 4.0, -0.15)


def law_of(reference, model, **changes) -> DynamicalModulation:
    law = DynamicalModulation(
        reference=reference, domain=VelocityDomain(model, HEIGHT), gains=GAINS
    )
    return dataclasses.replace(law, **changes)


def test_the_observer_forgets_its_errors_as_it_says(reference, model):
    """A plant of (19) and (20) with a constant disturbance, flown by the law in short
    cycles: the errors of both estimates obey (38) and (39)."""
    law = law_of(reference, model)
    start, disturbance, cycles = 5000.0, 40.0, 400
    way = -0.05 / CIRCULAR
    xi1, xi2 = 2e-3, -0.3

    def at(v, xi1):
        return sensed(v, DRAG_HERE + GRAVITY * xi1)

    held = update(law, at(start, xi1), begin(law, sensed(7500.0)))
    # It begins with nothing known of either.
    first = np.array([xi2, disturbance])
    estimates = [held.drag_error_slope, held.disturbance]
    np.testing.assert_allclose(estimates, 0.0, atol=1e-9)
    a_rr, a_rg, a_gr, a_gg, b_g, d_r, chi = by_hand(start)

    def rates(y, v_command):
        xi1, xi2, u, slope = y
        nominal = (
            a_rr * xi2
            + (a_rg * a_gr - a_rr * a_gg) * xi1
            + a_rg * (d_r * b_g - a_gr * chi) * u
            - a_gg * chi * (slope - xi2 / chi)
        )
        return np.array(
            [xi2, nominal + chi * v_command + disturbance, slope, v_command]
        )

    y = np.array([xi1, xi2, 0.0, 0.0])
    for cycle in range(cycles):
        # The plant flies what the law commands, whose input goes on as a straight line.
        before = held
        trial = y + way * rates(y, float(before.second))
        guess = update(law, at(start + (cycle + 1) * way * CIRCULAR, trial[0]), before)
        mean = 0.5 * (float(before.second) + float(guess.second))
        middle = y + 0.5 * way * rates(y, mean)
        y = y + way * rates(middle, mean)
        held = update(law, at(start + (cycle + 1) * way * CIRCULAR, y[0]), before)
        y[2], y[3] = float(held.deviation), float(held.slope)
    found = [y[1] - held.drag_error_slope, disturbance - held.disturbance]
    tau1, tau2 = a_rr + a_gg - 2.0 * 1000.0, 1000.0**2
    system = np.array([[a_rr + a_gg - tau1, 1.0], [-tau2, 0.0]])
    expected = expm(system * cycles * way) @ first
    np.testing.assert_allclose(found, expected, rtol=2e-4)


def test_the_observer_has_a_double_pole(reference, model):
    """Of (38) and (39): both eigenvalues are p, also where the model is not slow."""
    gains = dataclasses.replace(GAINS, observer_pole=jnp.asarray(0.5))
    law = law_of(reference, model, gains=gains)
    wanted = reference.over_index(jnp.asarray(5000.0))
    point = law.domain.point(sensed(5000.0).state, wanted)
    _, tau1, tau2 = law._placed(law.domain.simplified(point), jnp.asarray(DRAG_HERE))
    a_rr, _, _, a_gg, *_ = by_hand(5000.0)
    system = np.array([[a_rr + a_gg - float(tau1), 1.0], [-float(tau2), 0.0]])
    assert np.trace(system) == pytest.approx(2.0 * 0.5, rel=1e-9)
    assert np.linalg.det(system) == pytest.approx(0.5**2, rel=1e-9)


def test_nothing_happens_before_its_velocity_and_without_air(reference, model):
    law = law_of(reference, model)
    held = begin(law, sensed(7700.0))
    for measurement in (sensed(7200.1, 12.0), sensed(7000.0, 0.049 * GRAVITY)):
        after = update(law, measurement, held)
        assert float(after.active) == 0.0 and float(after.deviation) == 0.0
        assert float(after.command.angle_of_attack) == ANGLE
        assert float(after.command.bank_increment) == 0.0
    assert float(update(law, sensed(7200.0, 12.0), held).active) == 1.0


def modulating(law, measurement):
    """After two cycles, the first of which begins it."""
    held = begin(law, sensed(7500.0))
    return update(law, measurement, update(law, sensed(5001.0, 10.2), held))


def test_the_bank_is_asked_for_what_42_says(reference, model):
    held = modulating(law_of(reference, model), sensed(5000.0, 10.3))
    *_, chi = by_hand(5000.0)
    eta2 = held.slope - held.drag_error_slope / chi
    expected = 4.0 * held.deviation - 0.15 * eta2
    assert float(held.command.bank_increment) == pytest.approx(float(expected))
    angle = float(held.command.angle_of_attack) - ANGLE
    assert angle == pytest.approx(float(held.deviation), rel=1e-12) and angle != 0.0


def test_the_second_derivative_is_what_29_to_33_say(reference, model):
    held = modulating(law_of(reference, model), sensed(5000.0, 10.3))
    a_rr, a_rg, a_gr, a_gg, b_g, d_r, chi = by_hand(5000.0)
    xi1, xi2 = 0.3 / GRAVITY, float(held.drag_error_slope)
    u, slope = float(held.deviation), float(held.slope)
    nominal = a_rr * xi2 + (a_rg * a_gr - a_rr * a_gg) * xi1
    nominal += a_rg * (d_r * b_g - a_gr * chi) * u - a_gg * chi * (slope - xi2 / chi)
    omega = -300.0
    placed = -2.0 * 0.7 * omega * xi2 - omega**2 * xi1
    expected = (-nominal + placed - float(held.disturbance)) / chi
    assert float(held.second) == pytest.approx(expected, rel=1e-9)
    assert float(held.drag_error) == pytest.approx(xi1, rel=1e-9)


def test_the_command_leads_the_lag_of_the_attitude(reference, model):
    """An attitude that obeys (46) then flies the deviation itself."""
    plain = modulating(law_of(reference, model), sensed(5000.0, 10.3))
    lag = AttitudeLag(3.0, 0.9)
    led = modulating(law_of(reference, model, lag=lag), sensed(5000.0, 10.3))
    falls = -(10.3 + GRAVITY * np.sin(PATH)) / CIRCULAR
    rate, acceleration = plain.slope * falls, plain.second * falls**2
    expected = plain.deviation + 2.0 * 0.9 / 3.0 * rate + acceleration / 3.0**2
    assert float(led.command.angle_of_attack) - ANGLE == pytest.approx(float(expected))


def test_a_schedule_is_the_gains_at_one_drag_and_as_one_over_it_elsewhere(
    reference, model
):
    def flown(gains):
        law = law_of(reference, model, gains=gains)
        held = modulating(law, sensed(5000.0, 10.3))
        return [float(x) for x in jax.tree.leaves(held)]

    scheduled = dataclasses.replace(GAINS, scheduled_at=jnp.asarray(DRAG_HERE))
    np.testing.assert_allclose(flown(scheduled), flown(GAINS), rtol=1e-12)
    scheduled = dataclasses.replace(GAINS, scheduled_at=jnp.asarray(2.0 * DRAG_HERE))
    twice = dataclasses.replace(
        GAINS, frequency=jnp.asarray(600.0), observer_pole=jnp.asarray(2000.0)
    )
    np.testing.assert_allclose(flown(scheduled), flown(twice), rtol=1e-12)


def test_a_law_without_substeps_is_refused(reference, model):
    with pytest.raises(ValueError, match="substeps is 0: it must be 1 or more"):
        law_of(reference, model, substeps=0)


@eqx.filter_jit
def act(law, measurement):
    return law(jnp.asarray(0.0), measurement, None)[0]


@pytest.mark.parametrize("divisor", [1.0, 0.25])
def test_the_shuttles_modulation_is_that_of_its_formula(reference, model, divisor):
    law = ShuttleModulation(reference, model, divisor)
    angle = ANGLE + 1.5 * degree
    command = act(law, sensed(5000.0, 10.3, angle=angle))
    c_d = DRAG[0] + DRAG[1] * ANGLE + DRAG[2] * ANGLE**2
    slope = DRAG[1] + 2.0 * DRAG[2] * ANGLE
    expected = angle + c_d * (10.0 / 10.3 - 1.0) / (divisor * slope)
    assert float(command.angle_of_attack) == pytest.approx(expected, rel=1e-12)
    assert float(command.bank_increment) == pytest.approx(4.0 * 1.5 * degree)
    early = act(law, sensed(7300.0, 10.3, angle=angle))
    assert float(early.angle_of_attack) == ANGLE and float(early.bank_increment) == 0.0


def test_dead_band_and_limit_of_the_shuttles_modulation(reference, model):
    limit, band = 2.0 * degree, 0.15 * foot
    law = ShuttleModulation(reference, model, dead_band=band, limit=limit)
    angle = ANGLE + 1.0 * degree
    within = act(law, sensed(5000.0, 10.0 + 0.99 * band, angle=angle))
    assert float(within.angle_of_attack) == pytest.approx(angle, rel=1e-12)
    beyond = act(law, sensed(5000.0, 10.0 + 1.01 * band, angle=angle))
    assert float(beyond.angle_of_attack) < angle - 0.09 * degree
    for drag, side in ((8.0, 1.0), (12.0, -1.0)):
        found = act(law, sensed(5000.0, drag, angle=angle))
        assert float(found.angle_of_attack) == pytest.approx(angle + side * limit)


@pytest.mark.parametrize("velocity", [7300.0, 5000.0])
def test_the_bank_is_that_of_its_formula(reference, velocity):
    drag, lift, path = 10.4, 11.2, -1.2 * degree
    command = act(ShuttleBank(reference), sensed(velocity, drag, lift, path=path))
    feet = drag / 0.3048
    c16 = np.clip(0.1354 * feet**-0.10, 0.025, 0.35)
    modulated = velocity <= 7200.0
    least = 0.00133 if modulated else 0.0025
    c17 = np.clip(1.537e-2 * feet**-0.58146, least, 0.014)
    c17 *= 0.75 if modulated else 1.0
    climbs = velocity * np.sin(path)
    up = 0.5 + c16 * (drag - 10.0) / 0.3048 + c17 * (-80.0 - climbs) / 0.3048
    expected = np.clip(up * drag / lift, np.cos(80.0 * degree), 1.0)
    assert float(command.cos_bank) == pytest.approx(expected, rel=1e-12)
    assert float(command.sin_bank) == pytest.approx(np.sqrt(1.0 - expected**2))
    assert float(command.angle_of_attack) == pytest.approx(40.0 * degree)


def test_the_bank_before_guidance_and_at_its_limits(reference):
    law = ShuttleBank(reference)
    early = act(law, sensed(7700.0, 0.049 * GRAVITY))
    assert float(early.bank_angle) == pytest.approx(30.0 * degree)
    none = act(law, sensed(7700.0, 0.0, 0.0))
    assert float(none.bank_angle) == pytest.approx(30.0 * degree)
    low = act(law, sensed(5000.0, 5.0))
    assert float(low.bank_angle) == pytest.approx(80.0 * degree)
    high = act(law, sensed(5000.0, 16.0))
    assert float(high.bank_angle) == 0.0


def test_gains_of_the_bank_are_clipped_in_units_of_the_shuttle():
    gains = BankGains()
    for drag in (1e-4, 0.3, 3.0, 30.0, 300.0):
        c16, c17 = gains.at(jnp.asarray(drag), jnp.asarray(False))
        feet = max(drag / 0.3048, 1e-3)
        expected = np.clip(0.1354 * feet**-0.10, 0.025, 0.35)
        assert float(c16) * 0.3048 == pytest.approx(expected)
        expected = np.clip(1.537e-2 * feet**-0.58146, 0.0025, 0.014)
        assert float(c17) * 0.3048 == pytest.approx(expected)
