"""What the standard deviations and correlations of a navigation filter must be."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from .error_covariance import MOTION
from .navigation_sensors import AbstractNavigationSensor


def check_deviations(name: str, given: eqx.Module, *, positive: bool = False) -> None:
    """Refuse one that is negative, or zero where it must be positive."""
    for field in dataclasses.fields(given):
        size = _number(getattr(given, field.name))
        if size is not None and not (size > 0.0 or size == 0.0 and not positive):
            rule = "be positive" if positive else "not be negative"
            raise ValueError(
                f"{name}.{field.name} of the filter is {size:g}: it is a standard "
                f"deviation, which must {rule}"
            )


def check_assumed_noise(sensors: Mapping[str, AbstractNavigationSensor]) -> None:
    """Refuse sensors of which the filter assumes that they have no noise."""
    for name, sensor in sensors.items():
        noise, assumed = (getattr(sensor, n, None) for n in ("noise", "assumed"))
        size = _number(noise if assumed is None else assumed)
        if size is not None and not size > 0.0:
            raise ValueError(
                f"the filter assumes that the noise of sensors.{name} is {size:g}: it "
                f"must be positive; give {type(sensor).__name__}(..., assumed=...)"
            )


def check_correlations(matrix: Any) -> None:
    """Refuse correlations of the knowledge at the start that no errors have."""
    if matrix is None or isinstance(matrix, Tracer) or np.ndim(matrix) > 2:
        return
    table = np.asarray(matrix)
    if table.shape != (MOTION, MOTION):
        raise ValueError(
            f"correlations of the filter has the shape {table.shape}: it must be "
            f"{(MOTION, MOTION)}"
        )
    if not np.all(np.isfinite(table)):
        raise ValueError("correlations of the filter must be finite numbers")
    symmetric = np.allclose(np.diag(table), 1.0) and np.allclose(table, table.T)
    least = float(np.linalg.eigvalsh(0.5 * (table + table.T))[0])
    if not (symmetric and least > 0.0):
        raise ValueError(
            "correlations of the filter must be symmetric, with ones on the diagonal and "
            f"positive eigenvalues: the least is {least:.3g}"
        )


def _number(value: Any) -> float | None:
    """The number, if it is known and is one."""
    if value is None or isinstance(value, Tracer) or np.ndim(value):
        return None
    return float(value) if isinstance(value, Array | float) else None
