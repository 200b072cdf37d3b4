"""The source of a kernel, compiled for the processor or for a GPU."""

import ctypes
import importlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._setup import cache_directory


THREADS = 64
"""Threads of a block on a GPU: two warps. Flights of other warps wait for nobody."""


class OnProcessor:
    """A program in C that flies one run after another."""

    arrays = np
    """The package of its arrays"""

    def __init__(self, source: str, reals: np.ndarray, wholes: np.ndarray):
        compiler = shutil.which("cc")
        if compiler is None:
            raise RuntimeError("a kernel in C needs a compiler: there is no cc here")
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder) / "flights.so"
            flags = "-O1 -std=c99 -ffp-contract=off -fwrapv -shared -fPIC".split()
            subprocess.run(
                [compiler, *flags, "-x", "c", "-", "-o", library, "-lm"],
                input=source.encode(),
                check=True,
                capture_output=True,
            )
            self._flights = ctypes.CDLL(str(library)).flights
        self._tables = reals, wholes

    def taken(self, leaf: Any) -> np.ndarray:
        return np.asarray(leaf)

    def fly(self, count: int, given: np.ndarray, found: np.ndarray) -> None:
        places = (ctypes.c_void_p(x.ctypes.data) for x in (given, found, *self._tables))
        self._flights(ctypes.c_longlong(count), *places)

    def given_back(self, array: np.ndarray) -> jax.Array:
        return jnp.asarray(array)


class OnGpu:
    """A kernel in CUDA, by CuPy, which compiles it and keeps it for the next process."""

    def __init__(self, source: str, reals: np.ndarray, wholes: np.ndarray):
        os.environ.setdefault("CUPY_CACHE_DIR", str(cache_directory() / "kernels"))
        try:
            cupy = importlib.import_module("cupy")
        except ImportError:
            raise RuntimeError(
                "a kernel for a GPU needs CuPy: pip install 'jentry[cuda]'"
            ) from None
        self.arrays = cupy
        """The package of its arrays"""
        self._kernel = cupy.RawModule(code=source).get_function("flights")
        self._tables = cupy.asarray(reals), cupy.asarray(wholes)

    def taken(self, leaf: Any) -> Any:
        if isinstance(leaf, jax.Array):
            leaf = jax.block_until_ready(leaf)
            if _is_on_processor(leaf):
                leaf = np.asarray(leaf)
        return self.arrays.asarray(leaf)

    def fly(self, count: int, given: Any, found: Any) -> None:
        blocks = -(-count // THREADS)
        numbers = np.int64(count), given, found, *self._tables
        self._kernel((blocks,), (THREADS,), numbers)
        self.arrays.cuda.get_current_stream().synchronize()

    def given_back(self, array: Any) -> jax.Array:
        return jnp.from_dlpack(self.arrays.ascontiguousarray(array))


def _is_on_processor(array: jax.Array) -> bool:
    return all(device.platform == "cpu" for device in array.devices())
