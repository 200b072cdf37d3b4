"""What goes to other processes: in bytes, with the source of what they cannot import.

A law in a script or beside it is a class that a worker finds by its name, in a module
that is made there of the same source. (By its value, as cloudpickle has it, a class would
be another one there, and one of equinox would lose its fields and fly on its defaults.)
"""

import ast
import functools
import hashlib
import importlib
import importlib.abc
import importlib.machinery
import importlib.metadata
import io
import pickle
import sys
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx


MAIN = "__main__"
SCRIPT = "jentry_script"
"""Name of the script of who asks, in a worker, which has a main module of its own"""


class Source(NamedTuple):
    """Of a module."""

    text: str
    file: str
    is_package: bool


Sources = dict[str, Source]
"""By the names of the modules"""


class Carried(NamedTuple):
    """Anything in bytes, with what it takes to have it again."""

    contents: bytes
    sources: Sources

    @property
    def digest(self) -> str:
        """Of all of it."""
        told = repr(sorted(self.sources.items())).encode()
        return hashlib.sha256(told + self.contents).hexdigest()


def dumped(tree: Any) -> Carried:
    """Bytes of anything, with the source of all that is not installed.

    **Raises:** `ValueError` for a class that nobody else can find.
    """
    file = io.BytesIO()
    pickler = _pickler()(file)
    pickler.dump(tree)
    return Carried(file.getvalue(), _sources_of(pickler.homes))


def loaded(carried: Carried) -> Any:
    """What has been `dumped`, here or elsewhere."""
    return pickle.loads(carried.contents)


@functools.cache
def _pickler() -> Any:
    import cloudpickle

    class Pickler(cloudpickle.Pickler):
        """Knows what is not installed by its name, and in which modules that is."""

        def __init__(self, file: io.BytesIO):
            super().__init__(file)
            self.homes: set[str] = set()

        def reducer_override(self, obj: Any) -> Any:
            if isinstance(obj, types.ModuleType):
                self._note(obj.__name__)
            elif isinstance(obj, type | types.FunctionType):
                home, name = obj.__module__ or "", obj.__qualname__
                self._note(home)
                found = _named(home, name) is obj
                if found and (home == SCRIPT or home in self.homes and home == MAIN):
                    return _found_in_script, (name,)
                if isinstance(obj, type) and issubclass(obj, eqx.Module):
                    _refuse_hidden(obj, found and home != MAIN)
            return super().reducer_override(obj)

        def _note(self, home: str) -> None:
            if _is_own(home):
                self.homes.add(home)

    return Pickler


def _refuse_hidden(kind: type, found: bool) -> None:
    if not found:
        raise ValueError(
            f"the class {kind.__qualname__} is defined at a prompt, in a notebook or in "
            "a function, where no other process finds it: write it into a file"
        )


def _named(home: str, name: str) -> Any:
    """What a module that is imported has by a name; nothing where it has none."""
    found: Any = sys.modules.get(home)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found


def _found_in_script(name: str) -> Any:
    """What the script of who asks defines: there, or here as it comes back."""
    home = MAIN
    if SCRIPT in _SENT:
        home = importlib.import_module(SCRIPT).__name__
    return _named(home, name)


def _is_own(name: str) -> bool:
    """Whether a module that is imported is no part of Python, a package or jentry."""
    module = sys.modules.get(name)
    file = getattr(module, "__file__", None)
    if not isinstance(file, str) or not file.endswith(".py") or name in _SENT:
        return False
    return name.split(".")[0] not in _installed()


@functools.cache
def _installed() -> frozenset[str]:
    packages = importlib.metadata.packages_distributions()
    ours = __name__.split(".")[0], "__mp_main__"
    return frozenset({*sys.stdlib_module_names, *packages, *ours})


def _sources_of(homes: set[str]) -> Sources:
    """Of modules, of the packages that they are in, and of all that they import."""
    found: Sources = {}
    todo = [name for name in homes if name not in _SENT]
    while todo:
        name = todo.pop()
        sent = SCRIPT if name == MAIN else name
        if sent in found or not _is_own(name):
            continue
        found[sent] = source = _source(name)
        package = getattr(sys.modules[name], "__package__", None) or ""
        parents = name.rpartition(".")[0]
        todo += [*([parents] if parents else []), *_imported(source.text, package)]
    return dict(sorted(found.items()))


def _source(name: str) -> Source:
    module = sys.modules[name]
    file = str(module.__file__)
    return Source(
        Path(file).read_text(encoding="utf-8"), file, hasattr(module, "__path__")
    )


@functools.lru_cache(maxsize=256)
def _imported(text: str, package: str) -> tuple[str, ...]:
    """Names of all that a source may import, at its top or in a function."""
    return tuple(_names_imported(ast.parse(text), package))


def _names_imported(tree: ast.AST, package: str) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module.split(".") if node.module else []
            if node.level:
                above = package.split(".")
                base = [*above[: len(above) - node.level + 1], *base]
            yield ".".join(base)
            yield from (".".join([*base, alias.name]) for alias in node.names)


_SENT: Sources = {}
"""What this process has been sent, and imports before all else"""


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    """Imports what has been sent."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        if fullname not in _SENT:
            return None
        spec = importlib.machinery.ModuleSpec(
            fullname,
            self,
            origin=_SENT[fullname].file,
            is_package=_SENT[fullname].is_package,
        )
        spec.has_location = True  # which gives the module its `__file__`
        return spec

    def get_source(self, fullname: str) -> str:
        return _SENT[fullname].text

    def get_code(self, fullname: str) -> types.CodeType:
        source = _SENT[fullname]
        return compile(source.text, source.file, "exec", dont_inherit=True)


_FINDER = _Finder()


def receive(sources: Mapping[str, Source]) -> bool:
    """Have this process import these modules; whether others were there by their names."""
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)
    fresh = {name for name in sources if sources[name] != _SENT.get(name)}
    if not fresh:
        return False
    # Those of before may have imported what is another now.
    for name in {*_SENT, *fresh}:
        sys.modules.pop(name, None)
    _SENT.update({name: sources[name] for name in fresh})
    return True
