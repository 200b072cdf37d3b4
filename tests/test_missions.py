"""Each case of the papers has a test."""

import pytest
from mission_numbers import MONTE_CARLO, NOMINAL, YAN_HE, ZHOU

from jentry.addresses import field_metadata, leaves_by_address
from jentry.missions import ALL
from jentry.parameters.maps import map_of


def test_every_case_of_the_truths_is_compared():
    elsewhere = {"reference", "nominal_errors"}
    here = {"vehicle", "entry", "target", "dispersions", "study", "table_3", "implied"}
    here |= {"assumed", *MONTE_CARLO, *NOMINAL}
    assert set(YAN_HE) == elsewhere | here
    here = {"vehicle", "start", "target", "parameters", "limits", "study", "assumed"}
    assert set(ZHOU) == here | {"dispersions", "table_3", "fit", "polynomial"}


@pytest.mark.parametrize(
    "name", ["apollo-10", "cav-h-glide", "msl", "neptune-aerocapture"]
)
def test_what_is_tuned_by_default_has_a_size_to_move_by(name):
    mission = ALL[name]
    scenario = mission.scenario()
    leaves = leaves_by_address(scenario)
    assert len(mission.gains) == 2
    for address in mission.gains:
        assert float(leaves[address]) > 0.0
        map_of(address, leaves[address], field_metadata(scenario, address), None)
