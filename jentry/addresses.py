"""Dotted addresses of the leaves of a pytree: `planet.density_scale`.

Python code selects a parameter by a lens, `lambda s: s.planet.density_scale`. The command
line, configuration files and result files select it by the address of that leaf.
"""

import dataclasses
import difflib
import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import PyTree


Tree = TypeVar("Tree")


def _step(key: Any) -> str:
    match key:
        case jtu.GetAttrKey(name=name):
            return name
        case jtu.DictKey(key=name):
            return str(name)
        case jtu.SequenceKey(idx=index):
            return str(index)
    return str(key)


def address_of(path: tuple) -> str:
    """The address of a node from its path in `jax.tree_util`."""
    return ".".join(_step(key) for key in path)


@functools.lru_cache(maxsize=64)
def _addresses(structure: Any) -> tuple[str, ...]:
    """Addresses of all leaves of pytrees of a structure, in their order."""
    numbered = jtu.tree_unflatten(structure, range(structure.num_leaves))
    paths, _ = jtu.tree_flatten_with_path(numbered)
    return tuple(address_of(path) for path, _ in paths)


@functools.lru_cache(maxsize=64)
def _named(structure: Any, arrays: tuple[bool, ...]) -> PyTree:
    """A pytree of a structure whose arrays are replaced by their addresses, and its other
    leaves by None."""
    named = zip(_addresses(structure), arrays, strict=True)
    return jtu.tree_unflatten(structure, [a if known else None for a, known in named])


def leaves_by_address(tree: PyTree) -> dict[str, Any]:
    """Every array leaf with its address, in the order of the tree."""
    leaves, structure = jtu.tree_flatten(tree)
    named = zip(_addresses(structure), leaves, strict=True)
    return {address: leaf for address, leaf in named if eqx.is_array(leaf)}


def modules_by_address(tree: PyTree) -> dict[str, eqx.Module]:
    """All modules in a pytree, a module before those inside it; the tree itself has no
    name."""
    found: dict[str, eqx.Module] = {}

    def look(node: Any, path: tuple) -> None:
        if isinstance(node, eqx.Module):
            found[address_of(path)] = node
        parts, _ = jax.tree_util.tree_flatten_with_path(node, lambda x: x is not node)
        for step, part in parts:
            if step:
                look(part, (*path, *step))

    look(tree, ())
    return found


def addresses_of(tree: PyTree, where: Callable[[Any], Any]) -> list[str]:
    """Addresses of the leaves that a lens selects.

    Raises `ValueError` if it selects none.
    """
    leaves, structure = jtu.tree_flatten(tree)
    arrays = tuple(eqx.is_array(leaf) for leaf in leaves)
    named = where(_named(structure, arrays))
    found = jax.tree.leaves(named)
    known = _addresses(structure)
    if not found or any(name not in known for name in found):
        raise ValueError(
            "a lens reaches no leaf: it must return a number of the scenario, such as "
            f"lambda s: s.planet.density_scale, and returned {named!r}"
        )
    return found


def nearest(name: str, known: Iterable[str]) -> str:
    """Text with the existing names that are most similar to a wrong name."""
    known = list(known)
    close = [k for k in known if name and k.startswith(name)]
    alike = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    close += [k for k in alike if k not in close]
    last = name.rsplit(".", 1)[-1]
    close += [k for k in known if k.rsplit(".", 1)[-1] == last and k not in close]
    if not close:
        close = sorted(known)
    return "nearest: " + ", ".join(close[:3])


def require_address(known: Iterable[str], address: str) -> None:
    """Refuse an address that is not in the tree, and name the most similar ones."""
    known = list(known)
    if address not in known:
        raise ValueError(
            f"no leaf {address!r} in this scenario; {nearest(address, known)}"
        )


def replace_leaves(tree: Tree, values: Mapping[str, Any]) -> Tree:
    """Copy of the tree with the leaves at some addresses replaced.

    It works under `jit`, `vmap` and `grad`. Raises `ValueError` for an address that does
    not exist, and for a value whose shape is not that of the leaf.
    """
    paths, structure = jtu.tree_flatten_with_path(tree)
    known = leaves_by_address(tree)
    for address in values:
        require_address(known, address)
    leaves = []
    for path, leaf in paths:
        address = address_of(path)
        if eqx.is_array(leaf) and address in values:
            value = jnp.asarray(values[address], dtype=leaf.dtype)
            if value.shape != leaf.shape:
                raise ValueError(
                    f"{address} has shape {leaf.shape} and was given a value of shape "
                    f"{value.shape}"
                )
            leaves.append(value)
        else:
            leaves.append(leaf)
    return jtu.tree_unflatten(structure, leaves)


def field_metadata(tree: PyTree, address: str) -> Mapping[str, Any]:
    """Metadata of the field at an address, such as its unit and its allowed range."""
    node = tree
    metadata: Mapping[str, Any] = {}
    for step in address.split("."):
        if dataclasses.is_dataclass(node):
            fields = {f.name: f for f in dataclasses.fields(node)}
            metadata = fields[step].metadata
            node = getattr(node, step)
        elif isinstance(node, Mapping):
            node = node[step]
        else:
            node = node[int(step)]
    return metadata


def unit_of(tree: PyTree, address: str) -> str:
    """Unit of the leaf at an address; "1" for a plain number."""
    return field_metadata(tree, address).get("unit", "1")


def with_leaves(tree: Tree) -> Tree:
    """The tree with Python numbers in fields of `scalar()` replaced by arrays.

    For JAX a Python number is a part of the program: the program is compiled again for each
    value, and the number has no gradient and no address. `eqx.tree_at` may put such numbers
    into fields of `scalar()`. Raises `ValueError` for a Python number in any other field.
    """
    paths, structure = jtu.tree_flatten_with_path(tree)
    if not any(isinstance(leaf, int | float | complex) for _, leaf in paths):
        return tree
    leaves = [_as_leaf(tree, address_of(path), leaf) for path, leaf in paths]
    return jtu.tree_unflatten(structure, leaves)


def _as_leaf(tree: PyTree, address: str, leaf: Any) -> Any:
    number = isinstance(leaf, int | float | complex) and not isinstance(leaf, bool)
    if not number or eqx.is_array(leaf):
        return leaf
    if "unit" in field_metadata(tree, address):
        return jnp.asarray(leaf, dtype=float)
    name = address.rsplit(".", 1)[-1]
    raise ValueError(
        f"{address} is the Python number {leaf!r}, which has no gradient and cannot be "
        "dispersed, and is compiled again for each value: declare its field as a number, "
        f"`{name}: Scalar = jentry.scalar()`, or, if it is a count or a setting, as "
        "`eqx.field(static=True)`"
    )
