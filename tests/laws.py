"""One guidance law of each kind, for the Mars scenario and from one drag reference."""

import jax.numpy as jnp
from helpers import bank_profile, mars_planet, mars_vehicle
from neural_laws import ANGLES, PERIOD, law_of

from jentry.guidance import (
    Adjustment,
    AerocaptureGuidance,
    AngleOfAttackProfile,
    ApolloEntry,
    AttitudeBand,
    AttitudeLag,
    ConstantBankShape,
    ConstantDrag,
    ControlProfiles,
    CrossrangeCorridor,
    DeviationWeights,
    DynamicalModulation,
    EarlyEnd,
    ErrorGains,
    FixedCycle,
    FixedSide,
    Gate,
    Gated,
    GroundTrackModel,
    GroundTrackTracking,
    GuidedEnd,
    HeadingAlignment,
    InitialRoll,
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
    SkipPrediction,
    StateFeedbackDragTracking,
    StoredGainTracking,
    TerminalPoint,
    TrackingGains,
    TrimAngleOfAttack,
    compose,
    plan_gains,
)
from jentry.guidance.aim import TargetOfScenario
from jentry.learning.recorded_law import RecordedLaw
from jentry.missions.cav_h.scenario import stored
from jentry.motion.index import EnergyIndex, VelocityIndex
from jentry.motion.orbit import OrbitTarget
from jentry.onboard import (
    LongitudinalModel,
    LongitudinalReference,
    OnboardModel,
    PolynomialProfile,
    Reference,
    VelocityDomain,
    quintic_table,
)
from jentry.units import degree, km
from jentry.world import PolynomialAerodynamics, Vehicle


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


def terminal_point(reference) -> TerminalPoint:
    """Near the planned flight at 5000 m/s, with straight lines over the velocity."""
    lines = {
        "drag": [116.2, 0.02],
        "altitude_rate": [-572.0, -0.26],
        "lift_to_drag_up": [0.107, -4e-6],
        "range_to_go": [221.5 * km, 47.0],
        "range_per_drag": [-870.0, 0.1],
        "range_per_altitude_rate": [310.0, 0.04],
        "range_per_lift_to_drag": [980.0 * km, 310.0],
    }
    quantities = {name: PolynomialProfile(c, 5000.0) for name, c in lines.items()}
    model = OnboardModel(mars_planet(), mars_vehicle())
    return TerminalPoint(
        reference=Reference(VelocityIndex(), quantities),
        planet=model.planet,
        lateral=CrossrangeCorridor(300.0, 4e-4),
        gate=4.0,
        prebank=57.0 * degree,
        gain=5.0,
        alignment=HeadingAlignment(700.0),
        early_end=EarlyEnd(model, PolynomialProfile([1.0 * km, 5.0], 10.0 * km)),
    )


def apollo(reference) -> ApolloEntry:
    """With velocities of Mars, such that the flights go through constant drag."""
    return ApolloEntry(
        final=terminal_point(reference),
        prediction=SkipPrediction(
            lift_to_drag=0.18,
            circular_velocity=3500.0,
            radius=3430 * km,
            scale_height=9354.5,
        ),
        initial_roll=InitialRoll(shallow_velocity=4000.0, slow_velocity=3600.0),
        constant_drag=ConstantDrag(slow_exit=2000.0),
        cycle=FixedCycle(1.0),
    )


def aerocapture() -> AerocaptureGuidance:
    """To an orbit of its own, in long steps."""
    return AerocaptureGuidance(
        model=OnboardModel(mars_planet(), mars_vehicle()),
        orbit=OrbitTarget(500 * km, 500 * km),
        exit_altitude=135 * km,
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
    "terminal point": terminal_point,
    "Apollo": apollo,
    "aerocapture": lambda reference: aerocapture(),
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
    "neural": lambda reference: law_of(),
    "neural beside another": lambda reference: law_of(
        beside=Sampled(bank_profile(), PERIOD), corrects=True
    ),
    "neural with an angle of attack": lambda reference: law_of(angles=ANGLES),
    "recorded": lambda reference: RecordedLaw(
        law=Sampled(bank_profile(), 1.0), reader=law_of(), cycle=FixedCycle(1.0)
    ),
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
