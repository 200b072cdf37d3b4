"""Functions that the compiler keeps apart."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry._apart import apart


class Wave(eqx.Module):
    frequency: jax.Array
    name: str = "wave"

    @apart
    def at(self, x, scale=1.0):
        """Two numbers and a word."""
        value = jnp.sin(self.frequency * x)
        return {"value": scale * value, "square": value**2}, self.name


def twice(wave, x):
    """Called in a loop and behind it."""
    there = jax.lax.fori_loop(0, 3, lambda _, x: x + wave.at(x)[0]["value"], x)
    return wave.at(there, scale=2.0)[0]["value"]


def plainly(frequency, x, of=np):
    for _ in range(3):
        x = x + of.sin(frequency * x)
    return 2.0 * of.sin(frequency * x)


WAVE = Wave(jnp.asarray(0.7))
PLACES = jnp.linspace(-1.0, 2.0, 7)


def test_it_is_called_and_not_put_into_its_caller():
    text = jax.jit(jax.vmap(lambda x: twice(WAVE, x))).lower(PLACES).as_text()
    calls = [line for line in text.splitlines() if "call @at" in line]
    assert len(calls) == 2
    assert all('inlineable = "false"' in line for line in calls)
    within = jax.jit(jax.vmap(lambda x: plainly(0.7, x, jnp))).lower(PLACES).compile()
    called = jax.jit(jax.vmap(lambda x: WAVE.at(x)[0])).lower(PLACES).compile()
    assert " call(" not in within.as_text() and " call(" in called.as_text()


@pytest.mark.parametrize("transform", [lambda f: f, jax.jit])
def test_it_gives_what_the_function_gives(transform):
    for x in (-0.4, 1.3):
        found = transform(lambda x: twice(WAVE, x))(jnp.asarray(x))
        assert float(found) == pytest.approx(plainly(0.7, x), rel=1e-14)
    both, name = WAVE.at(jnp.asarray(0.3))
    assert name == "wave" and Wave.at.__doc__ == "Two numbers and a word."
    assert float(both["square"]) == pytest.approx(np.sin(0.21) ** 2, rel=1e-14)


@pytest.mark.parametrize("first", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("second", [jax.jacfwd, jax.jacrev])
def test_its_derivatives(first, second):
    """In both modes, of the second order and of many at once, as of the function."""
    if jax.jacrev in (first, second):
        flown = lambda w, x: WAVE.at(x)[0]["value"] * Wave(w).at(x)[0]["square"]
        known = lambda w, x: jnp.sin(0.7 * x) * jnp.sin(w * x) ** 2
    else:
        flown = lambda w, x: twice(Wave(w), x)
        known = lambda w, x: plainly(w, x, jnp)
    at = jnp.asarray(0.7)
    for of in (first, lambda f: second(first(f))):
        found = jax.jit(jax.vmap(of(flown), (None, 0)))(at, PLACES)
        expected = jax.vmap(of(known), (None, 0))(at, PLACES)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)
