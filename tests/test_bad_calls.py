"""A wrong call from Python raises an error that names what is wrong."""

import dataclasses
import math

import cheap
import equinox as eqx
import jax
import numpy as np
import pytest
from bad_commands import COMMANDS

import jentry
from jentry.campaign.campaign import as_key
from jentry.campaign.dispersions import key_of
from jentry.flight import Adaptive, FixedStep, Termination, VelocityBelow, fly
from jentry.units import parse_quantity
from jentry.world import TabulatedAtmosphere, TabulatedWind


def with_leaf(where, value):
    return eqx.tree_at(where, cheap.scenario(), jax.numpy.asarray(value, dtype=float))


def fly_with(where, value):
    return lambda: fly(with_leaf(where, value), cheap.SOLVER)


def campaign(dispersions=None, key=0, runs=2, **options):
    key = None if key is None else jax.random.key(key)
    return lambda: jentry.monte_carlo(
        cheap.scenario(), dispersions, key, runs, **options
    )


def moved(where, distribution=None, apply=jentry.campaign.add):
    distribution = distribution or jentry.Uniform(0.9, 1.1)
    return campaign({"x": jentry.Dispersion(where, distribution, apply)})


def by_mass(distribution):
    return moved(lambda s: s.vehicle.mass, distribution)


INCREASING = [0.0, 2.0, 1.0]

CALLS = {
    "mission": (lambda: jentry.find_mission("mars"), "no mission 'mars'"),
    "law": (lambda: cheap.MISSION.scenario(""), "no law ''"),
    "reading": (lambda: cheap.MISSION.dispersion_table("x"), "no dispersions 'x'"),
    "runs of two axes": (
        campaign(cheap.mass_only(), runs=np.ones((2, 2), int)),
        "runs has the shape (2, 2)",
    ),
    "numbers of a distribution": (
        by_mass(jentry.Normal(np.zeros(2), 1.0)),
        "dispersions.x.mean has the shape (2,): it must be one number",
    ),
    "workers": (lambda: jentry.setup(workers=0), "workers is 0"),
    "seed": (lambda: key_of(2**64), "the seed is 18446744073709551616"),
    "no quantity": (lambda: parse_quantity("x", "m"), "'x' is not a number"),
    "step 0": (lambda: FixedStep(0.0), "step is 0.0 s"),
    "step nan": (lambda: FixedStep(math.nan), "step is nan s"),
    "step inf": (lambda: FixedStep(math.inf), "step is inf s"),
    "short step": (lambda: fly(cheap.scenario(), FixedStep(1e-320)), "1e-320"),
    "history 0": (lambda: fly(cheap.scenario(), cheap.SOLVER, 0.0), "history is 0.0"),
    "history inf": (
        lambda: fly(cheap.scenario(), cheap.SOLVER, math.inf),
        "history is",
    ),
    "long history": (lambda: fly(cheap.scenario(), cheap.SOLVER, 1e-9), "1e-09"),
    "tolerance 0": (lambda: Adaptive(0.0), "tolerance is 0.0"),
    "tolerance nan": (lambda: Adaptive(math.nan), "tolerance is nan"),
    "no steps": (lambda: Adaptive(max_steps=0), "max_steps is 0"),
    "time limit 0": (lambda: Termination({}, 0.0), "time_limit is 0.0"),
    "time limit inf": (lambda: Termination({}, math.inf), "time_limit is inf"),
    "time limit nan": (lambda: Termination({}, math.nan), "time_limit is nan"),
    "mass 0": (fly_with(lambda s: s.vehicle.mass, 0.0), "vehicle.mass is 0 kg"),
    "mass nan": (fly_with(lambda s: s.vehicle.mass, np.nan), "vehicle.mass is nan"),
    "below ground": (fly_with(lambda s: s.initial_state.altitude, -1.0), "altitude"),
    "latitude": (fly_with(lambda s: s.initial_state.latitude, 1.6), "latitude is 1.6"),
    "path": (
        fly_with(lambda s: s.initial_state.flight_path_angle, -14.2),
        "did you mean -14.2deg",
    ),
    "heading": (fly_with(lambda s: s.initial_state.heading, 90.0), "mean 90deg"),
    "bank": (fly_with(lambda s: s.guidance.bank_angle, 50.0), "mean 50deg"),
    "nothing dispersed": (campaign(), "nothing is dispersed"),
    "no dispersions": (campaign({}), "nothing is dispersed"),
    "no key": (campaign(cheap.mass_only(), None), "need a key"),
    "a seed and a half": (lambda: as_key(1.5), "key is 1.5: give a key"),
    "both": (campaign(cheap.mass_only(), inputs={"vehicle.mass": [1.0]}), "not both"),
    "no runs": (campaign(cheap.mass_only(), runs=0), "no runs to fly"),
    "no indices": (campaign(cheap.mass_only(), runs=[]), "no runs to fly"),
    "half a run": (campaign(cheap.mass_only(), runs=np.array(1.5)), "runs is 1.5"),
    "run -1": (campaign(cheap.mass_only(), runs=[-1]), "run -1 was asked for"),
    "run 2^32": (campaign(cheap.mass_only(), runs=[2**32]), "run 4294967296"),
    "no inputs": (campaign(inputs={}), "the inputs are empty"),
    "inputs of two lengths": (
        campaign(inputs={"vehicle.mass": [1.0], "planet.density_scale": [1.0, 1.0]}),
        "unequal length",
    ),
    "input of a table": (
        campaign(inputs={"vehicle.mass": [[1.0]]}),
        "one number a run",
    ),
    "input of no leaf": (campaign(inputs={"vehicle.mas": [1.0]}), "nearest"),
    "input out of range": (
        campaign(inputs={"initial_state.latitude": [0.0, 45.0]}),
        "did you mean 45deg",
    ),
    "fewer inputs than runs": (
        campaign(inputs={"vehicle.mass": [900.0]}, runs=2),
        "run 1 was asked for, of 1 given",
    ),
    "step of a campaign": (
        campaign(cheap.mass_only(), solver=FixedStep(1e-320)),
        "1e-320",
    ),
    "history of a campaign": (campaign(cheap.mass_only(), history=-1.0), "history is"),
    "a whole module": (moved(lambda s: s.vehicle), "a whole Vehicle"),
    "no such field": (moved(lambda s: s.vehicle.mas), "dispersion 'x'"),
    "what is no leaf": (moved(lambda s: s.termination.names), "reaches no leaf"),
    "one leaf twice": (moved(lambda s: (s.vehicle.mass,) * 2), "vehicle.mass twice"),
    "two units": (
        moved(lambda s: (s.vehicle.mass, s.planet.radius)),
        "different units",
    ),
    "no effect": (moved(lambda s: s.planet.atmosphere.gas_constant), "no effect"),
    "factor on zero": (
        moved(lambda s: s.planet.rotation_rate, apply=jentry.campaign.multiply),
        "which is zero",
    ),
    "normal without width": (
        by_mass(jentry.Normal(1.0, 0.0)),
        "standard_deviation is 0",
    ),
    "bounds": (by_mass(jentry.Uniform(2.0, 1.0)), "lower is 2"),
    "far bounds": (
        by_mass(jentry.TruncatedNormal(0.0, 1.0, 40.0, 50.0)),
        "is 40 stand",
    ),
    "no campaign": (lambda: jentry.open_campaign("nowhere"), "holds no campaign"),
    "seed of a stored campaign": (
        lambda: cheap.campaign("stored", 2, seed=2**64),
        "the seed is 18446744073709551616",
    ),
    "history of a stored campaign": (
        lambda: cheap.campaign("stored", 2, history=1e-9),
        "history is 1e-09",
    ),
    "end without velocity": (
        lambda: fly(
            dataclasses.replace(
                cheap.scenario(),
                termination=Termination({"slow": VelocityBelow(0.0)}, 300.0),
            )
        ),
        "termination.conditions.slow.velocity is 0 m/s",
    ),
    "altitudes of an atmosphere": (
        lambda: TabulatedAtmosphere(INCREASING, [1.0, 1.0, 1.0]),
        "altitudes",
    ),
    "altitudes of a wind": (
        lambda: TabulatedWind(INCREASING, [0.0] * 3, [0.0] * 3),
        "altitudes",
    ),
    "altitudes put in later": (
        lambda: fly(
            eqx.tree_at(
                lambda s: s.planet.wind.altitudes,
                eqx.tree_at(
                    lambda s: s.planet.wind,
                    cheap.scenario(),
                    TabulatedWind([0.0, 1.0, 2.0], [0.0] * 3, [0.0] * 3),
                ),
                jax.numpy.asarray(INCREASING),
            )
        ),
        "planet.wind.altitudes must increase",
    ),
}


@pytest.mark.parametrize(("call", "word"), CALLS.values(), ids=CALLS)
def test_a_call_refuses(call, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, jentry.CampaignError)) as raised:
        call()
    assert word in str(raised.value)
    assert not list(tmp_path.iterdir())


def test_there_are_more_than_150():
    assert len(COMMANDS) + len(CALLS) > 250
