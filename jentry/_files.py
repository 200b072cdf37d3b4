"""One way to write a file: whole or not at all, and through no link."""

import hashlib
import io
import os
import secrets
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w


_UNFINISHED = ".unfinished"

_DIGEST = "digest"
"""In an archive, of all other arrays"""

_UNREADABLE = (
    ValueError,
    KeyError,
    OSError,
    EOFError,
    TypeError,
    RuntimeError,
    SyntaxError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What may be raised of an archive that was not written by numpy, or is damaged"""


def write_whole(path: Path | str, contents: bytes) -> None:
    """Write a file so that it is there whole or not at all, also after a crash.

    The contents go to a new file beside it, which nobody can have prepared: its name is
    drawn, and it must not exist. Flushed to the disk, it takes the place of what has the
    name, a link included. A writer that is killed leaves the new file, under a hidden
    name that is never read; see `remove_unfinished`.
    """
    path = Path(path)
    # The beginning alone: a name may be as long as the file system takes.
    unfinished = path.with_name(
        f".{path.name[:40]}.{secrets.token_hex(8)}{_UNFINISHED}"
    )
    new = os.O_WRONLY | os.O_CREAT | os.O_EXCL
    # The first is not on Windows, and the second, which writes bytes, only there.
    new |= getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    try:
        file = os.open(unfinished, new, 0o666)
    except FileExistsError:
        raise
    except OSError as error:
        error.filename = str(path)  # which is the one that the user knows
        raise
    try:
        with os.fdopen(file, "wb") as stream:
            stream.write(contents)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
    _flush_folder(path.parent)


def _flush_folder(folder: Path) -> None:
    """So that a renamed file has its name after a crash as well."""
    if os.name == "nt":  # where a folder cannot be opened
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_toml(path: Path | str, comment: str, contents: Mapping[str, Any]) -> None:
    """Write plain values as TOML under lines of comment, whole or not at all.

    Numbers are written to the last digit. What is None is left out.
    """
    lines = [f"# {line}".rstrip() + "\n" for line in comment.splitlines()]
    given = {name: value for name, value in contents.items() if value is not None}
    write_whole(path, ("".join(lines) + tomli_w.dumps(given)).encode())


def write_sealed(path: Path | str, arrays: Mapping[str, np.ndarray], kind: str) -> None:
    """Write arrays by name as an archive of numpy (npz), whole or not at all.

    Its folder is made if it is not there. A digest of all of them, and of the kind of file
    that it is, goes with them.
    """
    sealed = {**arrays, _DIGEST: np.array(digest_of_arrays(arrays, kind))}
    archive = io.BytesIO()
    np.savez(archive, allow_pickle=False, **sealed)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, archive.getvalue())


def read_sealed(path: Path | str, kind: str) -> dict[str, np.ndarray]:
    """The arrays of such an archive, by name. Nothing in a file is executed.

    Raises `ValueError` for a file that is none, of another kind, or damaged: numpy alone
    may read one with arrays that are shorter or not there at all.
    """
    try:
        archive = io.BytesIO(Path(path).read_bytes())
        with np.load(archive, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        digest = str(arrays.pop(_DIGEST))
    except _UNREADABLE as error:
        raise ValueError(str(error)) from error
    if digest != digest_of_arrays(arrays, kind):
        raise ValueError(
            "it is damaged, or of another kind: its contents are not those of its digest"
        )
    return arrays


def digest_of_arrays(arrays: Mapping[str, np.ndarray], kind: str) -> str:
    """Of names, types, shapes and contents, and of the kind of file."""
    hashed = hashlib.sha256()
    named = {**arrays, "format": np.array(kind)}
    for name in sorted(named):
        array = np.ascontiguousarray(named[name])
        hashed.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        hashed.update(array.tobytes())
    return hashed.hexdigest()


def remove_unfinished(folder: Path, pattern: str) -> None:
    """Remove what killed writers of files with such names have left in a folder.

    Only for a folder that nobody else writes these files into at the time.
    """
    for unfinished in folder.glob(f".{pattern}.*{_UNFINISHED}"):
        unfinished.unlink(missing_ok=True)
