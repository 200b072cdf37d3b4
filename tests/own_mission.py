"""A mission of a user's own: its law is in another file, its attitude lags."""

import functools

from own_law import GlideAndTurn

import jentry
from jentry import deg, km


def lagging() -> jentry.SecondOrderAttitude:
    angle = jentry.Response(
        frequency=1.0,
        damping=0.9,
        rate_limit=5.0 * deg,
        acceleration_limit=2.0 * deg,
        lower=0.0,
        upper=40.0 * deg,
    )
    bank = jentry.Response(
        frequency=0.8,
        damping=0.9,
        rate_limit=10.0 * deg,
        acceleration_limit=5.0 * deg,
        lower=-80.0 * deg,
        upper=80.0 * deg,
    )
    return jentry.SecondOrderAttitude(angle, bank)


@functools.cache
def scenario() -> jentry.Scenario:
    return jentry.Scenario(
        planet=jentry.Planet(
            radius=6371.0 * km,
            gravity=jentry.InverseSquareGravity(3.986e14),
            atmosphere=jentry.ExponentialAtmosphere(1.225, 7200.0),
        ),
        vehicle=jentry.Vehicle(
            mass=900.0,
            reference_area=0.5,
            aerodynamics=jentry.PolynomialAerodynamics([0.0, 2.0], [0.03, 0.0, 2.0]),
            trim_angle_of_attack=10.0 * deg,
        ),
        initial_state=jentry.EntryState(
            altitude=50.0 * km,
            longitude=0.0,
            latitude=0.0,
            velocity=5000.0,
            flight_path_angle=-1.0 * deg,
            heading=90.0 * deg,
        ),
        guidance=GlideAndTurn(
            angle_at_rest=5.0 * deg,
            slope=2.0 * deg / 1000.0,
            heading=100.0 * deg,
            gain=5.0,
            largest_bank=60.0 * deg,
        ),
        termination=jentry.Termination(
            {
                "velocity": jentry.VelocityBelow(velocity=4700.0),
                "ground": jentry.AltitudeBelow(altitude=0.0),
            },
            time_limit=400.0,
        ),
        target=jentry.Target(altitude=45.0 * km, velocity=4700.0, downrange=600.0 * km),
        attitude=lagging(),
    )


@functools.cache
def dispersions() -> dict[str, jentry.Dispersion]:
    return {
        "density": jentry.Dispersion(
            lambda s: s.planet.density_scale, jentry.Uniform(0.9, 1.1)
        ),
        "rate": jentry.Dispersion(
            lambda s: s.attitude.bank_response.rate_limit,
            jentry.Uniform(0.5, 1.0),
            apply=jentry.multiply,
        ),
    }


MISSION = jentry.Mission(
    name="own",
    title="Glide and turn",
    laws={"lagging": scenario},
    dispersions={"all": dispersions},
    gains=("guidance.gain", "guidance.slope"),
)
