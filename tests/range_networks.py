"""Range networks, laws and measurements that several test files share."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jentry
from jentry._computed_once import computed_once
from jentry.addresses import replace_leaves
from jentry.guidance.range_network import INPUTS, RangeNetwork, basis
from jentry.missions import find_mission
from jentry.missions.mars import predictor_corrector as mars
from jentry.onboard import Factors
from jentry.onboard.measurement import Measurement, measure
from jentry.onboard.network import Network
from jentry.world.wind import ConstantWind


ALL = [(-1e3, 1e3)] * 6 + [(0.0, 1.0)]


def summed(constant=0.0, ranges=ALL, **weights):
    """Network without hidden layers: a sum of its inputs."""
    given = [weights.pop(name, 0.0) for name in ("velocity", "number")]
    assert not weights
    row = np.zeros(7)
    row[1], row[6] = given
    return Network(
        (jnp.asarray(row)[None],),
        (jnp.zeros(1),),
        INPUTS,
        jnp.zeros(7),
        jnp.ones(7),
        jnp.asarray(ranges),
        jnp.asarray(constant),
        jnp.asarray(1.0),
    )


def linear(constant=0.0, ranges=ALL, across=None, **weights):
    """In three dimensions with a network of what leads to the side."""
    network = summed(constant, ranges, **weights)
    return RangeNetwork(network, of(in_plane().law), across)


def of(law):
    angle = law.model.vehicle.trim_angle_of_attack
    return basis(law.model, in_plane().initial_state, angle, law.end.first())


@computed_once
def in_plane():
    return find_mission("mars-range-tracking").scenario(
        "predictor-corrector", world="in-plane"
    )


@computed_once
def in_space():
    return mars.guided()


def underway(velocity=3000.0, altitude=30e3, law=None):
    """What is measured by the nominal vehicle some way down."""
    law = in_plane().law if law is None else law
    model = law.model
    state = jentry.EntryState(altitude, 0.1, 0.0, velocity, -0.1, jnp.pi / 2)
    state = jax.tree.map(jnp.asarray, state)
    angle = model.vehicle.trim_angle_of_attack
    sensed = measure(model.planet, model.vehicle, state, angle)
    return Measurement(state, sensed.lift, sensed.drag, angle, angle, {})


def asked(network, number=0.5, velocity=3000.0, factors=Factors()):
    law, seen = in_plane().law, underway(velocity)
    factors = jax.tree.map(jnp.asarray, factors)
    given = law.model, seen.state, seen.angle_of_attack, factors, jnp.asarray(number)
    return network(*given, law.end.first())


def turning(law):
    return replace_leaves(law, {"model.planet.rotation_rate": 7e-5})


def windy(law):
    return eqx.tree_at(lambda law: law.model.planet.wind, law, ConstantWind(east=10.0))


def with_network(network, **changes):
    return dataclasses.replace(in_plane().law, network=network, **changes)
