"""Files are written whole or not at all, through no link, and by one writer."""

import ast
import os
import secrets
import stat

import numpy as np
import pytest
from test_structure import MODULES, PACKAGE, place

from jentry._files import (
    digest_of_arrays,
    read_sealed,
    remove_unfinished,
    write_sealed,
    write_whole,
)


def test_a_file_is_written_over_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "file"
    for contents in (b"first, and longer", b"second"):
        write_whole(path, contents)
        assert path.read_bytes() == contents
        assert list(tmp_path.iterdir()) == [path]


def test_a_name_as_long_as_can_be(tmp_path):
    path = tmp_path / ("é" * 127)  # 254 bytes; most file systems take 255
    write_whole(path, b"x")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("umask", [0o022, 0o027, 0o077], ids=oct)
def test_others_may_read_what_the_user_lets_them(tmp_path, umask):
    """As of a file that is opened for writing, and not as of a temporary one."""
    before = os.umask(umask)
    try:
        write_whole(tmp_path / "file", b"x")
    finally:
        os.umask(before)
    mode = stat.S_IMODE((tmp_path / "file").stat().st_mode)
    assert mode == 0o666 & ~umask


def test_a_link_is_replaced_and_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_bytes(b"precious")
    link = tmp_path / "link"
    link.symlink_to(victim)
    write_whole(link, b"x")
    assert victim.read_bytes() == b"precious"
    assert not link.is_symlink() and link.read_bytes() == b"x"


@pytest.mark.parametrize("kind", ["link", "dangling link", "file"])
def test_even_a_name_that_was_guessed_is_not_written_through(
    tmp_path, monkeypatch, kind
):
    monkeypatch.setattr(secrets, "token_hex", lambda count: "guessed")
    there = tmp_path / "elsewhere"
    prepared = tmp_path / ".file.guessed.unfinished"
    if kind == "file":
        prepared.write_bytes(b"precious")
    else:
        prepared.symlink_to(there)
        if kind == "link":
            there.write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        write_whole(tmp_path / "file", b"x")
    assert not (tmp_path / "file").exists()
    if kind == "dangling link":
        assert not there.exists()
    else:
        assert prepared.read_bytes() == b"precious"


def test_the_name_meanwhile_is_another_each_time(tmp_path, monkeypatch):
    seen = []
    replace = os.replace
    monkeypatch.setattr(
        os, "replace", lambda a, b: (seen.append(os.path.basename(a)), replace(a, b))
    )
    for _ in range(3):
        write_whole(tmp_path / "file", b"x")
    assert len(set(seen)) == 3
    # 64 bits and more of chance, hidden, in the same folder.
    assert all(name.startswith(".file.") and len(name) >= 22 for name in seen)


@pytest.mark.parametrize("place", ["fsync", "replace"])
def test_a_write_that_fails_leaves_the_file_as_it_was(tmp_path, monkeypatch, place):
    path = tmp_path / "file"
    write_whole(path, b"before")

    def denied(*given):
        raise OSError("no space left on device")

    monkeypatch.setattr(os, place, denied)
    with pytest.raises(OSError, match="no space left"):
        write_whole(path, b"after")
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_not_there_is_told_by_the_name_that_was_given(tmp_path):
    path = tmp_path / "nowhere" / "file"
    with pytest.raises(FileNotFoundError, match=f"directory: '{path}'$"):
        write_whole(path, b"x")


def test_what_killed_writers_left_is_removed_and_nothing_else(tmp_path):
    victim = tmp_path / "victim"
    victim.write_bytes(b"precious")
    left = [tmp_path / f".runs-1.{i}.unfinished" for i in range(2)]
    left[0].write_bytes(b"half")
    left[1].symlink_to(victim)
    others = [tmp_path / name for name in ("runs-1.nc", ".notes.0.unfinished")]
    for other in others:
        other.write_bytes(b"mine")
    remove_unfinished(tmp_path, "runs-*")
    assert set(tmp_path.iterdir()) == {victim, *others}
    assert victim.read_bytes() == b"precious"


ARRAYS = {
    "loss": np.array([3.0, 2.0, 1.0]),
    "text": np.array('{"seed": 1}'),
}


def same(arrays):
    return set(arrays) == set(ARRAYS) and all(
        arrays[name].dtype == ARRAYS[name].dtype
        and np.array_equal(arrays[name], ARRAYS[name])
        for name in ARRAYS
    )


def test_arrays_come_back(tmp_path):
    path = tmp_path / "new" / "arrays"
    write_sealed(path, ARRAYS, "a test")
    assert same(read_sealed(path, "a test"))
    with pytest.raises(ValueError, match="damaged, or of another kind"):
        read_sealed(path, "another test")


OTHERS = {
    "a number": ARRAYS | {"loss": np.array([3.0, 2.0, 1.0 + 1e-15])},
    "a shape": ARRAYS | {"loss": np.array([[3.0, 2.0, 1.0]])},
    "fewer": ARRAYS | {"loss": np.array([3.0, 2.0])},
    "a type": ARRAYS | {"loss": np.array([3.0, 2.0, 1.0]).view(int)},
    "a name": {"lost": ARRAYS["loss"], "text": ARRAYS["text"]},
    "one less": {"loss": ARRAYS["loss"]},
}


@pytest.mark.parametrize("other", OTHERS.values(), ids=OTHERS)
def test_the_digest_is_of_all_that_arrays_are(other):
    digest = digest_of_arrays(ARRAYS, "a test")
    assert digest_of_arrays(dict(reversed(ARRAYS.items())), "a test") == digest
    assert digest_of_arrays(other, "a test") != digest
    assert digest_of_arrays(ARRAYS, "another test") != digest


WRITES = {
    "write_text",
    "write_bytes",
    "savez",
    "savez_compressed",
    "savetxt",
    "mkstemp",
}


@pytest.mark.parametrize("path", MODULES, ids=place)
def test_one_writer_for_all_files(path):
    """No other module opens a file to write."""
    if path == PACKAGE / "_files.py":
        return
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        name = getattr(function, "attr", getattr(function, "id", ""))
        assert name not in WRITES, ast.unparse(node)
        if name == "open":
            given = [*node.args, *(k.value for k in node.keywords)]
            if given and ast.unparse(given[0]) == "os.devnull":
                continue
            modes = [x.value for x in given if isinstance(x, ast.Constant)]
            words = [mode for mode in modes if isinstance(mode, str)]
            wrong = [
                m for m in words if set(m) <= set("rwaxbt+") and set(m) & set("wax+")
            ]
            assert not wrong, ast.unparse(node)


@pytest.mark.parametrize("path", MODULES, ids=place)
def test_every_process_of_python_is_isolated(path):
    """`python -c` looks into the working folder first."""
    source = path.read_text()
    assert source.count("sys.executable") == source.count('"-I"')
