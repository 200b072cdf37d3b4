"""Settings and fixtures that every test shares."""

import equinox as eqx
import jax
import pytest


jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture
def key():
    return jax.random.key(20261121)


@pytest.fixture(scope="session")
def planned():
    """The planned Mars reference: bank profile, flight, and drag over energy and time."""
    from helpers import mars_scenario

    from jentry.design.planning import (
        ReferenceFlight,
        open_loop,
        plan_bank_profile,
        plan_drag_reference,
    )
    from jentry.onboard import EnergyIndex, TimeIndex

    @eqx.filter_jit
    def plan(scenario):
        profile = plan_bank_profile(scenario, 503.0)
        flight = ReferenceFlight.of(open_loop(scenario, profile, 300.0))
        references = {
            "energy": plan_drag_reference(flight, EnergyIndex()),
            "time": plan_drag_reference(flight, TimeIndex()),
        }
        return profile, flight, references

    return plan(mars_scenario())


@pytest.fixture(scope="session")
def reference(planned):
    """The planned drag over energy."""
    return planned[2]["energy"]
