"""The mission Mars aerocapture: its law and its dispersions."""

from ..mission import Mission
from .dispersions import air_and_vehicle, entry_errors, everything
from .scenario import guided


MISSION = Mission(
    name="mars-aerocapture",
    title="Orbiter captured by the air of Mars, numerical predictor-corrector",
    source='Gelly and Vernis, "Neural Networks as a Guidance Solution for Soft-Landing and '
    'Aerocapture", AIAA 2009-5664; law of Lu and others, JGCD 38(4), 2015',
    laws={"predictor-corrector": guided},
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
    },
    gains=("guidance.exit_bank", "guidance.first_bank"),
)
