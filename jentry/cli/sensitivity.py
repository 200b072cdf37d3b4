"""`jentry sensitivity`: derivatives of the misses, and the predicted spread of misses."""

import math
from typing import Annotated

import typer

from .options import (
    Addresses,
    Case,
    Config,
    Device,
    Dispersions,
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
    set_up,
)


@app.command("sensitivity")
def command(
    mission: MissionName,
    wrt: Addresses = None,
    scale: Annotated[
        list[float] | None,
        typer.Option(
            help="Factor on the width of the dispersions. May be repeated; 0.1 and 1 if "
            "not given."
        ),
    ] = None,
    runs: Annotated[
        int,
        typer.Option(
            help="Monte Carlo runs to compare the prediction with; 0 for none."
        ),
    ] = 1000,
    differences: Annotated[
        bool,
        typer.Option(
            help="Predict from mean differences over two standard deviations in place of "
            "exact derivatives. For flights that jump, as from one guidance cycle to the "
            "next."
        ),
    ] = False,
    seed: Seed = 0,
    workers: Workers = None,
    device: Device = None,
    law: Law = None,
    case: Case = None,
    world: World = None,
    dispersions: Dispersions = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
) -> None:
    """Find derivatives of the misses, and predict their spread from one flight."""
    set_up(workers, device=device)

    from ..analysis.covariance import linear_covariance
    from ..analysis.sensitivities import sensitivity
    from ..campaign.dispersions import key_of, scaled_dispersions
    from ..flight.solver import FixedStep
    from .analysis_report import print_covariance, print_sensitivity
    from .dispersions_report import print_what_is_flown
    from .overrides import AtAddresses

    chosen, scenario, overrides = chosen_scenario(
        mission, (law, case, world), config, set_
    )
    base, table = dispersion_table(chosen, overrides, dispersions)
    solver = FixedStep(step)
    factors = scale or (0.1, 1.0)
    for factor in factors:
        if not 0.0 < factor < math.inf:
            raise ValueError(f"scale is {factor:g}: it must be greater than zero")
    if wrt:
        addresses = expanded(scenario, wrt, ())
        found = sensitivity(scenario, wrt=AtAddresses(tuple(addresses)), solver=solver)
        print_sensitivity(scenario, found)
    for factor in factors:
        analysis = linear_covariance(
            scenario,
            scaled_dispersions(table, factor),
            key=key_of(seed),
            runs=runs,
            solver=solver,
            mode="difference" if differences else None,
        )
        if factor is factors[0]:
            print_what_is_flown(chosen, scenario, overrides, base, table)
        print_covariance(scenario, analysis, factor)
