"""Samplers: draws that are spread evenly over the dispersions, Latin hypercube and Sobol.

Plain draws are independent of each other. The standard error of a mean of n of them is
their standard deviation over the square root of n. Draws that fill the space evenly have a
smaller error. How much smaller depends on the flight, see `benchmarks/sampling.py`.

A sampler assigns a share between 0 and 1 to each random number of each run. The draw is the
quantile of that share.
"""

import functools
import math
import zlib
from abc import abstractmethod
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Key

from .distributions import static_fields


_BITS = 52
"""Number of binary digits of a share. A half of the last digit is added, so that no share
is 0 or 1."""


_AT_ONCE = 2**16
"""Number of points of a sequence that are computed at a time, to reach a later one"""


class AbstractSampler(eqx.Module):
    """How the runs of a campaign are spread over the dispersions."""

    @abstractmethod
    def check(self, numbers: int, runs: int | None) -> None:
        """Refuse too many random numbers per run, or a wrong number of runs.

        **Arguments:**

        - `numbers`: how many random numbers each run takes.
        - `runs`: how many runs the campaign has, or None for single runs.
        """

    @abstractmethod
    def columns(
        self, key: Key[Array, ""], names: tuple[tuple[str, int], ...], runs: np.ndarray
    ) -> np.ndarray:
        """Shares above 0 and below 1, of shape (runs, names).

        A row depends on the key, the names and the index of its run alone.

        **Arguments:**

        - `names`: for each random number its stream and its place in the stream.
        - `runs`: indices of runs.
        """


class LatinHypercube(AbstractSampler):
    """Latin hypercube of n runs: one in each of n equally likely intervals of every number.

    Each random number is evenly spread, in an independent random order. If an effect is a
    sum over the dispersions, its mean is much more exact than with plain draws. A hypercube
    cannot be extended: another number of runs makes another campaign. The draws of a
    dispersion depend on the key, its stream and the number of runs alone. Adding another
    dispersion does not change them.

    Reference: McKay, Beckman and Conover, "A comparison of three methods for selecting
    values of input variables in the analysis of output from a computer code",
    Technometrics 21(2), 1979.
    """

    runs: int = eqx.field(static=True)
    """Number of all runs"""

    def __check_init__(self):
        if self.runs < 2:
            raise ValueError(f"runs is {self.runs}: a Latin hypercube has 2 or more")

    def check(self, numbers: int, runs: int | None) -> None:
        if runs is not None and runs != self.runs:
            raise ValueError(
                f"{runs} runs were asked for of a Latin hypercube of {self.runs}: it has "
                "a fixed number of runs and cannot be extended or cut. Give it the number "
                "that you fly, or use Sobol, which goes on"
            )

    def columns(
        self, key: Key[Array, ""], names: tuple[tuple[str, int], ...], runs: np.ndarray
    ) -> np.ndarray:
        for run in runs[runs >= self.runs][:1]:
            raise ValueError(
                f"run {run} was asked for of a Latin hypercube of {self.runs} runs, which "
                "count from 0"
            )
        return _hypercube(_words_of(key), names, self.runs)[runs]


class Sobol(AbstractSampler):
    """Points of a scrambled Sobol sequence. Any number of runs can be added later.

    The first n runs are spread most evenly if n is a power of 2. A run depends on the key,
    its index and the places of its dispersions in the table. A dispersion that is added at
    the end of the table does not change the draws of the others. A dispersion that is added
    elsewhere changes the draws of those after it.

    Direction numbers and scrambling are those of `scipy.stats.qmc.Sobol`: Joe and Kuo,
    and a random linear matrix with a digital shift. The first point is not dropped.

    Reference: Owen, "On dropping the first Sobol' point", 2020.
    """

    def check(self, numbers: int, runs: int | None) -> None:
        from scipy.stats import qmc

        if numbers > qmc.Sobol.MAXDIM:
            raise ValueError(
                f"{numbers} random numbers a run are drawn, and a Sobol sequence has "
                f"{qmc.Sobol.MAXDIM} dimensions: disperse less, or use a Latin hypercube"
            )

    def columns(
        self, key: Key[Array, ""], names: tuple[tuple[str, int], ...], runs: np.ndarray
    ) -> np.ndarray:
        # Relative to the first point, a point is linear in the bits of its index. So it is
        # computed without those before it, in constant memory.
        bits = max(int(np.max(runs, initial=0)).bit_length(), 1)
        words = _words_of(key)
        points = [_powers(words, *n, d, bits) for d, n in enumerate(names)]
        first, *steps = np.stack(points, axis=-1)
        digits = np.broadcast_to(first, (len(runs), len(names))).copy()
        for bit, step in enumerate(steps):
            digits[(runs >> bit) & 1 == 1] ^= step
        return _shares(digits)


def shares_of(
    sampler: AbstractSampler,
    key: Key[Array, ""],
    streams: Mapping[str, int],
    runs: np.ndarray,
) -> dict[str, np.ndarray]:
    """The shares of runs, by stream.

    They have the shape (runs,) for a stream of one number, and (runs, numbers) for several.
    """
    names = _names(streams)
    columns = sampler.columns(key, names, np.asarray(runs))
    shares = {}
    for stream, count in streams.items():
        ours = [place for place, (name, _) in enumerate(names) if name == stream]
        few = columns[:, ours]
        # A distribution without random numbers ignores its share.
        shares[stream] = few if count > 1 else few[:, 0] if count else _half(runs)
    return shares


def check_sampler(
    sampler: AbstractSampler, streams: Mapping[str, int], runs: int | None
) -> None:
    """Refuse a campaign that the sampler cannot draw."""
    sampler.check(len(_names(streams)), runs)


def described(sampler: AbstractSampler | None) -> dict[str, Any]:
    """Entries for the sampler in the description of a campaign; none without a sampler."""
    if sampler is None:
        return {}
    kind = {"method": type(sampler).__name__, **static_fields(sampler)}
    return {"sampler": kind | {"scipy": version("scipy")}}


def _names(streams: Mapping[str, int]) -> tuple[tuple[str, int], ...]:
    """Stream of each random number of a run, and its place in the stream."""
    return tuple((name, i) for name, count in streams.items() for i in range(count))


def _half(runs: np.ndarray) -> np.ndarray:
    return np.full(len(runs), 0.5)


def _shares(digits: np.ndarray) -> np.ndarray:
    """Integers of 52 bits as shares, each in the middle between two multiples of 2^-52."""
    return (digits.astype(float) + 0.5) * 2.0**-_BITS


def _words_of(key: Key[Array, ""]) -> tuple[int, ...]:
    """A key as integers."""
    return tuple(int(word) for word in np.ravel(jax.random.key_data(key)))


def _generator(words: tuple[int, ...], stream: str, place: int) -> np.random.Generator:
    """Generator of the random numbers at one place of a stream, seeded by its name."""
    return np.random.default_rng([*words, zlib.crc32(stream.encode()), place])


@functools.lru_cache(maxsize=2)
def _hypercube(
    words: tuple[int, ...], names: tuple[tuple[str, int], ...], runs: int
) -> np.ndarray:
    """All shares of a Latin hypercube, of shape (runs, names)."""
    shares = np.empty((runs, len(names)))
    for column, name in enumerate(names):
        generator = _generator(words, *name)
        inside = _shares(generator.integers(2**_BITS, size=runs))
        shares[:, column] = (generator.permutation(runs) + inside) / runs
    return np.minimum(shares, math.nextafter(1.0, 0.0))


@functools.lru_cache(maxsize=1024)
def _powers(
    words: tuple[int, ...], stream: str, place: int, dimension: int, bits: int
) -> np.ndarray:
    """One dimension of a scrambled sequence, in integers of 52 bits.

    They are the first point, and the differences (exclusive or) of the points 1, 2, 4, ...
    from it.
    """
    from scipy.stats import qmc  # slow to import

    generator = _generator(words, stream, place)
    sequence = qmc.Sobol(dimension + 1, bits=_BITS, rng=generator)
    points = []
    for index in (0, *(2**bit for bit in range(bits))):
        # `fast_forward` does not support so many bits.
        while (gap := index - sequence.num_generated) > 0:
            sequence.random(min(gap, _AT_ONCE))
        points.append(sequence.random()[0, -1])
    digits = (np.array(points) * 2.0**_BITS).astype(np.uint64)
    digits[1:] ^= digits[0]
    return digits
