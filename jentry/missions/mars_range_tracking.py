"""Proto."""

import functools

import equinox as eqx

from ..design.planning import (
    ReferenceFlight,
    open_loop,
    plan_bank_profile,
    plan_drag_reference,
)
from ..guidance.drag_tracking import ErrorGains, ObserverGains
from ..guidance.lateral import LateralCorridor
from ..guidance.range_tracking import Aim, RangeScaling, RangeTracking
from ..motion.quantities import ground_track
from ..onboard.model import OnboardModel
from ..onboard.reference import EnergyIndex
from ..units import km
from .mars_drag_tracking import END_VELOCITY, TABULATED_TO, entry

@functools.cache
def _planner(gate, curvature=0.0):
    @eqx.filter_jit
    def plan(start):
        profile = plan_bank_profile(start, END_VELOCITY, curvature)
        flight = ReferenceFlight.of(open_loop(start, profile, TABULATED_TO))
        drag = plan_drag_reference(flight, EnergyIndex(), gate)

        def downrange(time, state):
            return ground_track(start.planet, start.initial_state, state)[0]

        flown = flight.tabulate(
            downrange, EnergyIndex(), 2000, first_value=drag.drag.start
        )
        return drag, flown
    return plan

def range_tracking(gate=4.0, gains=(5.0,1.982,3.0), obs=(0.481,2.0,1.0), last=5*km, floor=300., wide=1.0, in_plane=False, tab=None, curvature=0.0):
    start = entry()
    drag, flown = _planner(tab or gate, curvature)(start)
    drag = eqx.tree_at(lambda d: d.gate, drag, EnergyIndex and __import__('jax').numpy.asarray(float(gate)))
    t = start.target
    law = RangeTracking(
        ErrorGains(*gains), ObserverGains(*obs), drag, flown,
        OnboardModel(start.planet, start.vehicle),
        Aim(start.initial_state, t.downrange, t.crossrange, t.altitude, t.velocity),
        RangeScaling(last_range=last),
        LateralCorridor(floor, wide),
    )
    s = eqx.tree_at(lambda s: s.guidance, start, law)
    import dataclasses
    return dataclasses.replace(s, in_plane=in_plane)
