"""SX-2, numerical predictor-corrector, without a reference and with the bank only."""

import equinox as eqx

from ...flight.scenario import Scenario
from ...guidance.bank_shapes import LinearBankShape
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import PredictedCrossrange
from ...guidance.path_limits import PathLimits
from ...guidance.predictor_corrector import PredictorCorrector
from ...units import degree
from .scenario import energies, full, reference_controls, track_model


def guided() -> Scenario:
    """Predictor-corrector to the end of the reference, under its angle of attack.

    The angle of attack is that of the reference over the energy. With this bank at the end
    the nominal flight has the altitude there as well. The largest bank is that of the band
    of the other laws. Six bank reversals are enough for a target that lies 145 n mile to
    one side.
    """
    scenario, (_, last) = full(), energies()
    angle, _ = reference_controls()
    law = PredictorCorrector(
        model=track_model().onboard,
        shape=LinearBankShape(end=last, final=25.0 * degree, largest=80.0 * degree),
        end=GuidedEnd(energy=last),
        lateral=PredictedCrossrange(factor=5.0),
        angle_of_attack=angle,
        limits=PathLimits(),
        in_space=False,
        step=5.0,
    )
    return eqx.tree_at(lambda s: s.guidance, scenario, law)
