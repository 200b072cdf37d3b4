"""A wrong command line ends with an exit code and a message and writes nothing."""

import pytest
from bad_commands import COMMANDS


def shown(words):
    """Of a long text the beginning."""
    return " ".join(words)[:60]


@pytest.mark.parametrize(
    ("words", "files", "word"),
    COMMANDS,
    ids=[
        f"{shown(words)} {' '.join(map(str, f.values()))[:30]!r}"
        for words, f, _ in COMMANDS
    ],
)
def test_a_command_refuses(command, tmp_path, words, files, word):
    for name, contents in files.items():
        contents = contents.encode() if isinstance(contents, str) else contents
        (tmp_path / name).write_bytes(contents)
    code, printed, said = command(*words)
    assert code == 2, said
    assert word in said + printed * (not words)
    assert "Traceback" not in said
    if not said.startswith("Usage") and words:
        assert said.startswith("jentry: ") and not printed
    assert {path.name for path in tmp_path.rglob("*")} == set(files)


FOLDERS = {
    "a file for a folder": ("file", 3, "file is a file: give a folder"),
    "a folder in a file": ("file/out", 4, "Not a directory"),
}


@pytest.mark.parametrize(("out", "code", "word"), FOLDERS.values(), ids=FOLDERS)
def test_a_place_that_cannot_be_written_to(command, tmp_path, out, code, word):
    (tmp_path / "file").write_text("mine")
    result = command("monte-carlo", "cheap", "--runs", 2, "--out", out)
    assert result[0] == code and word in result[2]
    assert [path.name for path in tmp_path.rglob("*")] == ["file"]
    assert (tmp_path / "file").read_text() == "mine"


# Values on the edge of a range are taken.

TAKEN = [
    "initial_state.latitude=90deg",
    "initial_state.latitude=-90deg",
    "initial_state.flight_path_angle=-90deg",
    "initial_state.heading=360deg",
    "initial_state.heading=-360deg",
    "initial_state.longitude=6.2831",
    "initial_state.altitude=0",
    "initial_state.altitude=126.1 km",
    "initial_state.velocity=15e3 mph",
    "planet.rotation_rate=-15 deg/h",
    "target.altitude=-3 km",
    "vehicle.lift_scale=-5 %",
]


@pytest.mark.parametrize("text", TAKEN)
def test_what_can_be_flown_is_taken(command, text):
    text = text.replace("mph", "mi/h")
    code, printed, said = command("show", "cheap", f"--set={text}")
    assert (code, said) == (0, "")
    assert text.partition("=")[0] in printed


def test_what_is_allowed_is_shown(command):
    printed = command("show", "cheap")[1].splitlines()
    for address, words in (
        ("vehicle.mass", "greater than zero"),
        ("initial_state.latitude", "between -90 and 90 deg"),
        ("initial_state.altitude", "zero or more"),
    ):
        assert any(address in line and words in line for line in printed)
