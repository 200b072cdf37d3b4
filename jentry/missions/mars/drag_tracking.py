"""Mars lander, drag tracking without drag-rate measurement.

Source: H. Yan, Y. He, "Drag-Tracking Guidance for Entry Vehicles Without Drag Rate
Measurement". What the paper leaves open is stated where it is chosen.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp

from ..._computed_once import computed_once
from ..._programs import cached
from ...campaign.dispersions import Dispersion, multiply
from ...campaign.distributions import Uniform
from ...flight.scenario import Scenario, Target
from ...flight.termination import (
    AltitudeAbove,
    AltitudeBelow,
    Termination,
    VelocityBelow,
)
from ...guidance.drag_tracking import (
    ErrorGains,
    ObserverDragTracking,
    ObserverGains,
    StateFeedbackDragTracking,
)
from ...guidance.open_loop import BankProfile
from ...motion.dynamics import EquatorialDynamics
from ...motion.index import (
    AbstractIndex,
    EnergyIndex,
    TimeIndex,
    VelocityIndex,
)
from ...motion.state import EntryState
from ...onboard.model import OnboardModel
from ...onboard.profiles import PolynomialProfile
from ...onboard.reference import DragReference
from ...planning.reference_flight import (
    ReferenceFlight,
    open_loop,
    plan_bank_profile,
    plan_drag_reference,
    require_planned,
)
from ...units import degree, km
from ...world.aerodynamics import ConstantAerodynamics
from ...world.atmosphere import ExponentialAtmosphere
from ...world.gravity import InverseSquareGravity
from ...world.planet import Planet
from ...world.vehicle import Vehicle


END_VELOCITY = 503.0
"""Velocity at the end, m/s: Table 1"""

TABULATED_TO = 300.0
"""Velocity down to which the reference extends, m/s: beyond the end, so that every
dispersed flight has a reference"""


def mars() -> Planet:
    """Mars as implied by the paper, with usual values of gravity and atmosphere.

    The radius makes the 12.2 degrees of Table 1 equal to its 723.32 km. Temperature and gas
    are those of an isothermal carbon dioxide atmosphere with this scale height; they affect
    only the Mach number.
    """
    return Planet(
        radius=3397.0 * km,
        gravity=InverseSquareGravity(4.28283e13),
        atmosphere=ExponentialAtmosphere(
            surface_density=0.0158,
            scale_height=9354.5,
            isothermal_temperature=183.7,
            gas_constant=188.92,
            heat_capacity_ratio=1.29,
        ),
        heating_coefficient=1.9027e-4,
    )


def lander() -> Vehicle:
    """The lander of section 4: 992 kg, 16 m2, lift-to-drag ratio 0.18 and 115 kg/m2."""
    mass, area = 992.0, 16.0
    drag_coefficient = mass / (115.0 * area)
    aerodynamics = ConstantAerodynamics(0.18 * drag_coefficient, drag_coefficient)
    return Vehicle(mass, area, aerodynamics=aerodynamics)


def entry() -> Scenario:
    """The entry of Table 1, with zero bank in place of the law."""
    return Scenario(
        planet=mars(),
        vehicle=lander(),
        initial_state=EntryState(
            altitude=126.1 * km,
            longitude=0.0,
            latitude=0.0,
            velocity=6750.0,
            flight_path_angle=-14.4 * degree,
            heading=90.0 * degree,
        ),
        guidance=BankProfile(PolynomialProfile(jnp.ones(1))),
        termination=Termination(
            {
                "velocity": VelocityBelow(velocity=END_VELOCITY),
                "altitude": AltitudeBelow(altitude=10.0 * km),
                "skip_out": AltitudeAbove(altitude=135.0 * km),
            },
            time_limit=600.0,
        ),
        target=Target(altitude=10.0 * km, velocity=END_VELOCITY, downrange=723.32 * km),
        dynamics=EquatorialDynamics(),
    )


def to_the_place(scenario: Scenario) -> Scenario:
    """The scenario with a target that is a place, for laws that fly to one.

    The place does not move with the start. The paper's law has no place: its downrange is
    the range from the start of each flight.
    """
    target = dataclasses.replace(scenario.target, origin=scenario.initial_state)
    return dataclasses.replace(scenario, target=target)


@cached
def _plan(
    entry: Scenario, index: AbstractIndex, gate: float, curvature: float
) -> DragReference:
    profile = plan_bank_profile(entry, END_VELOCITY, curvature)
    flight = ReferenceFlight.of(open_loop(entry, profile, TABULATED_TO))
    # The energy hardly falls before there is drag, so the first intervals are short.
    power = 2 if isinstance(index, EnergyIndex) else 1
    return plan_drag_reference(flight, index, gate, power=power)


@computed_once
def reference(
    index: AbstractIndex = EnergyIndex(), gate: float = 0.0, curvature: float = 0.0
) -> DragReference:
    """The planned reference drag.

    The paper's profile, from its reference [1], is not available. This is the drag under
    the bank profile cos(bank) = c0 + c1 z + c2 z^2 over the velocity that ends at the
    values of Table 1; `curvature` is c2. `gate` is in m/s2.
    """
    planned = _plan(entry(), index, gate, curvature)
    require_planned(planned.drag)
    return planned


def scenario(
    index: AbstractIndex,
    gains: ErrorGains,
    observer: ObserverGains | None,
    *,
    gate: float = 0.0,
    curvature: float = 0.0,
) -> Scenario:
    """The entry with the law (24) and observer (25), or law (14) without an observer."""
    start = entry()
    drag = reference(index, gate, curvature)
    model = OnboardModel(start.planet, start.vehicle)
    if observer is None:
        law = StateFeedbackDragTracking(gains, drag, model)
    else:
        law = ObserverDragTracking(gains, observer, drag, model)
    return eqx.tree_at(lambda s: s.guidance, start, law)


def nominal_gains() -> ErrorGains:
    """Gains of figures 1 to 10."""
    return ErrorGains(epsilon0=5.0, a=1.982, b=3.0)


def nominal_observer() -> ObserverGains:
    """Observer of figures 6 to 10."""
    return ObserverGains(epsilon=0.481, l1=2.0, l2=1.0)


def monte_carlo_gains() -> ErrorGains:
    """Gains of figure 11 and Table 3."""
    return ErrorGains(epsilon0=20.0, a=20.0, b=5.0)


def monte_carlo_observer() -> ObserverGains:
    """Observer of figure 11 and Table 3."""
    return ObserverGains(epsilon=0.45, l1=2.0, l2=1.0)


GATE = 4.0
"""Drag above which the law tracks, m/s2. A velocity index needs a gate of 3 to 5, since
the velocity rises at first."""


def table_3() -> Scenario:
    """The Monte Carlo study over velocity, which fits the printed statistics."""
    return scenario(
        VelocityIndex(), monte_carlo_gains(), monte_carlo_observer(), gate=GATE
    )


def energy_index() -> Scenario:
    """The Monte Carlo study over energy, which needs no gate."""
    return scenario(EnergyIndex(), monte_carlo_gains(), monte_carlo_observer())


def time_index() -> Scenario:
    """The Monte Carlo study over time."""
    return scenario(TimeIndex(), monte_carlo_gains(), monte_carlo_observer())


def state_feedback() -> Scenario:
    """The flight of figures 1 to 5: law (14), over energy."""
    return scenario(EnergyIndex(), nominal_gains(), None)


def observer_feedback() -> Scenario:
    """The flight of figures 6 to 10: law (24) with observer (25), over energy."""
    return scenario(EnergyIndex(), nominal_gains(), nominal_observer())


@computed_once
def _mass_and_density() -> dict[str, Dispersion]:
    return {
        "mass": Dispersion(
            lambda s: s.vehicle.mass, Uniform(0.95, 1.05), apply=multiply
        ),
        "density": Dispersion(lambda s: s.planet.density_scale, Uniform(0.8, 1.2)),
    }


@computed_once
def lift_to_drag_held() -> dict[str, Dispersion]:
    """Table 2 with one factor on both coefficients: this interpretation fits Table 3."""
    both = Dispersion(
        lambda s: (s.vehicle.lift_scale, s.vehicle.drag_scale), Uniform(0.7, 1.3)
    )
    return _mass_and_density() | {"coefficients": both}


@computed_once
def independent() -> dict[str, Dispersion]:
    """Table 2 as printed, with which some flights cannot reach the range at any bank."""
    return _mass_and_density() | {
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, Uniform(0.7, 1.3)),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, Uniform(0.7, 1.3)),
    }
