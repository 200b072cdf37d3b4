"""`jentry tune`: tune gains, or any numbers, by gradients through a Monte Carlo."""

import math
import shlex
from pathlib import Path
from typing import Annotated

import typer

from .ending import rounding_off
from .options import (
    Addresses,
    Case,
    ClusterAt,
    Config,
    Device,
    Dispersions,
    Fast,
    Law,
    MissionName,
    Seed,
    Set,
    Step,
    Workers,
    World,
    app,
    chosen_scenario,
    dispersion_table,
    expanded,
    first_given,
    flying_at,
    folder_of_results,
    refuse_set_in_vain,
    set_up,
)


@app.command("tune")
def command(
    mission: MissionName,
    gains: Addresses = None,
    runs: Annotated[int, typer.Option(help="Draws to tune on.")] = 256,
    steps: Annotated[int, typer.Option(help="Points to try, at most.")] = 40,
    loss: Annotated[
        str,
        typer.Option(
            help="mean-square; power-mean, the root of the mean fourth power; cvar, the "
            "mean of the worst twentieth; worst-case; or outside, the share of flights "
            "that miss by more than 1 (see --of)."
        ),
    ] = "mean-square",
    of: Annotated[
        list[str] | None,
        typer.Option(
            metavar="QUANTITY=SCALE",
            help="Quantity in the loss, a miss or the peak of a path constraint, and how "
            "much of it counts as 1, such as altitude=500m. May be repeated. If not given: "
            "those of the mission, or else downrange=1km, and crossrange=1km in three "
            "dimensions.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            help="Folder for tuned.toml, course.csv and the record that the same "
            "command resumes from; results/MISSION-tuned if not given.",
        ),
    ] = None,
    optimizer: Annotated[
        str | None,
        typer.Option(
            help="lbfgs or adam. If not given: adam with --fresh-draws, otherwise lbfgs."
        ),
    ] = None,
    learning_rate: Annotated[
        float,
        typer.Option(
            help="Learning rate of adam; 0.1 moves a gain by a tenth in a step."
        ),
    ] = 0.1,
    bounds: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS=LOW:HIGH", help="Keep a leaf between two values."
        ),
    ] = None,
    scale: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS=VALUE",
            help="How much of a leaf is a large change. Needed for a leaf that is 0, whose "
            "value gives no scale.",
        ),
    ] = None,
    differences: Annotated[
        float | None,
        typer.Option(
            help="Take the gradient by central differences of the loss with this step "
            "(0.02 is 2 % of a gain) and unchanged draws, in place of exact derivatives. "
            "For flights that jump, as by a bank reversal."
        ),
    ] = None,
    smooth: Annotated[
        bool,
        typer.Option(
            help="Follow the gradient of the law with smooth switches. The result is still "
            "judged with the exact law."
        ),
    ] = False,
    smooth_reversals: Annotated[
        bool,
        typer.Option(
            help="Follow the gradient of the law with smooth bank reversals; other "
            "switches stay sharp."
        ),
    ] = False,
    fresh_draws: Annotated[
        bool, typer.Option(help="New draws for each gradient; needs adam.")
    ] = False,
    least_damping: Annotated[
        float | None,
        typer.Option(
            help="Penalize modes of the closed loop with a smaller damping ratio, frozen "
            "along the nominal flight."
        ),
    ] = None,
    faster_than: Annotated[
        float | None,
        typer.Option(
            help="Least magnitude of eigenvalues whose damping counts, rad/s; that of the "
            "mission if not given."
        ),
    ] = None,
    patience: Annotated[
        int, typer.Option(help="Stop after this number of steps without progress.")
    ] = 20,
    held_out: Annotated[int, typer.Option(help="Further draws to judge by.")] = 5000,
    seed: Seed = 0,
    workers: Workers = None,
    device: Device = None,
    cluster: ClusterAt = None,
    law: Law = None,
    case: Case = None,
    world: World = None,
    dispersions: Dispersions = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
    fast: Fast = False,
) -> None:
    """Tune gains, or any numbers, by gradients through a Monte Carlo."""
    set_up(workers, fast, device)
    import optax
    import optimistix

    from ..campaign.dispersions import key_of
    from ..flight.solver import FixedStep
    from ..plots import save_figures
    from ..plots.convergence import draw_course
    from ..tuning import (
        AutomaticDifferentiation,
        Budget,
        CentralDifferences,
        Draws,
        Record,
        smoothing,
    )
    from ..tuning.losses import BY_NAME
    from ..tuning.tuning import tune
    from .dispersions_report import print_what_is_flown
    from .overrides import AtAddresses
    from .tuning_options import (
        damping_penalty,
        outputs_for,
        parse_ranges,
        parse_scales,
    )
    from .tuning_report import print_damping, print_tuned, report_step, write_course

    chosen, scenario, overrides = chosen_scenario(
        mission, (law, case, world), config, set_
    )
    base, table = dispersion_table(chosen, overrides, dispersions)
    refuse_set_in_vain(scenario, overrides, table)
    if loss not in BY_NAME:
        raise ValueError(f"loss is {loss!r}: choose from {', '.join(BY_NAME)}")
    if smooth and smooth_reversals:
        raise ValueError("give --smooth or --smooth-reversals, not both")
    followed = smoothing.smooth_switching if smooth else None
    followed = smoothing.smooth_reversals if smooth_reversals else followed
    wanted = first_given(optimizer, "adam" if fresh_draws else "lbfgs")
    if not 0.0 < learning_rate < math.inf:
        raise ValueError(f"--learning-rate is {learning_rate}: it must be positive")
    methods = {
        "lbfgs": optimistix.LBFGS(rtol=1e-6, atol=1e-6),
        "adam": optax.adam(learning_rate),
    }
    if wanted not in methods:
        raise ValueError(f"optimizer is {wanted!r}: choose from {', '.join(methods)}")
    default = [] if gains else list(chosen.gains)
    addresses = expanded(scenario, gains or (), default)
    folder = folder_of_results(out, f"{chosen.name}-tuned")
    gradient = AutomaticDifferentiation(surrogate=followed)
    if differences is not None:
        gradient = CentralDifferences(differences, followed)
    scaled = parse_scales(of or chosen.tuned_for, scenario)
    solver = FixedStep(step)
    modes = chosen.modes_faster_than if faster_than is None else faster_than
    penalty = damping_penalty(scenario, solver, least_damping, modes)
    labels = {
        "loss": loss,
        "optimizer": wanted,
        "learning_rate": learning_rate,
        **{f"code of {file}": is_ for file, is_ in chosen.code.items()},
    }
    with rounding_off("the same command resumes") as look, flying_at(cluster):

        def report(course: list, best: int) -> None:
            report_step(course, best)
            look()

        tuned = tune(
            scenario,
            AtAddresses(tuple(addresses)),
            BY_NAME[loss](scaled),
            methods[wanted],
            Draws(table, key_of(seed), runs, held_out, fresh_draws),
            ranges=parse_ranges(bounds or (), scale or (), scenario),
            outputs=outputs_for(scaled, scenario),
            solver=solver,
            gradient=gradient,
            penalty=penalty,
            budget=Budget(steps, patience),
            record=Record(folder / "tuning.npz", labels, report),
        )
    print_what_is_flown(chosen, scenario, overrides, base, table)
    print_tuned(chosen, scenario, tuned)
    write_course(folder / "course.csv", tuned)
    save_figures({"course": draw_course(tuned, chosen.title)}, folder)
    stepped = "" if step is None else f", --step {step:g}"
    tuned.save(
        folder / "tuned.toml",
        **overrides.choice.labels,
        dispersions=overrides.written_with(base),
        values=overrides.values,
        comment=f"{chosen.name} tuned by jentry: {loss} over {runs} draws of seed {seed},"
        f"\n{wanted}, {len(tuned.course)} steps{stepped}. Fly it:\n"
        f"jentry monte-carlo {shlex.quote(mission)} --config FILE",
    )
    typer.echo(f"tuned scenario: {folder / 'tuned.toml'}")
    if modes is not None:
        print_damping(modes, scenario, tuned, solver)
