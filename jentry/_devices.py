"""Where batches of flights fly: on the cores of the processor, or on a GPU.

Single flights, planning and draws always run on the processor. There every flight of a
batch has its own bits, whatever the batch; a GPU rounds otherwise, in the last digits.
"""

import dataclasses
import functools
import importlib.util
from typing import Any, Literal

import jax


Kind = Literal["cpu", "gpu"]

PAYS = 16_384
"""Number of runs from which a GPU flies them if the user has not chosen. A call takes a GPU
0.4 to 9 s up to some 65 000 flights, so it pays for some ten thousand flights."""

_PLUGINS = "jax_cuda12_plugin", "jax_cuda13_plugin", "jax_rocm7_plugin"
"""Packages with which JAX finds GPUs"""

_CHOSEN: Kind | None = None
"""The device that the user has chosen; None for the rule of `kind_for`"""


@dataclasses.dataclass(frozen=True)
class Gpu:
    """A GPU, and the form of the kernels that it runs: "gpu", and others for tests."""

    device: Any
    """The device of JAX"""
    form: Literal["gpu", "c", "xla"] = "gpu"

    @property
    def name(self) -> str:
        return str(self.device.device_kind)


def has_plugin() -> bool:
    """Whether a package is installed with which JAX may find a GPU."""
    return any(importlib.util.find_spec(name) is not None for name in _PLUGINS)


def cores() -> list[Any]:
    """The devices of the processor, one for each worker of `jentry.setup`."""
    return jax.devices("cpu")


@functools.cache
def gpu() -> Gpu | None:
    """The GPU that flies batches, the first; None if there is none."""
    if not has_plugin():
        return None
    try:
        return Gpu(jax.devices("gpu")[0])
    except RuntimeError:  # as JAX says that there is none, or that its driver is not
        return None


def choose(kind: str | None) -> None:
    """Choose the device of all batches; None for the rule of `kind_for`.

    **Raises:** `ValueError` for another word, and `RuntimeError` for a GPU where JAX finds
    none.
    """
    global _CHOSEN
    found: dict[str, Kind] = {"cpu": "cpu", "gpu": "gpu"}
    if kind is not None and kind not in found:
        raise ValueError(f"device is {kind!r}: it must be 'cpu' or 'gpu', or left out")
    if kind == "gpu" and gpu() is None:
        why = (
            "JAX finds no GPU here; look whether its driver runs (nvidia-smi)"
            if has_plugin()
            else "this JAX has no support for GPUs: pip install 'jentry[cuda]'"
        )
        raise RuntimeError(
            f"device is 'gpu', but {why}. Without a device given, the processor flies"
        )
    _CHOSEN = None if kind is None else found[kind]


def kind_for(runs: int) -> Kind:
    """The device that flies a number of runs: the one that the user has chosen, or else
    a GPU for `PAYS` runs and more, where there is one."""
    if _CHOSEN is not None:
        return _CHOSEN
    return "gpu" if runs >= PAYS and gpu() is not None else "cpu"
