"""Floor 8: references, curves and parameters that are planned before a flight."""

from .bezier_curve import (
    k2_polynomial as k2_polynomial,
    k2_polynomials as k2_polynomials,
    plan_parameters as plan_parameters,
    velocity_map as velocity_map,
)
from .drag_profile import (
    CollocatedProfile as CollocatedProfile,
    DragPlan as DragPlan,
    plan_drag_profile as plan_drag_profile,
)
from .glide import Glide as Glide, plan_glide as plan_glide
from .ground_track import (
    GroundTrackPlan as GroundTrackPlan,
    plan_ground_track as plan_ground_track,
)
from .inverse_dynamics import (
    ExactInverse as ExactInverse,
    InversePoint as InversePoint,
    SmallAngleInverse as SmallAngleInverse,
)
from .longitudinal_flight import (
    fly_longitudinal as fly_longitudinal,
    plan_bank_over_velocity as plan_bank_over_velocity,
)
from .reference_flight import (
    ReferenceFlight as ReferenceFlight,
    open_loop as open_loop,
    plan_bank_profile as plan_bank_profile,
    plan_drag_reference as plan_drag_reference,
)
