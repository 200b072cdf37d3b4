"""Missions from a file of the user or from an installed package."""

import ast
import contextlib
import dataclasses
import functools
import hashlib
import importlib.metadata
import importlib.util
import sys
import traceback
import types
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from .mission import Mission


GROUP = "jentry.missions"
"""Group of entry points: each has the name of a mission, and points to it"""


def is_file(name: str) -> bool:
    """Whether a text is a file, not the name of a mission."""
    return name.endswith(".py")


_FOUND: dict[Path, Mission] = {}
"""Missions by file: a file that is loaded again is not compiled again if unchanged"""


def mission_in_file(path: Path) -> Mission:
    """The mission that a file defines as `MISSION`.

    Its imports are searched in the folder of the file, after all other places.

    Raises `ValueError` for a file that does not exist or defines no mission, for an error
    during its import, with the line, and for an ambiguous import.
    """
    path = path.resolve()
    sources, code = _read(path)
    known = _FOUND.get(path)
    if known is not None and known.code == code:
        return known
    if known is not None:
        _forget(sources)
    module = _import(path, sources, "mission")
    if not hasattr(module, "MISSION"):
        raise ValueError(
            f"{path} defines no MISSION: end it with MISSION = jentry.Mission(...)"
        )
    found = _own(module.MISSION, f"MISSION of {path}", code, sources)
    _FOUND[path] = found
    return found


def law_in_file(path: Path) -> tuple[Any, dict[str, str]]:
    """What a file defines as `LAW`, and the digests of its code.

    Its imports are searched as those of a mission. If `LAW` is a function, an error in it
    becomes a `ValueError` that names the line.

    Raises `ValueError` for a file without `LAW`, and for the reasons of `mission_in_file`.
    """
    path = path.resolve()
    sources, code = _read(path)
    module = _import(path, sources, "law")
    if not hasattr(module, "LAW"):
        raise ValueError(
            f"{path} defines no LAW: end it with LAW = ..., your law, or a function of a "
            "Scenario that returns it"
        )
    if not isinstance(module.LAW, types.FunctionType):
        return module.LAW, code
    return _naming_the_line(module.LAW, f"LAW of {path}", sources), code


def _read(path: Path) -> tuple[dict[Path, bytes], dict[str, str]]:
    """Contents of a file and of all that it imports from its folder, and their digests."""
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    with _with_the_line(f"{path}"):
        sources = sources_of(path, path.parent, None)
    return sources, _digests(sources, path.parent)


def _import(path: Path, sources: Mapping[Path, bytes], kind: str) -> ModuleType:
    """The module of a file, whose name says of which kind it is."""
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    _refuse_ambiguous(path, sources)
    module = ModuleType(f"{kind}_file_{path.stem}", f"The {kind} of {path}.")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    with _with_the_line(f"{path}", sources):
        exec(compile(sources[path], path, "exec"), vars(module))
    return module


EntryPoint = Any
"""Entry point of `importlib.metadata` or of its backport, which replaces it once it is
imported, as by Dask"""


def packaged_missions() -> dict[str, list[EntryPoint]]:
    """Entry points of the missions of installed packages, by name, without importing."""
    offered: dict[str, list[EntryPoint]] = {}
    for point in importlib.metadata.entry_points(group=GROUP):
        offered.setdefault(point.name, []).append(point)
    return offered


def mission_of_package(point: EntryPoint) -> Mission:
    """The mission to which an entry point points.

    Raises `ValueError` for the reasons of `mission_in_file`.
    """
    where = f"mission {point.name!r} of {where_from(point)}"
    with _with_the_line(where):
        mission = point.load()
    sources: dict[Path, bytes] = {}
    code = {} if point.dist is None else {point.dist.name: point.dist.version}
    file = getattr(sys.modules.get(point.module), "__file__", None)
    if file is not None and is_file(file):
        package, *below = point.module.split(".")
        depth = len(below) + (Path(file).name == "__init__.py")
        root = Path(file).parents[depth]
        sources = sources_of(Path(file), root, {package})
        code |= _digests(sources, root)
    found = _own(mission, where, code, sources)
    if found.name != point.name:
        raise ValueError(
            f"{where} is named {found.name!r}: its entry point must have the same name"
        )
    return found


def where_from(point: EntryPoint) -> str:
    """Text that names the package and the object of an entry point."""
    package = "a package" if point.dist is None else f"the package {point.dist.name}"
    return f"{package} ({point.value})"


def sources_of(
    start: Path, root: Path, names: Collection[str] | None
) -> dict[Path, bytes]:
    """A Python file and all files below a folder that it imports, directly or not.

    **Arguments:**

    - `names`: modules at the top of the folder that are included; None for all.
    """
    found: dict[Path, bytes] = {}
    todo = [start]
    while todo:
        path = todo.pop()
        if path not in found:
            found[path] = path.read_bytes()
            todo += _imported(path, found[path], root, names)
    return dict(sorted(found.items()))


def _imported(
    path: Path, contents: bytes, root: Path, names: Collection[str] | None
) -> Iterator[Path]:
    """Files below a folder that a file imports, at its top or in a function."""
    for parts in _modules_imported(path, ast.parse(contents, path), root):
        if parts[0] == "jentry" or (names is not None and parts[0] not in names):
            continue
        for depth in range(1, len(parts) + 1):
            place = root.joinpath(*parts[:depth])
            for file in (place / "__init__.py", place.parent / f"{place.name}.py"):
                if file.is_file():
                    yield file


def _modules_imported(path: Path, tree: ast.AST, root: Path) -> Iterator[list[str]]:
    """Names of all modules that a file may import, each split into its parts."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module.split(".") if node.module else []
            if node.level:
                folder = path.parents[node.level - 1]
                if not folder.is_relative_to(root):
                    continue
                base = [*folder.relative_to(root).parts, *base]
            if base:
                yield base
            yield from ([*base, alias.name] for alias in node.names)


def _digests(sources: Mapping[Path, bytes], root: Path) -> dict[str, str]:
    return {
        path.relative_to(root).as_posix(): hashlib.sha256(contents).hexdigest()
        for path, contents in sources.items()
    }


def _forget(sources: Collection[Path]) -> None:
    """Remove modules of files that may have changed, so that they are imported again."""
    for name, module in sys.modules.copy().items():
        file = getattr(module, "__file__", None)
        if file is not None and Path(file) in sources:
            del sys.modules[name]


def _refuse_ambiguous(path: Path, sources: Collection[Path]) -> None:
    """Refuse an import that means a file of the folder but that Python finds elsewhere."""
    importlib.invalidate_caches()
    beside = {file.relative_to(path.parent).parts[0] for file in sources}
    for name in sorted(first.removesuffix(".py") for first in beside - {path.name}):
        places = path.parent / f"{name}.py", path.parent / name / "__init__.py"
        spec = importlib.util.find_spec(name)
        found = "no file" if spec is None else spec.origin
        if Path(f"{found}").resolve() not in places:
            ours = next(place for place in places if place in sources)
            raise ValueError(
                f"{path} imports {name}, which is both {ours} and {found}: give yours "
                "another name"
            )


def _own(
    mission: Any, where: str, code: Mapping[str, str], sources: Collection[Path]
) -> Mission:
    """The mission with its code, and with functions whose errors name the line."""
    if not isinstance(mission, Mission):
        raise ValueError(f"{where} is a {type(mission).__name__}: it must be a Mission")

    told = functools.partial(_naming_the_line, where=where, sources=sources)

    return dataclasses.replace(
        mission,
        laws={name: told(f) for name, f in mission.laws.items()},
        cases={name: told(f) for name, f in mission.cases.items()},
        worlds={name: told(f) for name, f in mission.worlds.items()},
        dispersions={name: told(f) for name, f in mission.dispersions.items()},
        figures={name: told(f) for name, f in mission.figures.items()},
        code=code,
    )


def _naming_the_line(
    function: Callable, where: str, sources: Collection[Path]
) -> Callable:
    """The function, whose errors name the line of the user's file."""

    @functools.wraps(function)
    def call(*given: Any) -> Any:
        with _with_the_line(where, sources):
            return function(*given)

    return call


@contextlib.contextmanager
def _with_the_line(where: str, sources: Collection[Path] = ()) -> Iterator[None]:
    """Turn any error into a `ValueError` of one line that names the last of `sources`."""
    try:
        yield
    except (Exception, SystemExit) as error:
        places = [
            f"{frame.f_code.co_filename}, line {line}"
            for frame, line in traceback.walk_tb(error.__traceback__)
            if Path(frame.f_code.co_filename) in sources
        ]
        if isinstance(error, SyntaxError) and error.filename is not None:
            places.append(f"{error.filename}, line {error.lineno}")
        said = " ".join(f"{error}".split())
        if isinstance(error, SyntaxError):
            said = error.msg
        if not isinstance(error, ValueError) or isinstance(error, UnicodeError):
            said = f"{type(error).__name__}: {said}"
        raise ValueError(f"{places[-1] if places else where}: {said}") from error
