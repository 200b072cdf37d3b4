"""Flights whose bank and angle of attack are free: splines over an index."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._programs import cached
from .._setup import needs_float64
from ..flight.closed_loop import guidance_period
from ..flight.flight import fly
from ..flight.scenario import Scenario
from ..flight.scenario_checks import checked
from ..flight.sensing import first_measurement
from ..flight.termination import Outcome, has_end
from ..guidance.composition import (
    ContinuousComposition,
    SampledComposition,
    compose,
    flies_at_trim,
)
from ..guidance.law import AbstractLaw
from ..guidance.open_loop import ControlProfiles
from ..motion.index import AbstractIndex, EnergyIndex
from ..motion.state import EntryState
from ..onboard.profiles import AbstractProfile, PolynomialProfile
from ..onboard.spline import BSpline


@needs_float64
def free_controls(
    scenario: Scenario,
    bank: float,
    angle_of_attack: float | None = None,
    nodes: int = 40,
    index: AbstractIndex | None = None,
) -> Scenario:
    """A scenario that flies B-splines of the bank and of the angle of attack.

    The splines replace the law, and are constant at first. Their breakpoints lie at equal
    time intervals of the flight under these constant controls. `control_coefficients` is
    the lens to their coefficients.

    **Arguments:**

    - `bank`: rad, positive to the right.
    - `angle_of_attack`: rad. If it is None, the law of the angle of attack in a composed
      law (see `compose`) commands it, or else the vehicle flies at trim.
    - `nodes`: number of coefficients of each spline.
    - `index`: independent variable of the splines, which must be monotonic along the
      flight. None for the energy, which is the usual choice: it always falls, and does not
      depend on the time of flight.

    **Raises:** `ValueError` for an index that is not monotonic, for a flight without an
    end, and if `angle_of_attack` is None although the law commands an angle of attack.
    """
    if nodes < 4:
        raise ValueError(f"nodes is {nodes}: a cubic has 4 or more")
    over = EnergyIndex() if index is None else index
    scenario = checked(scenario)
    held = _flying(scenario, over, _constant(bank), angle_of_attack, _constant)
    breakpoints = _equal_in_time(held, over, nodes - 2)

    def spline(value: float) -> BSpline:
        return BSpline(jnp.full(nodes, value), jnp.asarray(breakpoints))

    return _flying(scenario, over, spline(bank), angle_of_attack, spline)


def control_coefficients(scenario: Scenario) -> Any:
    """Lens to the coefficients of the splines of `free_controls`: bank, angle of attack."""
    controls = free_part(scenario)
    splines = controls.bank, controls.angle_of_attack
    return [each.coefficients for each in splines if isinstance(each, BSpline)]


def bank_coefficients(scenario: Scenario) -> Any:
    """Lens to the coefficients of the bank only."""
    bank = free_part(scenario).bank
    if not isinstance(bank, BSpline):
        raise ValueError(f"the bank is a {type(bank).__name__}: see free_controls")
    return bank.coefficients


def free_part(scenario: Scenario) -> ControlProfiles:
    """The law of `free_controls` that flies the splines.

    **Raises:** `ValueError` for a scenario with another law.
    """
    law = scenario.guidance
    if isinstance(law, ContinuousComposition | SampledComposition):
        law = law.bank
    if not isinstance(law, ControlProfiles):
        raise ValueError(
            f"{type(law).__name__} flies no splines of the controls: see free_controls"
        )
    return law


def _constant(value: float) -> AbstractProfile:
    return PolynomialProfile(jnp.asarray([value]))


def _flying(
    scenario: Scenario,
    index: AbstractIndex,
    bank: AbstractProfile,
    angle_of_attack: float | None,
    profile: Any,
) -> Scenario:
    law: AbstractLaw
    if angle_of_attack is not None:
        law = ControlProfiles(index, scenario.planet, profile(angle_of_attack), bank)
    else:
        law = ControlProfiles(index, scenario.planet, None, bank)
        before = scenario.law
        if isinstance(before, ContinuousComposition | SampledComposition):
            law = compose(before.angle_of_attack, law, before.limits)
        else:
            measurement = first_measurement(scenario)
            if not flies_at_trim(before, 0.0 * measurement.drag, measurement):
                raise ValueError(
                    f"{type(before).__name__} commands an angle of attack of its own: "
                    "give one to begin with, such as angle_of_attack=20 * deg"
                )
    return dataclasses.replace(scenario, guidance=law)


_INTERVALS = 2000
"""Intervals into which the flight is divided to find the breakpoints"""

_flown = cached(fly)


def _equal_in_time(scenario: Scenario, index: AbstractIndex, count: int) -> np.ndarray:
    """Values of the index at equal time intervals of a flight, in rising order."""
    flight = _flown(scenario)
    if not has_end(flight.outcome):
        outcome = Outcome(int(flight.outcome)).message
        raise ValueError(f"the flight under constant controls {outcome}: take others")
    interval = guidance_period(scenario) or _rounded(float(flight.time) / _INTERVALS)
    flight = _flown(scenario, history=interval)
    assert flight.history is not None
    flown = np.isfinite(np.asarray(flight.history.time))
    time = np.append(np.asarray(flight.history.time)[flown], float(flight.time))

    def value(time: Any, state: EntryState) -> Any:
        return index.value(scenario.planet, time, state)

    along = jax.vmap(value)(flight.history.time, flight.history.states)
    last = value(flight.time, flight.state)
    values = np.append(np.asarray(along)[flown], float(last))
    steps = np.diff(values)
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        turns = time[1:][np.sign(steps) != np.sign(values[-1] - values[0])][0]
        raise ValueError(
            f"the {type(index).__name__} turns round {turns:.0f} s after the start: take "
            "another, such as EnergyIndex()"
        )
    nodes = np.interp(np.linspace(0.0, time[-1], count), time, values)
    return np.sort(nodes)


def _rounded(interval: float) -> float:
    """An interval rounded to one digit, so that similar flights share one program."""
    return float(f"{interval:.0e}")
