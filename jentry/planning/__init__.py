"""Floor 8: plans references, curves and parameters before a flight."""

from .aerocapture_corridor import (
    CaptureCorridor as CaptureCorridor,
    capture_corridor as capture_corridor,
    limiting_flights as limiting_flights,
)
from .bezier_curve import (
    k2_polynomial as k2_polynomial,
    k2_polynomials as k2_polynomials,
    plan_parameters as plan_parameters,
    velocity_map as velocity_map,
)
from .control_splines import (
    control_coefficients as control_coefficients,
    free_controls as free_controls,
)
from .drag_profile import (
    CollocatedProfile as CollocatedProfile,
    DragPlan as DragPlan,
    plan_drag_profile as plan_drag_profile,
)
from .flight_constraints import (
    AlongPath as AlongPath,
    Constraint as Constraint,
    within_limits as within_limits,
)
from .flight_problem import (
    AtEnd as AtEnd,
    FlightProblem as FlightProblem,
    FreeControl as FreeControl,
    Peak as Peak,
    best_flight as best_flight,
)
from .glide import Glide as Glide, plan_glide as plan_glide
from .ground_track import (
    GroundTrackPlan as GroundTrackPlan,
    plan_ground_track as plan_ground_track,
)
from .influence_coefficients import (
    plan_range_over_altitude as plan_range_over_altitude,
    plan_terminal_point as plan_terminal_point,
)
from .inverse_dynamics import (
    ExactInverse as ExactInverse,
    InversePoint as InversePoint,
    SmallAngleInverse as SmallAngleInverse,
)
from .landing_footprint import Footprint as Footprint, footprint as footprint
from .longitudinal_flight import (
    as_longitudinal as as_longitudinal,
    fly_longitudinal as fly_longitudinal,
    plan_bank_over_velocity as plan_bank_over_velocity,
)
from .optimization import Optimized as Optimized, optimize as optimize
from .reference_flight import (
    ReferenceFlight as ReferenceFlight,
    open_loop as open_loop,
    plan_bank_profile as plan_bank_profile,
    plan_drag_reference as plan_drag_reference,
)
