"""Files of overrides: dispersions as text, and what reads and writes them."""

import cheap

from jentry._files import write_toml
from jentry.cli.overrides import in_si, read_overrides
from jentry.tuning.saving import with_unit


def read(*given, scenario=None):
    """In SI, of a scenario."""
    return in_si(read_overrides(*given), scenario or cheap.scenario())


DISPERSIONS = """
[dispersions.density]
address = "planet.density_scale"
distribution = "uniform"
lower = 0.7
upper = "130 %"

[dispersions.coefficients]
address = ["vehicle.lift_scale", "vehicle.drag_scale"]
distribution = "truncated_normal"
mean = 1
standard_deviation = 0.1
lower = 0.8
upper = 1.2
apply = "multiply"

[dispersions.path]
address = "initial_state.flight_path_angle"
distribution = "normal"
mean = 0
standard_deviation = "0.1 deg"
apply = "add"
"""


def uniform(**changes):
    entries = {"address": '"a"', "distribution": '"uniform"', "lower": 0, "upper": 1}
    lines = [f"{k} = {v}" for k, v in (entries | changes).items() if v is not None]
    return "\n".join(["[dispersions.x]", *lines])


def write_overrides(path, comment, variant, values, dispersions):
    """As `Tuned.save` does, of numbers without a unit."""
    set_to = {address: with_unit(value, "1") for address, value in values.items()}
    contents = {"law": variant, "set": set_to, "dispersions": dispersions}
    if isinstance(dispersions, str):
        contents = {"dispersions": contents.pop("dispersions"), **contents}
    write_toml(path, comment, contents)


# Distributions of a file that have lists, and correlations.

MORE = """
[dispersions.density]
address = "planet.density_scale"
distribution = "lognormal"
median = 1.0
deviation_of_logarithm = 0.2

[dispersions.path]
address = "initial_state.flight_path_angle"
distribution = "discrete"
values = ["-14.5 deg", "-14 deg"]
probabilities = [0.25, 0.75]

[dispersions.velocity]
address = "initial_state.velocity"
distribution = "discrete"
values = ["6.7 km/s", 6750]

[dispersions.lift]
address = "vehicle.lift_scale"
distribution = "normal"
mean = 1.0
standard_deviation = 0.1

[dispersions.drag]
address = "vehicle.drag_scale"
distribution = "normal"
mean = 1.0
standard_deviation = 0.05
correlation = { lift = 0.8, mass = -0.2 }

[dispersions.mass]
address = "vehicle.mass"
distribution = "normal"
mean = 950
standard_deviation = 10
"""
