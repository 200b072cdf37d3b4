"""A mission of a user: a law, a vehicle, a planet and what is uncertain, in one file."""

import functools

import jax.numpy as jnp

import jentry
from jentry import Controls, Measurement, Scalar, deg, km, scalar


class LiftAgainstDrag(jentry.AbstractContinuousLaw[None]):
    """Turn the lift the more upwards, the larger the drag is."""

    bank: Scalar = scalar(unit="rad")
    gain: Scalar = scalar(unit="rad s2/m")

    def init(self, measurement: Measurement) -> None:
        return None

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[Controls, None]:
        bank = jnp.clip(self.bank - self.gain * measurement.drag, 0.0, jnp.pi)
        return Controls.from_bank(bank, measurement.trim_angle_of_attack), None


def scenario() -> jentry.Scenario:
    return jentry.Scenario(
        planet=jentry.Planet(
            radius=3397 * km,
            gravity=jentry.InverseSquareGravity(4.28283e13),
            atmosphere=jentry.ExponentialAtmosphere(0.0158, 9354.5),
        ),
        vehicle=jentry.Vehicle(
            mass=992.0,
            reference_area=16.0,
            aerodynamics=jentry.ConstantAerodynamics(0.1, 0.54),
        ),
        initial_state=jentry.EntryState(
            altitude=126.1 * km,
            longitude=0.0,
            latitude=0.0,
            velocity=6750.0,
            flight_path_angle=-14.4 * deg,
            heading=90 * deg,
        ),
        guidance=LiftAgainstDrag(bank=90 * deg, gain=0.01),
        termination=jentry.Termination(
            {"velocity": jentry.VelocityBelow(velocity=503.0)}, time_limit=600.0
        ),
        target=jentry.Target(altitude=8 * km, velocity=503.0, downrange=720 * km),
    )


@functools.cache
def dispersions() -> dict[str, jentry.Dispersion]:
    density = jentry.Uniform(0.8, 1.2)
    return {"density": jentry.Dispersion(lambda s: s.planet.density_scale, density)}


MISSION = jentry.Mission(
    name="my-lander",
    title="Lander with its lift against the drag",
    laws={"nominal": scenario},
    dispersions={"density": dispersions},
    gains=("guidance",),
)
