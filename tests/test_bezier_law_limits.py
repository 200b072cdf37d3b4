"""Path constraints in the Bézier law: commands within limits, and warnings."""

import dataclasses

import pytest
from bezier_laws import LAW, VEHICLE, at, decided, expected_forces, number

from jentry.flight.scenario_checks import check
from jentry.flight.sensing import first_measurement
from jentry.guidance import AbstractSampledLaw, BezierGuidance, ShorteningCycle
from jentry.missions import find_mission
from jentry.missions.cav_h.scenario import stored
from jentry.motion.constraints import (
    Drag,
    DynamicPressure,
    HeatRate,
    LoadFactor,
    limit_of,
    usual_constraints,
)
from jentry.onboard import Measurement


def commanded_below(**kept):
    """With the forces that the model expects at trim."""
    state = at()
    forces = expected_forces(state, VEHICLE.trim_angle_of_attack)
    told = Measurement(state, *forces, *2 * [number(0.0)], kept)
    _, before = LAW.init(told)
    return decided(LAW, told, before).controls


@pytest.mark.slow
def test_it_keeps_the_limits_of_the_scenario():
    """The least angle of attack at which it would glide below a limit, and the largest
    that its load factor allows; without a limit there is none.
    """
    free = float(commanded_below().angle_of_attack)
    by_load = commanded_below(load=LoadFactor(0.3), other=LoadFactor(5.0))
    assert float(by_load.angle_of_attack) < free
    lift, _ = expected_forces(at(), by_load.angle_of_attack)
    assert float(lift) == pytest.approx(0.3 * 9.80665, rel=1e-9)
    gliding = commanded_below(pressure=DynamicPressure(2e3))
    assert float(gliding.angle_of_attack) > free
    hot = commanded_below(heat=HeatRate(1e5))
    assert float(hot.angle_of_attack) > free
    none = commanded_below(heat=HeatRate(), load=LoadFactor(), glide=Drag(0.1))
    assert float(none.angle_of_attack) == free


def test_the_limits_are_told_to_the_law_in_flight():
    """A constraint of the scenario is the law's: no other copy of it is anywhere."""
    scenario = stored()
    found = first_measurement(scenario).constraints
    assert found is scenario.constraints
    assert limit_of(found, HeatRate) == 2e6
    assert limit_of({"a": HeatRate(3.0), "b": HeatRate(2.0)}, HeatRate) == 2.0
    assert limit_of({"a": HeatRate(), "b": Drag(1.0)}, HeatRate) is None
    glide = scenario.guidance.glide(scenario.constraints)
    assert glide.constraints is scenario.constraints


class Wrapped(AbstractSampledLaw):
    """Forwards everything."""

    law: BezierGuidance
    cycle: ShorteningCycle

    def init(self, measurement):
        return self.law.init(measurement)

    def update(self, *sensed):
        return self.law.update(*sensed)

    def __call__(self, *sensed):
        return self.law(*sensed)


def test_a_scenario_without_limits_is_flown_with_a_warning():
    """Unless it has none of the constraints, and so nothing that could be kept."""
    scenario = dataclasses.replace(stored(), constraints=usual_constraints())
    names = "dynamic_pressure, heat_rate, load_factor"
    said = (
        f"BezierGuidance respects the limits of {names}, .* DynamicPressure\\(limit\\)"
    )
    with pytest.warns(UserWarning, match=said):
        check(scenario)
    wrapped = dataclasses.replace(scenario, guidance=Wrapped(LAW, LAW.cycle))
    with pytest.warns(UserWarning, match="Wrapped respects the limits"):
        check(wrapped)


@pytest.mark.parametrize(
    "known",
    [{}, {"drag": Drag()}, {"heat_rate": HeatRate(1e6), "load_factor": LoadFactor()}],
    ids=["none", "another", "one with a limit"],
)
def test_limits_that_are_given_or_not_meant_are_no_warning(known):
    """Warnings are errors in the tests."""
    check(dataclasses.replace(stored(), constraints=known))


@pytest.mark.slow
def test_a_law_that_keeps_no_limits_needs_none():
    scenario = find_mission("mars-drag-tracking").scenario("time-index")
    assert all(each.limit is None for each in scenario.constraints.values())
    check(scenario)
