"""Distributions, each beside that of scipy."""

from scipy import stats

from jentry.campaign import Normal, TruncatedNormal, Uniform


# Each beside scipy's; it counts the bounds of a truncated normal in deviations.
DISTRIBUTIONS = {
    "normal": (Normal(3.0, 0.5), stats.norm(3.0, 0.5)),
    "uniform": (Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
    "truncated": (
        TruncatedNormal(10.0, 2.0, 8.0, 14.0),
        stats.truncnorm(-1.0, 2.0, 10.0, 2.0),
    ),
}

LOPSIDED = {
    "short of the mean": (TruncatedNormal(1.0, 0.1, 0.7, 0.95), (-3.0, -0.5)),
    "beyond the mean": (TruncatedNormal(1.0, 0.1, 1.2, 1.35), (2.0, 3.5)),
    "one-sided": (TruncatedNormal(-2.0, 3.0, -32.0, -2.0), (-10.0, 0.0)),
    "nearly uniform": (TruncatedNormal(5.0, 2.0, 4.9, 5.3), (-0.05, 0.15)),
    "all of it": (TruncatedNormal(5.0, 2.0, -45.0, 55.0), (-25.0, 25.0)),
}
"""Truncated normals, and their bounds in deviations"""

ALL_DISTRIBUTIONS = DISTRIBUTIONS | {
    name: (d, stats.truncnorm(*bounds, float(d.mean), float(d.standard_deviation)))
    for name, (d, bounds) in LOPSIDED.items()
}
