"""Mars lander in three dimensions, with a scaled reference and bank reversals.

Entry, target, gains and dispersions are those of the mission `mars-drag-tracking`, whose
source flies in the plane and does not scale its reference. Choices of our own are marked.
"""

import dataclasses
from typing import TYPE_CHECKING

import equinox as eqx

from ..._computed_once import computed_once
from ..._programs import cached
from ...campaign.dispersions import Dispersion
from ...flight.scenario import Scenario
from ...guidance.lateral import CrossrangeCorridor, FixedSide
from ...guidance.predictor_corrector import PredictorCorrector
from ...guidance.range_tracking import RangeTracking, ScaleLimits
from ...motion.dynamics import EntryDynamics, EquatorialDynamics
from ...motion.index import EnergyIndex
from ...motion.quantities import ground_track
from ...onboard.model import OnboardModel
from ...onboard.navigation_sensors import Altimeter, TerrainPosition
from ...onboard.profiles import PolynomialProfile, QuinticProfile
from ...onboard.reference import DragReference
from ...planning.reference_flight import ReferenceFlight, open_loop, plan_drag_reference
from ...units import degree, km
from ..inertial import Errors, Inertial, Sensors, near
from ..mission import Mission
from ..npcg_toolbox import through_fitted_mars_air
from . import neural_law, predictor_corrector, terminal_point
from .air_with_waves import (
    air_and_vehicle,
    hard_air,
    hard_air_errors,
    wider,
    without_noise,
    without_scale_height,
)
from .drag_tracking import (
    TABULATED_TO,
    entry,
    independent,
    lift_to_drag_held,
    nominal_gains,
    nominal_observer,
    reference,
    to_the_place,
)


if TYPE_CHECKING:
    from ...learning.law_training import LawTraining


GATE = 1.0
"""Drag above which the range is tracked, m/s2. At lower drag the lift has little effect,
and the range per energy varies too steeply to scale the reference with it."""

LAST_RANGE = 10.0 * km
"""Range to go below which the scale is held. The lower bound that `ScaleLimits` explains is
7 km at the end of the reference."""


@cached
def _plan(
    start: Scenario, cos_bank: PolynomialProfile
) -> tuple[DragReference, QuinticProfile]:
    """The reference drag and its range over the energy, from the gate to the end."""
    flight = ReferenceFlight.of(open_loop(start, cos_bank, TABULATED_TO))
    drag = plan_drag_reference(flight, EnergyIndex(), GATE)

    def downrange(time, state):
        flown, _ = ground_track(start.planet, start.initial_state, state)
        return {"downrange": flown}

    assert isinstance(drag.drag, QuinticProfile)
    at_gate = drag.drag.start
    flown = flight.tabulate(downrange, EnergyIndex(), 2000, at_gate)
    return drag, flown.profile("downrange")


@computed_once
def _reference() -> tuple[DragReference, QuinticProfile]:
    cos_bank = reference().cos_bank
    assert isinstance(cos_bank, PolynomialProfile)
    return _plan(entry(), cos_bank)


def three_dimensional() -> Scenario:
    """Drag tracking scaled to the range to go, to the target of Table 1 straight ahead.

    Gains and observer are those of the paper's nominal study: its Monte Carlo gains are
    less damped, and here the scale controls the range. The corridor is chosen: it gives six
    or seven bank reversals in a flight, and at most half of its floor as the error at the
    end.
    """
    start = entry()
    drag, range_flown = _reference()
    law = RangeTracking(
        gains=nominal_gains(),
        observer=nominal_observer(),
        reference=drag,
        range_flown=range_flown,
        model=OnboardModel(start.planet, start.vehicle),
        limits=ScaleLimits(lower=0.5, upper=2.0, last_range=LAST_RANGE),
        lateral=CrossrangeCorridor(floor=300.0, widening=4e-4),
    )
    guided = eqx.tree_at(lambda s: s.guidance, to_the_place(start), law)
    return dataclasses.replace(guided, dynamics=EntryDynamics())


def in_plane(scenario: Scenario) -> Scenario:
    """Motion in the vertical plane of the equator, as in the paper."""
    flat = dataclasses.replace(scenario, dynamics=EquatorialDynamics())
    law = flat.guidance
    if not isinstance(law, PredictorCorrector):
        return flat
    network = None if law.network is None else predictor_corrector.range_network()
    law = dataclasses.replace(law, lateral=FixedSide(), in_space=False, network=network)
    return dataclasses.replace(flat, guidance=law)


def _sensors(cycle: float) -> Sensors:
    """Sensors of a future lander: the present ones see the ground after the parachute.

    Position: 40 m, required of the Lander Vision System of Mars 2020 (field test of May
    2019, 43rd Annual AAS Guidance, Navigation and Control Conference, 2020, abstract).
    Altimeter: 2 % of the range, at 10 km, of the radar of the Mars Science Laboratory (B.
    D. Pollard, C. W. Chen, "A Radar Terminal Descent Sensor for the Mars Science Laboratory
    mission", 2009, abstract). We read both as three sigma along each axis. That they
    measure below 30 km, through the heat shield, and each second is chosen.
    """
    below, every = 30.0 * km, near(cycle, 1.0)
    return {
        "terrain": TerrainPosition(40.0 / 3.0, below, cycle=every),
        "altimeter": Altimeter(0.02 * 10.0 * km / 3.0, below, cycle=every),
    }


NAVIGATION = Inertial(
    Errors(
        position=2.8 * km / 3.0,
        velocity=2.0 / 3.0,
        tilt=0.1 * degree / 3.0,
    ),
    decided=("velocity", "altitude"),
    usual=lift_to_drag_held,
    sensors=_sensors,
)
"""Position and velocity: 2.8 km and 2 m/s, which the Mars Science Laboratory was
required to know at its entry (T. J. Martin-Mur and others, "Mars Science Laboratory
Navigation Results", 2012, abstract). We read them as three sigma along each axis.
The attitude is chosen. The instruments are those of `Errors`. At the end the vehicle
opens its parachute, by the velocity or the altitude that it believes"""


def _hard_air_and_knowledge() -> dict[str, Dispersion]:
    """Errors of the hard air and the vehicle, and of what navigation knows."""
    return air_and_vehicle() | dict(NAVIGATION.knowledge())


def _neural_training() -> "LawTraining":
    """Training of the neural law, with the navigation of this mission."""
    return neural_law.training(NAVIGATION)


MISSION = Mission(
    name="mars-range-tracking",
    title="Mars lander, drag tracking scaled to the range to go, with bank reversals",
    source='The family of Yan and He, "Drag-Tracking Guidance for Entry Vehicles '
    'Without Drag Rate Measurement", beyond the paper',
    laws={
        "range-tracking": three_dimensional,
        "predictor-corrector": predictor_corrector.guided,
        "predictor-corrector-network": predictor_corrector.networked,
        "terminal-point": terminal_point.guided,
        "neural": neural_law.neural,
    },
    worlds={
        "hard-air": hard_air,
        "fitted-air": through_fitted_mars_air,
        "in-plane": in_plane,
        "inertial": NAVIGATION.world,
        "aided": NAVIGATION.aided,
    },
    former_variants={
        "three-dimensional": "range-tracking",
        "in-plane": "range-tracking world in-plane",
        "predictor-corrector-in-plane": "predictor-corrector world in-plane",
        "predictor-corrector-network": "predictor-corrector-network world in-plane",
        "predictor-corrector-network-3d": "predictor-corrector-network",
    },
    dispersions={
        "lift-to-drag-held": lift_to_drag_held,
        "independent": independent,
        "hard-air": hard_air_errors,
        "hard-air-without-noise": without_noise,
        "hard-air-without-scale-height": without_scale_height,
        "hard-air-wider": wider,
        "knowledge": NAVIGATION.knowledge,
        "lift-to-drag-held-and-knowledge": NAVIGATION.usual_and_knowledge,
        "hard-air-and-knowledge": _hard_air_and_knowledge,
    },
    train=predictor_corrector.train,
    law_trainings={"neural": _neural_training},
)
