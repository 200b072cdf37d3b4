"""The command line application, and the options that several commands share."""

import contextlib
import dataclasses
import enum
import importlib
import threading
from pathlib import Path
from typing import Annotated

import typer


app = typer.Typer(
    help="Guided atmospheric entry: fly missions, one by one or in Monte Carlo campaigns.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

MissionName = Annotated[
    str,
    typer.Argument(
        help="Name of a mission, see `jentry list`; or your own file that defines "
        "MISSION, such as my_mission.py."
    ),
]
Law = Annotated[
    str | None,
    typer.Option(
        help="Guidance law; the mission's own if not given. See `jentry list`."
    ),
]
Case = Annotated[
    str | None,
    typer.Option(help="Another start or target of the mission: see `jentry list`."),
]
World = Annotated[
    list[str] | None,
    typer.Option(
        help="Another planet, vehicle or sensors: see `jentry list`. May be repeated."
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="ADDRESS=VALUE",
        help="Change a number of the scenario, in SI units or with a unit: "
        "initial_state.flight_path_angle=-14.2deg. May be repeated.",
    ),
]
Config = Annotated[
    Path | None,
    typer.Option(
        exists=True,
        dir_okay=False,
        # Rich would take a bracket without the backslash for markup.
        help="TOML file with `law`, `case`, `world`, `\\[set]` and `\\[dispersions]`.",
    ),
]
Step = Annotated[
    float | None,
    typer.Option(
        help="Largest step of the solver, s; the step of the scenario if not given. A "
        "scenario without a step takes 0.1 s, or one step a cycle if the guidance cycle "
        "of its law varies."
    ),
]
Dispersions = Annotated[
    str | None,
    typer.Option(help="Name of the mission's dispersions to use: see `jentry list`."),
]


class Sampling(enum.StrEnum):
    """Method that spreads the draws of a campaign."""

    PLAIN = "plain"
    LATIN_HYPERCUBE = "latin-hypercube"
    SOBOL = "sobol"

    def of(self, runs: int):
        """Sampler of a campaign with this number of runs; None for plain draws."""
        from ..campaign.samplers import LatinHypercube, Sobol

        if self is Sampling.PLAIN:
            return None
        return Sobol() if self is Sampling.SOBOL else LatinHypercube(runs)


Sampler = Annotated[
    Sampling,
    typer.Option(
        help="How the draws are spread: independently, or evenly. A Latin hypercube has "
        "a fixed number of runs; a larger --runs extends a Sobol sequence, best to a "
        "power of 2."
    ),
]
Seed = Annotated[int, typer.Option(help="Seed of the draws.")]
History = Annotated[
    float | None,
    typer.Option(help="Interval at which the history of each flight is stored, s."),
]
Workers = Annotated[int | None, typer.Option(help="Cores to use; all if not given.")]
ClusterAt = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="WHERE",
        help="Fly on the workers of Dask. WHERE is the address of a scheduler, "
        "tcp://HOST:8786; a scheduler file, FILE.json; or local:2 for two processes of "
        "this machine.",
    ),
]


class OnDevice(enum.StrEnum):
    """Where batches of runs fly."""

    CPU = "cpu"
    GPU = "gpu"


Device = Annotated[
    OnDevice | None,
    typer.Option(
        help="Fly all batches there. If not given, a GPU flies batches of 16 384 runs and "
        "more, where there is one."
    ),
]
Addresses = Annotated[
    list[str] | None,
    typer.Option(
        metavar="ADDRESS",
        help="Addresses of leaves, or beginnings of addresses; see `jentry show`. May be "
        "repeated, or several separated by commas.",
    ),
]
Fast = Annotated[
    bool,
    typer.Option(
        help="Compile with one more XLA option, for up to a quarter more flights a "
        "second: for some ten thousand runs and more."
    ),
]


StoredFolder = Annotated[Path, typer.Argument(help="Folder of a stored campaign.")]
OwnMission = Annotated[
    str | None,
    typer.Option(
        "--mission", help="File of the mission, FILE.py, if the mission is your own."
    ),
]
Require = Annotated[
    list[str] | None,
    typer.Option(
        metavar="REQUIREMENT",
        help="What the runs must demonstrate, such as '|downrange_error| < 10 km, 99 % "
        "at 90 %': at least 99 % of the flights, with a confidence of 90 %. May be "
        "repeated. The exit code is 5 if one fails, 6 if the runs are too few to judge.",
    ),
]
RequirementsFile = Annotated[
    Path | None,
    typer.Option(
        exists=True,
        dir_okay=False,
        help="TOML file with a list of requirements, `require = \\[...]`.",
    ),
]
Percentiles = Annotated[
    str | None,
    typer.Option(
        help="Percentiles of every output, separated by commas, such as 50,99,99.87; "
        "1, 5, 50, 95 and 99 if not given."
    ),
]
Formats = Annotated[
    str,
    typer.Option(
        "--format",
        help="Format of the figures: png, pdf or svg, or several separated by commas.",
    ),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print the results as JSON, and nothing else.")
]
Quiet = Annotated[
    bool,
    typer.Option("--quiet", help="Print only errors: no table, no progress."),
]


class Over(enum.StrEnum):
    """Index: the independent variable along a flight."""

    TIME = "time"
    VELOCITY = "velocity"
    ENERGY = "energy"
    ALTITUDE = "altitude"
    DOWNRANGE = "downrange"


_MOST_WORKERS = 1024
"""Each worker takes memory before it computes anything."""


def set_up(
    workers: int | None = None, fast: bool = False, device: OnDevice | None = None
) -> None:
    from .._setup import setup

    if workers is not None and workers > _MOST_WORKERS:
        raise ValueError(f"workers is {workers}: it must be {_MOST_WORKERS} at most")
    setup(workers, fast=fast, device=None if device is None else device.value)


def flying_at(cluster: str | None):
    """Context in which a cluster flies the batches, or this process if it is None."""
    if cluster is None:
        return contextlib.nullcontext()
    from ..campaign.cluster import Cluster

    return Cluster(cluster)


def import_meanwhile(*modules: str) -> None:
    """Import modules in a thread while XLA compiles, which leaves Python idle."""

    def import_all():
        for module in modules:
            importlib.import_module(module)

    threading.Thread(target=import_all, daemon=True).start()


def chosen_scenario(name, choice, config, assignments, *, law_flies=True):
    """Mission, its scenario with all overrides, and the overrides in SI.

    `choice` has the law, case and worlds of the command line. What it leaves open comes
    from the configuration, or else from the mission. The overrides have the complete
    choice.

    **Raises:** `ValueError` for a target that is set and that the law does not read, if
    `law_flies` and no splines replace the law.
    """
    from ..flight.duplicate_numbers import require_both
    from ..flight.effect import require_felt
    from ..flight.scenario_checks import check
    from ..missions import find_mission
    from ..missions.choice import Choice
    from .free_controls_table import with_free_controls
    from .overrides import apply_values, in_si, read_overrides

    chosen = find_mission(name)
    overrides = read_overrides(config, assignments or ())
    choice = chosen.complete(Choice.given(*choice).over(overrides.choice))
    overrides = dataclasses.replace(overrides, choice=choice)
    scenario = chosen.scenario_of(choice)
    if overrides.free_controls is not None:
        scenario = with_free_controls(scenario, overrides)
    overrides = in_si(overrides, scenario)
    before, scenario = scenario, apply_values(scenario, overrides.values)
    check(scenario)
    require_both(before, overrides.values)
    targets = [a for a in overrides.values if a.startswith("target.")]
    if targets and law_flies and overrides.free_controls is None:
        require_felt(scenario, targets)
    return chosen, scenario, overrides


def note_step(scenario, solver, history):
    """Print the step that is flown if it differs from the step that was requested."""
    from ..flight.cycle import Plan

    asked = solver.step
    flown = Plan.of(scenario, solver, history).step
    if asked is not None and abs(flown - asked) > 1e-9 * asked:
        typer.echo(
            f"step: {flown:.6g} s is flown in place of {asked:.6g} s, so that whole steps "
            "fill each guidance cycle and each interval of the history"
        )


def dispersion_table(mission, overrides, base):
    """Name of the mission's dispersions, and their table with the configuration's changes.

    **Raises:** `ValueError` for a name beside a configuration that replaces them all.
    """
    if overrides.replaces and base is not None:
        raise ValueError(
            "dispersions are given by --dispersions and by --config, whose replace = true "
            "leaves out the dispersions of the mission: give one of them"
        )
    from .stated_correlations import correlated

    base = first_given(base, overrides.base, *mission.dispersions, "")
    table = {
        **dispersions_before(mission, overrides, base),
        **(overrides.dispersions or {}),
    }
    return base, correlated(table, overrides.correlations)


def dispersions_before(mission, overrides, base):
    """Dispersions of the mission that the configuration changes or adds to."""
    none = not mission.dispersions and not base and overrides.dispersions is not None
    if overrides.replaces or none:
        return {}
    return mission.dispersion_table(base)


def refuse_set_in_vain(scenario, overrides, table) -> None:
    """Refuse to set a number that a dispersion replaces in every run."""
    from ..addresses import addresses_of
    from ..campaign.dispersions import replace

    for name, dispersion in table.items():
        if dispersion.apply is not replace:
            continue
        for address in addresses_of(scenario, dispersion.where):
            if address in overrides.values:
                raise ValueError(
                    f"{address} is set, but every run draws it from the dispersion "
                    f"{name!r}: leave out one of them, or change the dispersion in --config"
                )


def folder_of_results(out: Path | None, name: str) -> Path:
    """Folder for the results: `out`, or one of this name in `results`."""
    return Path("results") / name if out is None else out


def index_over(over: str, scenario):
    """Index of a name. Downrange counts from the origin of the scenario's target."""
    from ..motion.index import index_named

    return index_named(over, scenario.target.origin or scenario.initial_state)


def first_given(*options: str | None) -> str:
    """The first option that is not None. An empty name counts as given."""
    return next(option for option in options if option is not None)


def expanded(scenario, given, defaults) -> list[str]:
    """Addresses of leaves, of which some are given by the beginning of their addresses.

    A beginning stands for all leaves below it that have an effect. Defaults that the
    scenario does not have are left out.

    **Raises:** `ValueError` for another address that the scenario does not have.
    """
    from ..addresses import leaves_by_address, require_address
    from ..flight.scenario_checks import without_effect

    known = leaves_by_address(scenario)
    idle = without_effect(scenario)

    def below(beginning: str) -> list[str]:
        if beginning in known:
            return [beginning]
        inside = (a for a in known if a.startswith(f"{beginning}."))
        return [address for address in inside if address not in idle]

    found = [address for default in defaults for address in below(default)]
    for name in (name.strip() for option in given for name in option.split(",")):
        addresses = below(name)
        if not addresses:
            require_address(known, name)
        found += [address for address in addresses if address not in found]
    if not found:
        raise ValueError(
            "this law has no gains that are tuned by default: give --gains"
        )
    return found
