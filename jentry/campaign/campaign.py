"""Monte Carlo: many dispersed runs of one scenario, flown on all cores."""

import bisect
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from .._devices import Kind
from .._printed import in_words
from .._setup import needs_float64
from ..addresses import (
    addresses_of,
    leaves_by_address,
    replace_leaves,
    require_address,
    unit_of,
)
from ..fields import check_values
from ..flight.cycle import Plan
from ..flight.duplicate_numbers import require_both
from ..flight.flight import Flight, fly, warn_of
from ..flight.miss import Misses, believed_misses, misses, navigation_errors
from ..flight.scenario import Scenario
from ..flight.scenario_checks import checked, metadata_in, require_effect
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Outcome
from ..world.perturbed_atmosphere import without_zero_perturbations
from .batch import device_of, filled_up, flier, in_blocks, over_blocks
from .dispersions import (
    Dispersion,
    check_dispersions,
    check_runs,
    dispersed_inputs,
    inputs_of_shares,
    key_of,
    numbers_of_streams,
    warn_of_another_unit,
)
from .outputs import is_output, shown
from .populations import finite_flights
from .samplers import AbstractSampler, check_sampler, shares_of


if TYPE_CHECKING:
    import xarray


Runs = int | np.integer | Sequence[int] | np.ndarray
"""Number of runs, or indices of single runs"""


class Campaign(eqx.Module):
    """Flown runs. All arrays are of numpy and of shape (runs, ...)."""

    runs: np.ndarray
    """Indices of the runs"""
    inputs: dict[str, np.ndarray]
    """Values of the dispersed leaves, by address"""
    flights: Flight
    misses: Misses
    believed_misses: Misses | None = None
    """None with perfect navigation: see the function of this name"""
    navigation_errors: Misses | None = None
    """None with perfect navigation: see the function of this name"""
    flown_on: str = eqx.field(default="", static=True)
    """The GPU, and whether kernels or XLA flew there; empty for the processor"""

    def to_xarray(
        self, scenario: Scenario, history: float | None = None
    ) -> "xarray.Dataset":
        """The campaign as a dataset with units, as `open_campaign` returns a stored one.

        **Arguments:**

        - `scenario`: the nominal scenario of the campaign.
        - `history`: interval (s) of the histories, if the campaign has any.

        **Raises:** `ValueError` for histories without their interval.
        """
        from .results import dataset

        return dataset(scenario, self, history)

    def summary(self, scenario: Scenario) -> str:
        """Text with the outcomes, and mean, standard deviation and extremes of each output.

        It is in lines for printing and in the units of the tables. Flights that are not
        finite or have no end count in the outcomes, but not in the statistics.

            print(campaign.summary(scenario))
        """
        flights = eqx.tree_at(
            lambda f: f.history, self.flights, None, is_leaf=lambda x: x is None
        )
        ends = eqx.tree_at(lambda c: c.flights, self, flights)
        results = ends.to_xarray(scenario)
        kept = finite_flights(results)
        lines = []
        for code in np.unique(results["outcome"].values):
            count = int(np.sum(results["outcome"].values == code))
            lines.append(f"{count} of {len(self.runs)} {Outcome(int(code)).message}")
        columns = "mean", "std", "minimum", "maximum"
        names = list(filter(is_output, map(str, kept.data_vars)))
        width = max([26, *map(len, names)])
        lines.append(" " * width + "".join(f"{name:>14}" for name in columns))
        for name in names:
            values, unit = shown(kept[name])
            if values.size:
                spread = np.std(values, ddof=1) if values.size > 1 else np.nan
                numbers = values.mean(), spread, values.min(), values.max()
                cells = "".join(f"{number:14.6g}" for number in numbers)
                lines.append(f"{in_words(name):{width}}{cells} {unit}")
        return "\n".join(lines)


@needs_float64
def monte_carlo(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion] | None = None,
    key: Key[Array, ""] | int | None = None,
    runs: Runs | None = None,
    *,
    inputs: Mapping[str, Any] | None = None,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
    sampler: AbstractSampler | None = None,
) -> Campaign:
    """Fly a scenario many times, with inputs that are drawn or prescribed.

    A run depends on the key and on its index alone: it is the same to the last bit in any
    batch. (`LANES` describes an exception for laws of your own.) All CPU devices share the
    work, see `jentry.setup`.

    **Arguments:**

    - `scenario`: the nominal scenario.
    - `dispersions`: what is drawn, by name. They need a `key`.
    - `key`: key of the draws, or the number of its seed.
    - `runs`: the number of runs, or the indices of single runs. By default 1000, or all
      runs of the inputs.
    - `inputs`: values by address instead of dispersions, each of shape (runs,).
    - `solver`, `history`: as for `fly`.
    - `sampler`: spreads the draws evenly, `LatinHypercube(runs)` or `Sobol()`. By default
      the draws are independent of each other.

    On a GPU (see `jentry.setup`) each flight is one kernel, or XLA flies where a kernel
    does not know an operation of it: `Campaign.flown_on` says so.

    **Raises:** `ValueError` for an empty batch, a dispersion or an address that reaches no
    leaf, inputs of unequal length, and inputs that cannot be flown. All draws are checked
    before the first flight.

    Warns if a law has caveats (see `Flight.caveats`).

        campaign = monte_carlo(scenario, dispersions, jax.random.key(0))
        np.std(campaign.misses.downrange)
    """
    blocks = fly_in_blocks(
        scenario,
        dispersions,
        as_key(key),
        runs,
        inputs=inputs,
        solver=solver,
        history=history,
        sampler=sampler,
    )
    ordered = [block for _, block in sorted(blocks, key=lambda block: block[0])]
    campaign = jax.tree.map(lambda *parts: np.concatenate(parts), *ordered)
    warn_of(campaign.flights.caveats, campaign.flights.beyond_tables)
    return campaign


def as_key(key: Any) -> Key[Array, ""] | None:
    """The key, or that of a seed.

    **Raises:** `ValueError` for anything else.
    """
    if isinstance(key, int | np.integer):
        return key_of(int(key))
    if key is not None and not isinstance(key, jax.Array):
        raise ValueError(
            f"key is {key!r}: give a key, jax.random.key(0), or its seed, 0"
        )
    return key


def fly_in_blocks(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion] | None,
    key: Key[Array, ""] | None,
    runs: Runs | None,
    *,
    inputs: Mapping[str, Any] | None = None,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
    sampler: AbstractSampler | None = None,
    device: Kind | None = None,
) -> Iterator[tuple[int, Campaign]]:
    """Fly a campaign as `monte_carlo` does, in blocks, each with its index.

    Its memory does not grow with the number of runs. The blocks come in the order of the
    runs, or from a `Cluster` in the order of completion.
    """
    scenario = checked(scenario)
    Plan.of(scenario, solver, history)  # refuses a wrong step or interval
    given = None
    count = 1000
    if inputs is not None:
        if dispersions:
            raise ValueError("give dispersions or inputs, not both")
        if sampler is not None:
            raise ValueError("a sampler draws dispersions: give it without inputs")
        given = _check_inputs(scenario, inputs)
        count = len(next(iter(given.values())))
    elif dispersions:
        if key is None:
            raise ValueError("dispersions need a key: jax.random.key(seed)")
        check_dispersions(scenario, dispersions)
    else:
        raise ValueError("nothing is dispersed: give dispersions or inputs")
    wanted = np.asarray(count if runs is None else runs)
    if not np.issubdtype(wanted.dtype, np.integer) and wanted.size:
        raise ValueError(
            f"runs is {runs}: it must be a number of runs, or their indices"
        )
    if wanted.ndim == 0:
        check_runs(np.ravel(wanted) - 1 if wanted > 0 else np.arange(0))
    indices = np.arange(int(wanted)) if wanted.ndim == 0 else wanted.astype(int)
    if indices.size == 0:
        raise ValueError(f"no runs to fly: runs is {wanted}")
    if indices.ndim > 1:
        raise ValueError(
            f"runs has the shape {indices.shape}: list the indices of runs"
        )
    check_runs(indices)
    if dispersions and sampler is not None:
        count = int(wanted) if wanted.ndim == 0 else None
        check_sampler(sampler, numbers_of_streams(dispersions), count)
    if given is not None and indices.max() >= count:
        raise ValueError(f"run {indices.max()} was asked for, of {count} given")
    if device is None:
        device = device_of(indices.size)
    if dispersions and key is not None:
        check_draws(scenario, dispersions, key, indices, sampler, device)
    return _blocks(
        scenario, dispersions, key, indices, given, solver, history, sampler, device
    )


def _check_inputs(
    scenario: Scenario, inputs: Mapping[str, Any]
) -> dict[str, np.ndarray]:
    if not inputs:
        raise ValueError("the inputs are empty: give values by address")
    known = leaves_by_address(scenario)
    given = {}
    for address, values in inputs.items():
        require_address(known, address)
        require_effect(scenario, address)
        given[address] = np.asarray(values, dtype=float)
        if given[address].ndim != 1 or known[address].shape != ():
            raise ValueError(
                f"input {address} has shape {given[address].shape}: give one number a run"
            )
        runs = np.arange(len(given[address]))
        leaf = known[address]
        _check_runs(scenario, address, leaf, given[address], runs, "the inputs")
    require_both(scenario, given)
    lengths = {address: len(values) for address, values in given.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"inputs of unequal length: {lengths}")
    for address, values in given.items():
        if values.size:
            middle, unit = float(np.median(values)), unit_of(scenario, address)
            warn_of_another_unit("an input", address, known[address], middle, unit)
    return given


def drawn_inputs(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    runs: np.ndarray,
    sampler: AbstractSampler | None = None,
) -> dict[str, np.ndarray]:
    """Inputs of some runs by address, as `monte_carlo` draws them.

    **Raises:** `ValueError` for a draw that cannot be flown.
    """
    inputs = _drawn(scenario, dispersions, key, runs, sampler)
    moved = {
        f"dispersions.{name}": addresses_of(scenario, dispersion.where)
        for name, dispersion in dispersions.items()
    }
    known = leaves_by_address(scenario)
    for address, values in inputs.items():
        source = " and ".join(name for name in moved if address in moved[name])
        _check_runs(scenario, address, known[address], values, runs, source)
    return inputs


def _drawn(
    scenario, dispersions, key, runs: np.ndarray, sampler: AbstractSampler | None
) -> dict[str, np.ndarray]:
    """Inputs of some runs by address, drawn in whole blocks by one program."""
    filled = filled_up(runs)
    if sampler is None:
        inputs = dispersed_inputs(scenario, dispersions, key, jnp.asarray(filled))
    else:
        shares = shares_of(sampler, key, numbers_of_streams(dispersions), filled)
        shares = {stream: jnp.asarray(x) for stream, x in shares.items()}
        inputs = inputs_of_shares(scenario, tuple(dispersions.items()), shares)
    return {a: np.asarray(values)[: len(runs)] for a, values in inputs.items()}


def check_draws(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    runs: np.ndarray,
    sampler: AbstractSampler | None = None,
    device: Kind = "cpu",
) -> None:
    """Refuse runs if the draw of any of them cannot be flown, before the first flight.

    The runs are drawn in the same blocks as in flight. This takes constant memory, and
    compiles nothing that the flights do not need.
    """
    for block in in_blocks(runs, device):
        drawn_inputs(scenario, dispersions, key, block, sampler)


def _check_runs(
    scenario: Scenario,
    address: str,
    leaf: Array,
    values: np.ndarray,
    runs: np.ndarray,
    source: str,
) -> None:
    """Refuse values of a leaf, one per run, and name the first run with a wrong value."""
    metadata = metadata_in(scenario, address)
    whole = not jnp.issubdtype(leaf.dtype, jnp.inexact)

    def refused(few: np.ndarray) -> str | None:
        try:
            check_values(address, few, metadata)
        except ValueError as error:
            return str(error)
        if whole and np.any(few != np.floor(few)):
            wrong = few[few != np.floor(few)][0]
            return f"{address} is {wrong:g}: it must be a whole number"
        return None

    if refused(values) is None:
        return
    counts = range(1, len(values) + 1)
    first = bisect.bisect(counts, False, key=lambda n: refused(values[:n]) is not None)
    why = refused(values[first : first + 1])
    raise ValueError(f"{source}, run {runs[first]}: {why}")


def _blocks(
    scenario, dispersions, key, indices, given, solver, history, sampler, device
):
    if given is None:
        moved = (addresses_of(scenario, each.where) for each in dispersions.values())
        varied = itertools.chain.from_iterable(moved)
    else:
        varied = given

    def drawn():
        for place, runs in enumerate(in_blocks(indices, device)):
            if given is None:
                inputs = _drawn(scenario, dispersions, key, runs, sampler)
            else:
                inputs = {address: values[runs] for address, values in given.items()}
            yield (place, runs, inputs), inputs

    shared = without_zero_perturbations(scenario, varied), solver, history
    if device == "gpu":
        fly = flier(_fly_one, shared, large=history is not None)
        for (place, runs, inputs), found in fly.over_blocks(drawn()):
            yield place, Campaign(runs, inputs, *found, flown_on=fly.how)
        return
    flown = over_blocks(_fly_one, shared, drawn(), large=history is not None)
    for (place, runs, inputs), found in flown:
        yield place, Campaign(runs, inputs, *found)


def _fly_one(
    shared: tuple[Scenario, AbstractSolver, float | None], inputs: dict[str, Array]
) -> tuple[Flight, Misses, Misses | None, Misses | None]:
    scenario, solver, history = shared
    flight, dispersed = fly_run(scenario, inputs, solver, history)
    return flight, *errors_of(dispersed, flight)


def errors_of(
    scenario: Scenario, flight: Flight
) -> tuple[Misses, Misses | None, Misses | None]:
    """Misses of a flight, those that the vehicle believes, and errors of its navigation."""
    return (
        misses(scenario, flight),
        believed_misses(scenario, flight),
        navigation_errors(scenario, flight),
    )


def campaign_of_one(scenario: Scenario, flight: Flight) -> Campaign:
    """One flight as a campaign of one run, without inputs."""
    flown = flight, *eqx.filter_jit(errors_of)(scenario, flight)
    flown = jax.tree.map(lambda x: np.asarray(x)[None], flown)
    return Campaign(np.arange(1), {}, *flown)


def fly_run(
    scenario: Scenario,
    inputs: Mapping[str, Any],
    solver: AbstractSolver,
    history: float | None = None,
) -> tuple[Flight, Scenario]:
    """Fly one run of a campaign. Returns the flight and the dispersed scenario."""
    dispersed = replace_leaves(scenario, inputs)
    return fly(dispersed, solver, history), dispersed
