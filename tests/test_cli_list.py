"""`jentry list`: every mission with its laws, cases, worlds and dispersions."""

from jentry.missions import ALL


def test_list(command):
    code, printed, said = command("list")
    assert (code, said) == (0, "")
    for mission in ALL.values():
        assert mission.name in printed and mission.title in printed
        assert all(
            name in printed
            for name in [
                *mission.laws,
                *mission.cases,
                *mission.worlds,
                *mission.dispersions,
            ]
        )
