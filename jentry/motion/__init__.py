"""Floor 2: state, forces, equations of motion, derived quantities."""

from .attitude import (
    AbstractAttitude as AbstractAttitude,
    IdealAttitude as IdealAttitude,
    Response as Response,
    SecondOrderAttitude as SecondOrderAttitude,
    Swing as Swing,
)
from .constraints import (
    AbstractConstraint as AbstractConstraint,
    AbstractIntegral as AbstractIntegral,
    ConstraintValues as ConstraintValues,
    Drag as Drag,
    DynamicPressure as DynamicPressure,
    EquilibriumGlide as EquilibriumGlide,
    GeodeticAltitude as GeodeticAltitude,
    GeodeticLatitude as GeodeticLatitude,
    HeatLoad as HeatLoad,
    HeatRate as HeatRate,
    LoadFactor as LoadFactor,
    MachNumber as MachNumber,
    NormalLoadFactor as NormalLoadFactor,
    PathPoint as PathPoint,
    excesses as excesses,
    limit_of as limit_of,
    tightened as tightened,
    usual_constraints as usual_constraints,
)
from .corridor import (
    CorridorPoint as CorridorPoint,
    corridor_point as corridor_point,
    entry_corridor as entry_corridor,
)
from .dynamics import (
    AbstractDynamics as AbstractDynamics,
    EntryDynamics as EntryDynamics,
    EquatorialDynamics as EquatorialDynamics,
    VectorDynamics as VectorDynamics,
    entry_dynamics as entry_dynamics,
    equatorial_dynamics as equatorial_dynamics,
    with_respect_to as with_respect_to,
)
from .forces import AirData as AirData, air_data as air_data
from .geodesy import (
    GeodeticState as GeodeticState,
    from_geodetic as from_geodetic,
    geodetic_position as geodetic_position,
    to_geodetic as to_geodetic,
)
from .index import (
    AbstractIndex as AbstractIndex,
    AltitudeIndex as AltitudeIndex,
    DownrangeIndex as DownrangeIndex,
    EnergyIndex as EnergyIndex,
    TimeIndex as TimeIndex,
    VelocityIndex as VelocityIndex,
)
from .orbit import (
    Burns as Burns,
    Orbit as Orbit,
    OrbitTarget as OrbitTarget,
    burns_to as burns_to,
    inertial_velocity as inertial_velocity,
    orbit_of as orbit_of,
)
from .quantities import (
    convective_heat_rate as convective_heat_rate,
    detra_kemp_riddell_heat_rate as detra_kemp_riddell_heat_rate,
    energy as energy,
    from_ground_track as from_ground_track,
    ground_track as ground_track,
    load_factor as load_factor,
)
from .state import Controls as Controls, EntryState as EntryState
from .vectors import VectorState as VectorState, vector_rates as vector_rates
