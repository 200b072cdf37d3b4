"""Scenarios, laws and compiled functions that several test files share.

Compiling is most of the time of the tests: what is compiled here is compiled once for a
session. Every number of a scenario is a leaf, so that one compiled flight serves every
scenario of the same structure.
"""

import csv
import functools
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jentry.fields import Scalar, scalar
from jentry.flight import (
    AltitudeAbove,
    AltitudeBelow,
    Outcome,
    Scenario,
    Target,
    Termination,
    VelocityBelow,
    fly,
)
from jentry.guidance import (
    AbstractContinuousLaw,
    AbstractSampledLaw,
    Adjustment,
    AngleOfAttackProfile,
    AttitudeBand,
    AttitudeLag,
    BankProfile,
    ConstantBankShape,
    ControlProfiles,
    CrossrangeCorridor,
    DeviationWeights,
    DynamicalModulation,
    ErrorGains,
    FixedCycle,
    FixedSide,
    Gate,
    Gated,
    GroundTrackModel,
    GroundTrackTracking,
    GuidedEnd,
    ModulationGains,
    ObserverDragTracking,
    ObserverGains,
    PredictorCorrector,
    PseudospectralTracking,
    RangeTracking,
    Regulator,
    ReplannedTracking,
    Sampled,
    ScaleLimits,
    ShuttleBank,
    ShuttleModulation,
    StateFeedbackDragTracking,
    StoredGainTracking,
    TrackingGains,
    TrimAngleOfAttack,
    compose,
    plan_gains,
)
from jentry.guidance.aim import TargetOfScenario
from jentry.missions.cav_h.scenario import stored
from jentry.motion import Controls, EntryDynamics, EntryState, EquatorialDynamics
from jentry.motion.index import EnergyIndex, VelocityIndex
from jentry.onboard import (
    EstimatedWind,
    LongitudinalModel,
    LongitudinalReference,
    OnboardModel,
    PolynomialProfile,
    Reference,
    ScheduledAerodynamics,
    VelocityDomain,
    WindEstimate,
    WindPrior,
    quintic_table,
)
from jentry.onboard.profile_estimation import Learnt
from jentry.units import degree, km
from jentry.world import (
    ConstantAerodynamics,
    ConstantGravity,
    ConstantWind,
    DensityWave,
    EnsembleAtmosphere,
    EnsembleWind,
    ExponentialAerodynamics,
    ExponentialAtmosphere,
    GroundWave,
    InverseSquareGravity,
    PerturbedAtmosphere,
    Planet,
    PolynomialAerodynamics,
    RandomAerodynamics,
    RandomAltitudeProfile,
    RandomAtmosphere,
    RandomMachProfile,
    RandomWind,
    ScaledWind,
    StillAir,
    TabulatedAerodynamics,
    TabulatedAtmosphere,
    TabulatedWind,
    USStandardAtmosphere1976,
    Vehicle,
    smoothed,
)


TRUTHS = Path(__file__).parent / "truths"

MARS_ROTATION = 7.088e-5
"""rad/s"""


fly_compiled = eqx.filter_jit(fly)
"""One cache for all tests: the same structure, solver and history compile once."""

fly_batch = eqx.filter_jit(
    lambda scenarios, *how: jax.vmap(lambda s: fly(s, *how))(scenarios)
)


class ConstantBank(AbstractContinuousLaw[None]):
    """The smallest law: one bank angle, rad, of either sign."""

    bank_angle: Scalar = scalar(0.0, unit="rad")

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        angle_of_attack = jnp.zeros_like(self.bank_angle)
        bank = self.bank_angle
        return Controls(angle_of_attack, jnp.cos(bank), jnp.sin(bank)), None


class Doubting(AbstractSampledLaw[tuple[()], Scalar]):
    """Full lift, with a caveat: the share of its cycles that began below an altitude."""

    altitude: Scalar = scalar(unit="m")
    cycle: FixedCycle = FixedCycle(1.0)

    def init(self, measurement):
        nothing = 0.0 * measurement.drag
        return (), (nothing, nothing)

    def update(self, time, measurement, memory, held):
        below = measurement.state.altitude < self.altitude
        return (), (held[0] + 1.0, held[1] + jnp.where(below, 1.0, 0.0))

    def __call__(self, time, measurement, memory, held):
        one = jnp.ones_like(measurement.drag)
        return Controls(0.0 * one, one, 0.0 * one), ()

    def caveats(self, held):
        return {"low_cycles": held[1] / held[0]}


def truths(name: str) -> dict[str, dict[str, float]]:
    """`case -> quantity -> value` of a file in `tests/truths/`, its comments left out."""
    found: dict[str, dict[str, float]] = {}
    with open(TRUTHS / name) as file:
        lines = [line for line in file if not line.startswith("#")]
    for row in csv.DictReader(lines):
        found.setdefault(row["case"], {})[row["quantity"]] = float(row["value"])
    return found


CHANCE = 1e-6
"""That a bound on what is drawn is broken by one seed among all"""

SPREADS = 5.0
"""Of a mean from set to set, by as many its bounds are off: a chance of 6e-7"""


def most_by_chance(runs: int, share: float) -> int:
    """Of so many runs, at most, what a share of all flights is."""
    return _binomial(1.0 - CHANCE, runs, share)


def least_by_chance(runs: int, share: float) -> int:
    """Of so many runs, at least, what a share of all flights is."""
    return _binomial(CHANCE, runs, share)


def _binomial(chance: float, runs: int, share: float) -> int:
    from scipy import stats  # which takes as long to import as jax

    return int(stats.binom.ppf(chance, runs, share))


def mars_planet(**changes) -> Planet:
    return Planet(
        3397 * km,
        gravity=InverseSquareGravity(4.28283e13),
        atmosphere=ExponentialAtmosphere(0.0158, 9354.5),
        **changes,
    )


def mars_vehicle() -> Vehicle:
    drag_coefficient = 992.0 / (115.0 * 16.0)
    aerodynamics = ConstantAerodynamics(0.18 * drag_coefficient, drag_coefficient)
    return Vehicle(992.0, 16.0, aerodynamics=aerodynamics)


def mars_entry() -> EntryState:
    return EntryState(126.1 * km, 0.0, 0.0, 6750.0, -14.4 * degree, 90 * degree)


def bank_profile() -> BankProfile:
    """Close to the planned reference, and far from where the cosine is clipped."""
    return BankProfile(PolynomialProfile([0.62, 0.05], 503.0, 6247.0))


def mars_scenario(
    guidance=None, time_limit=400.0, dynamics=EquatorialDynamics()
) -> Scenario:
    """The entry of Yan and He; open loop if no law is given."""
    ends = {"velocity": VelocityBelow(503.0), "altitude": AltitudeBelow(10 * km)}
    return Scenario(
        mars_planet(),
        mars_vehicle(),
        mars_entry(),
        bank_profile() if guidance is None else guidance,
        Termination(ends, time_limit),
        Target(10 * km, 503.0, 723.32 * km, origin=mars_entry()),
        dynamics=dynamics,
    )


def free_scenario(bank_angle=50 * degree, time_limit=300.0) -> Scenario:
    """Constant bank in three dimensions, with an end condition for each outcome."""
    ends = {
        "ceiling": AltitudeAbove(140 * km),
        "ground": AltitudeBelow(0.0, outcome=Outcome.CRASHED),
        "velocity": VelocityBelow(503.0),
    }
    scenario = mars_scenario(ConstantBank(bank_angle), dynamics=EntryDynamics())
    return with_leaf(scenario, lambda s: s.termination, Termination(ends, time_limit))


def choices(mission) -> list[str]:
    """Every law of a mission, and what else its papers or its tests fly: as text."""
    return [*dict.fromkeys((*mission.laws, *mission.former_variants.values()))]


def with_leaf(tree, where, value):
    """The tree with another value in one place."""
    if eqx.is_array(where(tree)):
        value = jnp.asarray(value, dtype=float)
    return eqx.tree_at(where, tree, value)


def error_gains() -> ErrorGains:
    return ErrorGains(5.0, 1.982, 3.0)


def state_feedback(reference) -> StateFeedbackDragTracking:
    model = OnboardModel(mars_planet(), mars_vehicle())
    return StateFeedbackDragTracking(error_gains(), reference, model)


def observer_law(reference) -> ObserverDragTracking:
    model = OnboardModel(mars_planet(), mars_vehicle())
    gains = ObserverGains(0.481, 2.0, 1.0)
    return ObserverDragTracking(error_gains(), gains, reference, model)


def range_tracking(reference) -> RangeTracking:
    """Towards the target of Yan and He; the range that is flown as a straight line over
    the energy, from the entry to the target."""
    model = OnboardModel(mars_planet(), mars_vehicle())
    return RangeTracking(
        gains=error_gains(),
        observer=ObserverGains(0.481, 2.0, 1.0),
        reference=reference,
        range_flown=PolynomialProfile([0.0, 723.32 * km], 10.6e6, -23.1e6),
        model=model,
        limits=ScaleLimits(0.5, 2.0, 10 * km),
        lateral=CrossrangeCorridor(300.0, 4e-4),
    )


def predictor_corrector() -> PredictorCorrector:
    """In the plane, towards the target of Yan and He, in long steps."""
    return PredictorCorrector(
        model=OnboardModel(mars_planet(), mars_vehicle()),
        shape=ConstantBankShape(),
        end=GuidedEnd(503.0, 10 * km, ceiling=135 * km),
        lateral=FixedSide(),
        in_space=False,
        step=8.0,
        steps=80,
    )


def gliding_vehicle() -> Vehicle:
    """The lander with lift and drag that rise with the angle of attack."""
    aerodynamics = PolynomialAerodynamics([-0.04, 1.5], [0.5, -0.1, 3.0])
    return Vehicle(992.0, 16.0, aerodynamics=aerodynamics)


def ground_track_law(reference) -> GroundTrackTracking:
    """Near the planned flight: a straight line over the energy for each angle, 20 degrees
    of angle of attack and 45 of bank."""
    model = OnboardModel(mars_planet(), gliding_vehicle())
    values = {
        "downrange": (0.0, 0.213),
        "downrange_first": (-0.213, -0.213),
        "downrange_second": (0.1, 0.2),
        "downrange_third": (1.0, 2.0),
        "crossrange": (0.0, 0.02),
        "crossrange_first": (-0.02, -0.02),
        "crossrange_second": (0.1, 0.2),
    }
    nothing = jnp.zeros(2)
    columns = {name: (jnp.array(x), nothing, nothing) for name, x in values.items()}
    table = quintic_table(jnp.array([10.6e6, -12.5e6]), columns)
    return GroundTrackTracking(
        GroundTrackModel(
            model,
            PolynomialProfile([20.0 * degree]),
            PolynomialProfile([45.0 * degree]),
            23.1e6,
        ),
        table,
        TrackingGains.from_eigenvalues([18.0, 8.0, 8.0, 0.1], [30.0, 1.2, 1.2]),
        AttitudeBand(5.0 * degree, 5.0 * degree, 25.0 * degree, 80.0 * degree),
    )


def replanning_law(reference) -> ReplannedTracking:
    """The same track, planned again."""
    limits = Adjustment(3.0 * degree, 0.4, 15.0 * degree)
    return ReplannedTracking(ground_track_law(reference), limits, -12.4e6)


def control_profiles(reference) -> ControlProfiles:
    angle, bank = PolynomialProfile([0.1, 1e-9]), PolynomialProfile([-0.6, 1e-8])
    return ControlProfiles(EnergyIndex(), mars_planet(), angle, bank)


def glide_quantities() -> Reference:
    """Over the velocity: a drag near that of the planned flight, and a glide around it."""
    constant = {
        "altitude": [45e3],
        "flight_path_angle": [-4.0 * degree],
        "bank": [60.0 * degree],
        "drag": [20.0, 2e-3],
        "lift": [6.0, 5e-4],
        "angle_of_attack": [20.0 * degree],
        "altitude_rate": [-100.0, -0.05],
        "lift_to_drag_up": [0.15],
    }
    return Reference(
        VelocityIndex(), {name: PolynomialProfile(c) for name, c in constant.items()}
    )


def gliding_gate() -> Gate:
    """Open from the start of the flights of the tests."""
    return Gate(drag=0.1, velocity=9000.0)


def shuttle_bank() -> Sampled:
    law = ShuttleBank(glide_quantities(), gate=gliding_gate())
    return Sampled(law, 1.0)


def shuttle_law(reference):
    model = OnboardModel(mars_planet(), gliding_vehicle())
    law = ShuttleModulation(glide_quantities(), model, gate=gliding_gate())
    return compose(Sampled(law, 1.0), shuttle_bank())


def modulation_law(reference):
    law = DynamicalModulation(
        reference=glide_quantities(),
        domain=VelocityDomain(OnboardModel(mars_planet(), gliding_vehicle()), 11e3),
        gains=ModulationGains(30.0, observer_pole=100.0),
        lag=AttitudeLag(2.0, 0.9),
        gate=gliding_gate(),
        cycle=FixedCycle(1.0),
    )
    return compose(law, shuttle_bank())


def regulator() -> Regulator:
    """About a flight that falls slowly, with weights that leave the command within
    limits."""
    reference = LongitudinalReference(
        jnp.array([0.0, 100.0, 150.0]),
        jnp.array([[60e3, 55e3, 45e3, 40e3], [40e3, 38e3, 36e3, 35e3]]),
        jnp.array([[6e3, 5.9e3, 5.5e3, 5e3], [5e3, 4.6e3, 4.2e3, 4e3]]),
        jnp.full((2, 4), -6.0 * degree),
        jnp.array([[0.0, 130e3, 380e3, 500e3], [500e3, 550e3, 650e3, 700e3]]),
        jnp.full((2, 4), 0.05),
    )
    model = LongitudinalModel(
        OnboardModel(mars_planet(), mars_vehicle()), PolynomialProfile([-0.2, 1e-6])
    )
    weights = DeviationWeights(0.1, 0.02, 0.03, 0.001)
    return Regulator(
        model, reference, weights, weights, 2.0, TargetOfScenario(), degree=4
    )


def pseudospectral_law(reference) -> PseudospectralTracking:
    return PseudospectralTracking(regulator())


def stored_gain_law(reference) -> StoredGainTracking:
    return StoredGainTracking(regulator(), plan_gains(regulator()))


all_laws = {
    "bank profile": lambda reference: bank_profile(),
    "state feedback": state_feedback,
    "observer": observer_law,
    "range tracking": range_tracking,
    "predictor-corrector": lambda reference: predictor_corrector(),
    "Bézier": lambda reference: stored().guidance,
    "ground track": ground_track_law,
    "replanning": replanning_law,
    # Which of its commands is flown hangs on the sensed drag: held through a cycle.
    "gated": lambda reference: Sampled(
        Gated(state_feedback(reference), bank_profile(), 1.0), 1.0
    ),
    "control profiles": control_profiles,
    "pseudospectral": pseudospectral_law,
    "stored gains": stored_gain_law,
    "Shuttle composition": shuttle_law,
    "modulation composition": modulation_law,
    "sampled bank profile": lambda reference: Sampled(bank_profile(), 1.0),
    "sampled observer": lambda reference: Sampled(observer_law(reference), 1.0),
    "composition": lambda reference: compose(
        AngleOfAttackProfile(PolynomialProfile([0.05, 1e-6])), observer_law(reference)
    ),
    "sampled composition": lambda reference: compose(
        TrimAngleOfAttack(), Sampled(observer_law(reference), 1.0)
    ),
}
"""Makers of every law, each from a drag reference over energy."""


def ahead(start, heading, distance):
    """Where a great circle leads, and the heading there: the textbook formulas, deg."""
    longitude, latitude = np.radians(start)
    heading, distance = np.radians(heading), np.radians(distance)
    sine = np.sin(latitude) * np.cos(distance) + np.cos(latitude) * np.sin(
        distance
    ) * np.cos(heading)
    there = np.arcsin(sine)
    turn = np.arctan2(
        np.sin(heading) * np.sin(distance) * np.cos(latitude),
        np.cos(distance) - np.sin(latitude) * sine,
    )
    after = np.arctan2(
        np.sin(heading) * np.cos(latitude),
        np.cos(heading) * np.cos(latitude) * np.cos(distance)
        - np.sin(latitude) * np.sin(distance),
    )
    return np.degrees((longitude + turn, there, after))


# What `test_every_model` wants to have one of each kind of.


def over(f):
    """Compiled, for an array of cases: without it each operation compiles by itself."""
    return jax.jit(jax.vmap(f))


def tabulated_atmosphere(**numbers) -> TabulatedAtmosphere:
    """The standard to 120 km as a table."""
    altitudes = jnp.linspace(0.0, 120e3, 61)
    source = USStandardAtmosphere1976()
    density, temperature = over(source.density), over(source.temperature)
    return TabulatedAtmosphere(
        altitudes, density(altitudes), temperature(altitudes), **numbers
    )


all_atmospheres = {
    "exponential": lambda: ExponentialAtmosphere(1.225, 7200.0),
    "standard": USStandardAtmosphere1976,
    "table": tabulated_atmosphere,
    "perturbed": lambda: PerturbedAtmosphere(
        ExponentialAtmosphere(1.225, 7200.0),
        (DensityWave(0.05, 25e3, 0.3), DensityWave(0.02, 8e3)),
        trend=1.2,
        share_low=0.03,
        share_high=0.08,
        ground_waves=(GroundWave(0.02, 800e3, 6371e3, 1.0),),
    ),
    "random": lambda: RandomAtmosphere(
        ExponentialAtmosphere(1.225, 7200.0),
        RandomAltitudeProfile(12e3, seed=0.3, nodes=21),
        0.1,
    ),
    "ensemble": lambda: EnsembleAtmosphere(
        jnp.linspace(0.0, 120e3, 61),
        jnp.stack([f * tabulated_atmosphere().densities for f in (0.9, 1.1)]),
        jnp.stack([f * tabulated_atmosphere().temperatures for f in (1.1, 1.0)]),
        profile=1.0,
    ),
    "smoothed": functools.cache(lambda: smoothed(ExponentialAtmosphere(1.225, 7200.0))),
}


ANGLES = jnp.asarray([0.0, 5.0, 12.0, 20.0, 30.0, 45.0]) * degree
MACHS = jnp.asarray([0.4, 0.9, 1.1, 2.0, 5.0, 12.0, 25.0])
"""The grid of `tabulated_aerodynamics`"""


def lift_of_table(angle, mach):
    return jnp.sin(2.0 * angle) * (0.7 + 0.3 * jnp.exp(-mach))


def drag_of_table(angle, mach):
    return 0.1 + jnp.sin(angle) ** 2 * (1.0 + 1.0 / (1.0 + mach))


def on_grid(f):
    return over(lambda a: over(lambda m: f(a, m))(MACHS))(ANGLES)


def tabulated_aerodynamics() -> TabulatedAerodynamics:
    lift, drag = on_grid(lift_of_table), on_grid(drag_of_table)
    return TabulatedAerodynamics(ANGLES, MACHS, lift, drag)


all_aerodynamics = {
    "constant": lambda: ConstantAerodynamics(0.4, 1.2),
    "polynomial": lambda: PolynomialAerodynamics([-0.04, 0.8], [0.05, -0.1, 0.9]),
    "exponential": lambda: ExponentialAerodynamics(
        2.9, 0.3, 3.4e-4, -0.24, 2.4, 0.4, 1.1e-3, 0.023, 10 * degree
    ),
    "table": tabulated_aerodynamics,
    "random": lambda: RandomAerodynamics(
        ConstantAerodynamics(0.4, 1.2),
        RandomMachProfile(5.0, seed=0.6, nodes=13),
        RandomMachProfile(5.0, seed=0.7, nodes=13),
        0.1,
        0.05,
    ),
    "scheduled": lambda: ScheduledAerodynamics(
        PolynomialAerodynamics([-0.04, 0.8], [0.05, -0.1, 0.9]),
        PolynomialProfile([0.5, 1e-5]),
    ),
}


WIND_ALTITUDES = jnp.asarray([0.0, 1e3, 5e3, 12e3, 13e3, 30e3, 60e3])
EAST_WIND = jnp.asarray([2.0, 5.0, 20.0, 45.0, 44.0, -10.0, -30.0])
NORTH_WIND = jnp.asarray([0.0, -3.0, -3.0, 8.0, 6.0, 0.0, 5.0])

all_winds = {
    "still": StillAir,
    "constant": lambda: ConstantWind(10.0, -4.0, 0.5),
    "table": lambda: TabulatedWind(WIND_ALTITUDES, EAST_WIND, NORTH_WIND),
    "scaled": lambda: ScaledWind(
        TabulatedWind(WIND_ALTITUDES, EAST_WIND, NORTH_WIND), -1.5
    ),
    "ensemble": lambda: EnsembleWind(
        WIND_ALTITUDES,
        jnp.stack([NORTH_WIND, EAST_WIND]),
        jnp.stack([EAST_WIND, NORTH_WIND]),
        1.0,
    ),
    "random": lambda: RandomWind(
        ConstantWind(10.0, -4.0, 0.5),
        RandomAltitudeProfile(8e3, -1.3e3, seed=0.1, nodes=21),
        RandomAltitudeProfile(8e3, -1.3e3, seed=0.9, nodes=21),
        15.0,
    ),
    "estimated": lambda: EstimatedWind(
        ConstantWind(10.0, -4.0, 0.5),
        WindPrior(20.0, 30e3),
        WindEstimate(jnp.asarray(120e3), Learnt(jnp.array([-7.0, 12.0]), jnp.eye(2))),
    ),
}


all_gravities = {
    "inverse square": lambda: InverseSquareGravity(4.28283e13),
    "constant": lambda: ConstantGravity(3.7),
}


def along_each(function, at, steps):
    """Derivatives of a function along each of some numbers, and central differences.

    One program for both: what is differentiated is also what differences are taken of.
    """
    pushed = jax.jit(lambda x, along: jax.jvp(function, (x,), (along,)))
    at, found = jnp.asarray(at), []
    for along, step in zip(jnp.eye(at.size), steps, strict=True):
        _, slope = pushed(at, along)
        ahead, behind = (pushed(at + h * along, along)[0] for h in (step, -step))
        found.append((slope, (ahead - behind) / (2.0 * step)))
    return map(np.stack, zip(*found, strict=True))
