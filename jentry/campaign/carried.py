"""Objects in bytes for other processes, with the sources of the user's own modules.

The class of a law in a script, or in a module beside it, is found by its name. The worker
creates the module from its source. (cloudpickle would send the class by value. Then the
worker would have another class, and a class of Equinox would lose its fields and use its
defaults.)
"""

import ast
import functools
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

from .._provenance.modules import MAIN, Owner, find, owner_of, package_of
from .._provenance.parts import digest


SCRIPT = "jentry_script"
"""Name of the user's script in a worker, whose own main module is another one"""


class Source(NamedTuple):
    """Source of a module."""

    text: str
    file: str
    is_package: bool


Sources = dict[str, Source]
"""Sources by the names of their modules"""


class Carried(NamedTuple):
    """An object in bytes, with the sources that are needed to load it."""

    contents: bytes
    sources: Sources

    @property
    def digest(self) -> str:
        """Digest of contents and sources."""
        sources = repr(sorted(self.sources.items())).encode()
        return digest(sources + self.contents)


def dumped(tree: Any) -> Carried:
    """Bytes of any object, with the sources of the user's own modules.

    **Raises:** `ValueError` for a class that no other process can find.
    """
    file = io.BytesIO()
    pickler = _pickler()(file)
    pickler.dump(tree)
    return Carried(file.getvalue(), _sources_of(pickler.homes))


def loaded(carried: Carried) -> Any:
    """The object that was `dumped` by this or another process."""
    return pickle.loads(carried.contents)


@functools.cache
def _pickler() -> Any:
    import cloudpickle

    class Pickler(cloudpickle.Pickler):
        """Pickles the user's own code by name, and collects the names of its modules."""

        def __init__(self, file: io.BytesIO):
            super().__init__(file)
            self.homes: set[str] = set()

        def reducer_override(self, obj: Any) -> Any:
            if isinstance(obj, types.ModuleType):
                self._note(obj.__name__)
            elif isinstance(obj, type | types.FunctionType):
                home, name = obj.__module__ or "", obj.__qualname__
                self._note(home)
                found = find(home, name) is obj
                if found and (home == SCRIPT or home in self.homes and home == MAIN):
                    return _found_in_script, (name,)
                if isinstance(obj, type) and issubclass(obj, eqx.Module):
                    _refuse_hidden(obj, found and home != MAIN)
            return super().reducer_override(obj)

        def _note(self, home: str) -> None:
            if _is_carried(home):
                self.homes.add(home)

    return Pickler


def _refuse_hidden(kind: type, found: bool) -> None:
    if not found:
        raise ValueError(
            f"the class {kind.__qualname__} is defined at a prompt, in a notebook or in "
            "a function, where no other process finds it: write it into a file"
        )


def _found_in_script(name: str) -> Any:
    """What the user's script defines: in a worker, or in the client when it comes back."""
    home = MAIN
    if SCRIPT in _SENT:
        home = importlib.import_module(SCRIPT).__name__
    return find(home, name)


def _is_carried(name: str) -> bool:
    """Whether the source of an imported module goes along to other processes.

    A package in editable mode is the user's own, but workers import it like any other.
    """
    file = getattr(sys.modules.get(name), "__file__", None)
    if not isinstance(file, str) or not file.endswith(".py") or name in _SENT:
        return False
    return owner_of(name) is Owner.USER and package_of(name) not in _importable()


@functools.cache
def _importable() -> frozenset[str]:
    """Names of modules that a worker has without their source."""
    return frozenset({*importlib.metadata.packages_distributions(), "__mp_main__"})


def _sources_of(homes: set[str]) -> Sources:
    """Sources of modules, of their parents and of the user's modules that they import."""
    found: Sources = {}
    todo = list(homes)
    while todo:
        name = todo.pop()
        sent = SCRIPT if name == MAIN else name
        if sent in found or not _is_carried(name):
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
    """Names of all modules that a source may import, at its top or in a function."""
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
"""Sources that this process has received. They take precedence over files."""


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    """Imports modules from the sources in `_SENT`."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        if fullname not in _SENT:
            return None
        spec = importlib.machinery.ModuleSpec(
            fullname,
            self,
            origin=_SENT[fullname].file,
            is_package=_SENT[fullname].is_package,
        )
        spec.has_location = True  # so that the module has a `__file__`
        return spec

    def get_source(self, fullname: str) -> str:
        return _SENT[fullname].text

    def get_code(self, fullname: str) -> types.CodeType:
        source = _SENT[fullname]
        return compile(source.text, source.file, "exec", dont_inherit=True)


_FINDER = _Finder()


def receive(sources: Mapping[str, Source]) -> bool:
    """Make this process import these modules. Returns whether any source is new."""
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)
    fresh = {name for name in sources if sources[name] != _SENT.get(name)}
    if not fresh:
        return False
    # Earlier modules may have imported others that have changed.
    for name in {*_SENT, *fresh}:
        sys.modules.pop(name, None)
    _SENT.update({name: sources[name] for name in fresh})
    return True
