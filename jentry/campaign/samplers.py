"""Draws that are spread evenly over what is uncertain: Latin hypercube and Sobol.

Plain draws are independent of each other, and a mean of n of them is off by their standard
deviation over the square root of n. Draws that fill the space evenly leave less to chance:
how much less depends on the flight, see `benchmarks/sampling.py`.

A sampler gives each run, for each random number that it takes, a share between 0 and 1;
the draw is the quantile of that share.
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
"""Of a share: with a half more than so many, none is 0 or 1"""


_AT_ONCE = 2**16
"""Points of a sequence that are made at a time, on the way to a later one"""


class AbstractSampler(eqx.Module):
    """How the runs of a campaign are spread over what is dispersed."""

    @abstractmethod
    def check(self, numbers: int, runs: int | None) -> None:
        """Refuse more random numbers a run than it has, or another number of runs.

        **Arguments:**

        - `numbers`: how many random numbers each run takes.
        - `runs`: how many runs the campaign has; none where single runs are named.
        """

    @abstractmethod
    def columns(
        self, key: Key[Array, ""], names: tuple[tuple[str, int], ...], runs: np.ndarray
    ) -> np.ndarray:
        """Shares above 0 and below 1, of shape (runs, names).

        A row depends on the key, the names and the index of its run alone.

        **Arguments:**

        - `names`: of each random number, the stream and its place there.
        - `runs`: indices of runs.
        """


class LatinHypercube(AbstractSampler):
    """A fixed number of runs, one in each of as many equally likely parts of every number.

    Each random number by itself is evenly spread, and in another order than the others: an
    effect that is a sum over the dispersions is averaged much better than by plain draws.
    The runs belong together: more of them are another campaign. The draws of a dispersion
    depend on the key, its stream and the number of runs alone, so that adding another
    dispersion leaves them as they were.

    Reference: McKay, Beckman and Conover, "A comparison of three methods for selecting
    values of input variables in the analysis of output from a computer code",
    Technometrics 21(2), 1979.
    """

    runs: int = eqx.field(static=True)
    """How many runs there are in all"""

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
    """Points of a scrambled Sobol sequence, as many as are wanted, and more later.

    The first n runs are most evenly spread where n is a power of 2. A run depends on the
    key, its index and the places of its dispersions in the table: adding a dispersion at
    the end of the table leaves the draws of the others as they were, anywhere else those
    of the dispersions behind it are others.

    Direction numbers and scrambling are those of `scipy.stats.qmc.Sobol`: Joe and Kuo,
    and a random linear matrix with a digital shift.

    Reference: Owen, "On dropping the first Sobol' point", 2020: the first point is kept.
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
        # The points are linear, over the bits of the index, about the first one: so that
        # any can be had without those before it, in constant memory.
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
    """The shares of runs by stream, for as many random numbers as each takes.

    Of shape (runs,) for one number, and (runs, numbers) for several.
    """
    names = _names(streams)
    columns = sampler.columns(key, names, np.asarray(runs))
    shares = {}
    for stream, count in streams.items():
        ours = [place for place, (name, _) in enumerate(names) if name == stream]
        few = columns[:, ours]
        # What takes no random number is drawn as well, and does not look at it.
        shares[stream] = few if count > 1 else few[:, 0] if count else _half(runs)
    return shares


def check_sampler(
    sampler: AbstractSampler, streams: Mapping[str, int], runs: int | None
) -> None:
    """Refuse a campaign that the sampler does not have."""
    sampler.check(len(_names(streams)), runs)


def described(sampler: AbstractSampler | None) -> dict[str, Any]:
    """What the description of a campaign says of its sampler: of none, nothing."""
    if sampler is None:
        return {}
    kind = {"method": type(sampler).__name__, **static_fields(sampler)}
    return {"sampler": kind | {"scipy": version("scipy")}}


def _names(streams: Mapping[str, int]) -> tuple[tuple[str, int], ...]:
    """Of each random number of a run, the stream and its place there."""
    return tuple((name, i) for name, count in streams.items() for i in range(count))


def _half(runs: np.ndarray) -> np.ndarray:
    return np.full(len(runs), 0.5)


def _shares(digits: np.ndarray) -> np.ndarray:
    """Numbers of 52 bits as shares, each in the middle of its last digit."""
    return (digits.astype(float) + 0.5) * 2.0**-_BITS


def _words_of(key: Key[Array, ""]) -> tuple[int, ...]:
    """A key in plain numbers."""
    return tuple(int(word) for word in np.ravel(jax.random.key_data(key)))


def _generator(words: tuple[int, ...], stream: str, place: int) -> np.random.Generator:
    """The random numbers of a stream: by its name, as those of plain draws."""
    return np.random.default_rng([*words, zlib.crc32(stream.encode()), place])


@functools.lru_cache(maxsize=2)
def _hypercube(
    words: tuple[int, ...], names: tuple[tuple[str, int], ...], runs: int
) -> np.ndarray:
    """All shares of a Latin hypercube: 8 bytes for each."""
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
    """One dimension of a scrambled sequence, in digits: the first point, and by what the
    points 1, 2, 4, ... differ from it.
    """
    from scipy.stats import qmc  # takes a while

    generator = _generator(words, stream, place)
    sequence = qmc.Sobol(dimension + 1, bits=_BITS, rng=generator)
    points = []
    for index in (0, *(2**bit for bit in range(bits))):
        # `fast_forward` does not take so many bits.
        while (gap := index - sequence.num_generated) > 0:
            sequence.random(min(gap, _AT_ONCE))
        points.append(sequence.random()[0, -1])
    digits = (np.array(points) * 2.0**_BITS).astype(np.uint64)
    digits[1:] ^= digits[0]
    return digits
