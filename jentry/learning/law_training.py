"""What the training of a neural law of a mission needs, and the training as a whole."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .._setup import needs_float64
from ..campaign.campaign import drawn_inputs
from ..campaign.dispersions import Dispersion, key_of
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver, FixedStep
from ..guidance.neural_law import input_names, purpose_of
from ..onboard.recurrent_network import RecurrentNetwork, save_recurrent_network
from .flight_residuals import Residuals, ground_miss, neural_law_of
from .imitation import imitated
from .neural_law import METHODS, TrainedLaw, train_neural_law
from .recorded_law import Recording, record_inputs
from .segment_value import Segments
from .training_record import PERCENTILES, Judged
from .weight_steps import AbstractMethod


NETWORK_FILE, COURSE_FILE = "law.npz", "course.npz"

BEFORE = "before"
"""Folder of the training before, within that of the training"""


@dataclasses.dataclass(frozen=True)
class LawTraining:
    """A neural law of a mission to train: its scenario, its flights and its losses."""

    teacher: Scenario
    """Scenario with another law. Its flights normalise the inputs of the network"""
    with_network: Callable[[RecurrentNetwork], Scenario]
    """Function from a network to the scenario with the neural law"""
    dispersions: Mapping[str, Dispersion]
    residuals: Residuals = ground_miss
    methods: tuple[AbstractMethod, ...] = METHODS
    solver: AbstractSolver = FixedStep(1.0)
    """Solver of the training. Judge the law with the solver with which it shall fly"""
    history: float | None = None
    """Interval of the histories that the residuals need, s; None if they need none"""
    widths: tuple[float, ...] | None = None
    """Factor on the width of the dispersions with each method; None for ones"""
    judged_by: float = 99.0
    """Percentile of the distance by which weights are better, as in `train_neural_law`"""
    memory: int = 16
    """Size of the memory of the network; 0 for none"""
    hidden: tuple[int, ...] = (16,)
    """Sizes of its hidden layers"""
    with_angle: bool = False
    """Whether the network commands the angle of attack too"""
    with_flow: bool = False
    """Whether the network reads the flow too, as `NeuralLaw.reads_flow`; the scenario of
    the teacher needs flow sensors as well"""
    segments: Segments | None = None
    """Segments of the flights, as in `train_neural_law`; None for whole flights"""
    before: "LawTraining | None" = None
    """Training with whose network this one begins, such as one in a simpler world; None to
    begin with random weights. The teacher is that of the first training"""
    taught_flights: int = 512
    """Number of flights of the teacher"""
    taught_steps: int = 2000
    """Number of steps of an imitation of them, if there is one"""

    def __post_init__(self):
        for name in ("memory", "hidden", "with_angle", "with_flow"):
            mine, before = getattr(self, name), getattr(self.before, name, None)
            if self.before is not None and mine != before:
                raise ValueError(
                    f"{name} is {mine}, and {before} in the training before, whose network "
                    "this one begins with: both must be the same"
                )

    @property
    def first(self) -> "LawTraining":
        """The training that begins with random weights: this one, or one before."""
        return self if self.before is None else self.before.first

    @property
    def place(self) -> int:
        """Number of trainings before this one."""
        return 0 if self.before is None else 1 + self.before.place


@needs_float64
def train_law(
    training: LawTraining,
    seed: int,
    folder: Path | str,
    *,
    imitate: bool = False,
    card: Mapping[str, Any] | None = None,
    say: Callable[[str], None] = lambda line: None,
    report: Callable[[LawTraining, Judged], None] = lambda training, judged: None,
) -> TrainedLaw:
    """Train a neural law from random weights, and store its network with its model card.

    The folder has the network, `law.npz`, and the file from which the same call resumes,
    `course.npz`. A training that begins with another one trains that first, in the folder
    `before`.

    **Arguments:**

    - `seed`: seed of weights and flights.
    - `imitate`: whether to begin with an imitation of the teacher.
    - `card`: further entries of the model card.
    - `say`: function that is called with lines of text on the progress.
    - `report`: function that is called with each judgement, after the training that it is
        of: this one, or that before.

    **Raises:** `ValueError` for an imitation by a network that commands the angle of
    attack, and for a folder with a file of another training.
    """
    folder = Path(folder)
    if imitate and training.first.with_angle:
        raise ValueError(
            "the network commands the angle of attack too, and imitation learns banks "
            "alone: leave out --imitate"
        )
    if training.before is not None and (folder / COURSE_FILE).exists():
        if not (folder / BEFORE / NETWORK_FILE).exists():
            raise ValueError(
                f"{folder / COURSE_FILE} is of another training, since the one before is "
                f"not in {folder / BEFORE}: choose another folder, or remove the file"
            )
    *_, learn, fly = jax.random.split(key_of(seed), 4)
    earlier = None
    if training.before is None:
        start, recording = random_law(training, seed, say)
        if imitate:
            steps = training.taught_steps
            start = imitated(start, recording, learn, steps=steps, report=say)
    else:
        earlier = train_law(
            training.before,
            seed,
            folder / BEFORE,
            imitate=imitate,
            card=card,
            say=say,
            report=report,
        )
        say(f"the training before is in {folder / BEFORE}; now the next one")
        start = training.with_network(neural_law_of(earlier.scenario).network)
        fly = jax.random.fold_in(fly, training.place)
    trained = train_neural_law(
        start,
        training.dispersions,
        fly,
        residuals=training.residuals,
        methods=training.methods,
        widths=training.widths,
        judged_by=training.judged_by,
        solver=training.solver,
        history=training.history,
        store=folder / COURSE_FILE,
        segments=training.segments,
        report=lambda judged: report(training, judged),
    )
    parts = [part for part in (earlier, trained) if part is not None]
    last = [part.course[-1] for part in parts]
    best = trained.course[trained.best]
    about = {
        "purpose": purpose_of(training.with_angle),
        "seed": seed,
        "begins with an imitation": imitate,
        "begins with another training": earlier is not None,
        "guidance cycles of a segment": training.segments and training.segments.cycles,
        "dispersed": list(training.dispersions),
        "flights with derivatives": sum(j.flights for j in last),
        "flights left out": sum(j.left_out for j in last),
        "flights that counted less than half": sum(j.clipped for j in last),
        "training, s": round(sum(j.seconds for j in last), 1),
        "best after flights": sum(j.flights for j in (*last[:-1], best)),
        "held out flights without an end": trained.final.without_end,
        "held out distance": {
            f"{p:g} %": d
            for p, d in zip(PERCENTILES, trained.final.distances, strict=True)
        },
    }
    network = neural_law_of(trained.scenario).network
    save_recurrent_network(folder / NETWORK_FILE, network, about | dict(card or {}))
    return trained


def random_law(
    training: LawTraining, seed: int, say: Callable[[str], None] = lambda line: None
) -> tuple[Scenario, Recording]:
    """The scenario with random weights, and the flights of the teacher.

    These normalise the inputs. `say` is a function that is called with a line of text.
    """
    teach, weights, *_ = jax.random.split(key_of(seed), 4)
    flights = training.taught_flights
    say(f"{flights} flights of the teacher, {type(training.teacher.law).__name__}")
    runs = drawn_inputs(
        training.teacher, training.dispersions, teach, np.arange(flights)
    )

    def scenario(samples: dict[str, np.ndarray]) -> Scenario:
        sizes = training.memory, training.hidden, 1 + training.with_angle
        network = RecurrentNetwork.untrained(samples, *sizes, weights)
        return training.with_network(network)

    # What the law reads does not depend on its network.
    names = input_names(training.with_angle, training.with_flow)
    reader = neural_law_of(scenario(dict.fromkeys(names, np.zeros(1))))
    recording = record_inputs(training.teacher, reader, runs, training.solver)
    read = recording.inputs[np.all(np.isfinite(recording.inputs), axis=-1)]
    return scenario(dict(zip(names, read.T, strict=True))), recording
