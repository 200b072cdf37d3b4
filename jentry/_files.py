"""Writing of files: completely or not at all, and never through a link."""

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
"""Name of the array of an archive that contains the digest of all others"""

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
"""Errors of NumPy for an archive that is damaged or was not written by NumPy"""


def write_whole(path: Path | str, contents: bytes) -> None:
    """Write a file so that it exists completely or not at all, also after a crash.

    The contents are written to a new file in the same folder. Its name is random and must
    not exist, so that no other user can prepare it. After a flush to the disk it replaces
    whatever has the name, including a link. A writer that is killed leaves the new file
    under a hidden name that is never read; see `remove_unfinished`.
    """
    path = Path(path)
    # Only the beginning of the name: a name may be as long as the file system allows.
    unfinished = path.with_name(
        f".{path.name[:40]}.{secrets.token_hex(8)}{_UNFINISHED}"
    )
    new = os.O_WRONLY | os.O_CREAT | os.O_EXCL
    # O_NOFOLLOW does not exist on Windows; O_BINARY, for bytes, exists only there.
    new |= getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    try:
        file = os.open(unfinished, new, 0o666)
    except FileExistsError:
        raise
    except OSError as error:
        error.filename = str(path)  # the name that the user knows
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
    """Flush a folder, so that a renamed file has its new name after a crash as well."""
    if os.name == "nt":  # Windows cannot open a folder
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_toml(path: Path | str, comment: str, contents: Mapping[str, Any]) -> None:
    """Write plain values as TOML under lines of comment, completely or not at all.

    Numbers are written to the last digit. Values of None are left out.
    """
    lines = [f"# {line}".rstrip() + "\n" for line in comment.splitlines()]
    given = {name: value for name, value in contents.items() if value is not None}
    write_whole(path, ("".join(lines) + tomli_w.dumps(given)).encode())


def write_sealed(path: Path | str, arrays: Mapping[str, np.ndarray], kind: str) -> None:
    """Write arrays by name as a NumPy archive (npz), completely or not at all.

    The folder is created if it does not exist. The archive contains a digest of all arrays
    and of the kind of file.
    """
    sealed = {**arrays, _DIGEST: np.array(digest_of_arrays(arrays, kind))}
    archive = io.BytesIO()
    np.savez(archive, allow_pickle=False, **sealed)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, archive.getvalue())


def read_sealed(path: Path | str, kind: str) -> dict[str, np.ndarray]:
    """The arrays of an archive of `write_sealed`, by name. Nothing in it is executed.

    Raises `ValueError` for a file that is not such an archive, is of another kind, or is
    damaged. NumPy alone may read a damaged file in which arrays are shorter or missing.
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
    """Digest of names, types, shapes and contents of arrays, and of the kind of file."""
    hashed = hashlib.sha256()
    named = {**arrays, "format": np.array(kind)}
    for name in sorted(named):
        array = np.ascontiguousarray(named[name])
        hashed.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        hashed.update(array.tobytes())
    return hashed.hexdigest()


def remove_unfinished(folder: Path, pattern: str) -> None:
    """Remove unfinished files that killed writers have left in a folder.

    `pattern` is that of the names of the files. No other process may write such files into
    the folder at the same time.
    """
    for unfinished in folder.glob(f".{pattern}.*{_UNFINISHED}"):
        unfinished.unlink(missing_ok=True)
