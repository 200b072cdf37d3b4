"""Linear model of a glide over the velocity: the printed entries against derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.onboard import GlidePoint, OnboardModel, VelocityDomain
from jentry.world import (
    ConstantAerodynamics,
    ExponentialAtmosphere,
    InverseSquareGravity,
    Planet,
    Vehicle,
)


RADIUS, GRAVITY, HEIGHT = 6371e3, 9.80665, 7200.0

POINTS = {
    "fast": dict(V=0.91, r=1.0117, g=-0.0018, s=0.9, D=0.23, L=0.25, La=0.55, Da=2.1),
    "steep": dict(V=0.25, r=1.005, g=-0.09, s=1.2, D=1.3, L=1.9, La=1.8, Da=1.4),
    "climbing": dict(V=0.6, r=1.01, g=0.02, s=-0.4, D=0.6, L=0.7, La=0.4, Da=2.3),
}


@pytest.fixture(scope="module")
def domain():
    planet = Planet(
        RADIUS,
        gravity=InverseSquareGravity(GRAVITY * RADIUS**2),
        atmosphere=ExponentialAtmosphere(1.225, HEIGHT),
    )
    vehicle = Vehicle(1.0, 1.0, aerodynamics=ConstantAerodynamics(0.1, 1.0))
    return VelocityDomain(OnboardModel(planet, vehicle), HEIGHT)


def point(V, r, g, s, D, L, La, Da) -> GlidePoint:
    return GlidePoint(*(jnp.asarray(float(x)) for x in (V, r, g, s, D, L, La, Da)))


@eqx.filter_jit
def both(domain, point):
    return (
        domain.exact(point),
        domain.simplified(point),
        domain.zero_dynamics(point),
    )


@pytest.mark.parametrize("name", POINTS)
def test_the_printed_entries_are_the_derivatives(domain, name):
    """(10), (11) and (16), with L_r and D_r those of an exponential atmosphere."""
    x = POINTS[name]
    exact, _, _ = both(domain, point(**x))
    V, r, D, L = x["V"], x["r"], x["D"], x["L"]
    sg, cg, cs = np.sin(x["g"]), np.cos(x["g"]), np.cos(x["s"])
    per_height = RADIUS / HEIGHT
    Dr, Lr, Da, La = -per_height * D, -per_height * L, D * x["Da"], L * x["La"]
    q = 1.0 / (V * (D * r**2 + sg) ** 2)
    a_rr = -q * V**2 * r * sg * (2.0 * sg - Dr * r**3)
    a_rg = -q * V**2 * D * r**4 * cg
    a_gr = -q * (
        Lr * r**2 * (D * r**2 + sg) * cs
        - Dr * r**2 * (L * r**2 * cs + V**2 * r * cg - cg)
        - D * V**2 * r**2 * cg
        + 2.0 * D * r * cg
        + 2.0 * L * r * sg * cs
        + V**2 * cg * sg
    )
    a_gg = -q * ((V**2 * r - 1.0) * (-D * r**2 * sg - 1.0) - L * r**2 * cs * cg)
    b_r = q * r**4 * V**2 * sg * Da
    b_g = (
        -q
        * r**2
        * (La * cs * (D * r**2 + sg) - Da * (L * r**2 * cs + (V**2 * r - 1.0) * cg))
    )
    np.testing.assert_allclose(exact.a, [[a_rr, a_rg], [a_gr, a_gg]], rtol=1e-9)
    np.testing.assert_allclose(exact.b, [b_r, b_g], rtol=1e-9)
    np.testing.assert_allclose(exact.c, [Dr, 0.0], rtol=1e-12)
    assert float(exact.chi) == pytest.approx(Da, rel=1e-12)


def test_the_simplified_entries_are_those_of_level_flight_at_the_surface(domain):
    """There the four assumptions of the paper leave D (V^2 - 2) out, and nothing else."""
    x = POINTS["fast"] | {"r": 1.0, "g": 0.0}
    exact, simple, _ = both(domain, point(**x))
    left_out = (x["V"] ** 2 - 2.0) / (x["V"] * x["D"])
    expected = np.array(exact.a) - [[0.0, 0.0], [left_out, 0.0]]
    np.testing.assert_allclose(simple.a, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(simple.b, exact.b, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(simple.c, exact.c, rtol=1e-12)
    assert float(simple.chi) == pytest.approx(float(exact.chi), rel=1e-12)


def test_what_is_kept_of_the_path_angle_is_its_derivative(domain):
    """a_rr and b_r of (14) and (15) are of first order in sin(gamma)."""
    x = POINTS["fast"] | {"r": 1.0, "g": 0.0}

    def entries(path, simplified):
        at = eqx.tree_at(lambda p: p.flight_path_angle, point(**x), path)
        found = domain.simplified(at) if simplified else domain.exact(at)
        return jnp.stack([found.a[0, 0], found.b[0]])

    slopes = [
        jax.jacfwd(entries)(jnp.asarray(0.0), simplified)
        for simplified in (True, False)
    ]
    np.testing.assert_allclose(*slopes, rtol=1e-9)


def test_zero_dynamics_are_those_of_the_output_held_at_zero(domain):
    """x' = A x + B u under the u that keeps C x + chi u at zero."""
    x = POINTS["fast"] | {"r": 1.0, "g": 0.0}
    _, simple, (gamma1, gamma2) = both(domain, point(**x))
    a, b, c, chi = (np.array(v) for v in (simple.a, simple.b, simple.c, simple.chi))
    held = a - np.outer(b, c) / chi
    assert np.trace(held) == pytest.approx(float(gamma2), rel=1e-9)
    assert -np.linalg.det(held) == pytest.approx(float(gamma1), rel=1e-9)
