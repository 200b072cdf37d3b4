"""Values that are computed once."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import jentry
from jentry._computed_once import computed_once


def test_it_is_computed_once_for_each_argument():
    seen = []

    @computed_once
    def squared(x: float) -> jax.Array:
        """As asked."""
        seen.append(x)
        return jnp.asarray(x) ** 2

    assert [float(squared(x)) for x in (2.0, 3.0, 2.0)] == [4.0, 9.0, 4.0]
    assert seen == [2.0, 3.0]
    assert (squared.__name__, squared.__doc__) == ("squared", "As asked.")


WAYS = {"once": lambda f: f, "with a derivative": jax.grad, "in a batch": jax.vmap}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_who_asks_first_may_be_traced(way):
    """The number is known after it; a plain cache would have kept one of the trace."""

    @computed_once
    def length():
        return jnp.hypot(jnp.asarray(3.0), 4.0)

    traced = jax.jit(way(lambda x: length() * x))
    assert float(jnp.sum(traced(jnp.ones(2) if way is jax.vmap else 1.0))) in (
        5.0,
        10.0,
    )
    assert float(length()) == 5.0
    assert float(jax.jit(lambda x: length() + x)(1.0)) == 6.0


def test_missions_keep_what_they_build_in_this_way_only():
    folder = Path(jentry.__file__).parent / "missions"
    texts = {path: path.read_text() for path in folder.rglob("*.py")}
    assert sum("@computed_once" in text for text in texts.values()) > 10
    plain = re.compile(r"functools\.\w*cache|from functools import")
    assert [path for path, text in texts.items() if plain.search(text)] == []
