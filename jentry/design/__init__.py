"""Floor 7: planning of references."""

from .planning import (
    ReferenceFlight as ReferenceFlight,
    open_loop as open_loop,
    plan_bank_profile as plan_bank_profile,
    plan_drag_reference as plan_drag_reference,
)
