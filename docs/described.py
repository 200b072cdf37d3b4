"""What the program says of itself: options of its commands, choices of its missions."""

import math

import typer

from jentry._printed import sentence
from jentry.cli.entry import app
from jentry.missions import find_mission
from jentry.units import degree, hour, micro_g


def markdown_table(heading: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def options_of(name: str) -> str:
    """Usage, arguments and options of a command.

    Raises `KeyError` for an unknown command.
    """
    command = typer.main.get_group(app).commands[name]
    context = command.context_class(command, info_name=f"jentry {name}")
    usage = command.get_usage(context).removeprefix("Usage: ")
    rows: dict[str, list[list[str]]] = {"argument": [], "option": []}
    for parameter in command.params:
        if record := parameter.get_help_record(context):
            spelled, help_ = map(_in_a_cell, record)
            rows[parameter.param_type_name].append([f"`{spelled}`", help_])
    parts = [f"```text\n{usage}\n```", command.help or ""]
    parts += [
        markdown_table([kind.capitalize(), "Meaning"], found)
        for kind, found in rows.items()
        if found
    ]
    return "\n\n".join(parts)


def _in_a_cell(text: str) -> str:
    """Help without the marks of Rich, on one line of a table."""
    return " ".join(text.replace("\\[", "[").split()).replace("|", "\\|")


def choices_of(name: str) -> str:
    """Laws, cases, worlds and dispersions of a mission, each with its sentence."""
    mission = find_mission(name)
    parts = []
    for axis, option in (
        ("laws", "--law"),
        ("cases", "--case"),
        ("worlds", "--world"),
        ("dispersions", "--dispersions"),
    ):
        named = getattr(mission, axis)
        if named:
            rows = [[f"`{key}`", sentence(function)] for key, function in named.items()]
            parts.append(markdown_table([f"`{option}`", "Meaning"], rows))
    return "\n\n".join(parts)


_ERRORS = {
    "position": ("position at the start, m", 1.0),
    "velocity": ("velocity at the start, m/s", 1.0),
    "tilt": ("attitude at the start, degrees", degree),
    "bias": ("bias of the accelerometers, micro-g", micro_g),
    "scale_error": ("scale error of the accelerometers, 1e-6", 1e-6),
    "misalignment": ("misalignment of the accelerometers, 1e-6 rad", 1e-6),
    "drift": ("drift of the gyroscopes, degrees/h", degree / hour),
    "velocity_random_walk": ("random walk of the velocity after 1 s, mm/s", 1e-3),
    "angle_random_walk": (
        "random walk of the attitude after 1 h, degrees",
        degree / math.sqrt(hour),
    ),
}
"""By field of `jentry.missions.inertial.Errors`: words with a unit, and its SI value"""


def errors_of(name: str) -> str:
    """Standard deviations of the errors of the inertial navigation of a mission."""
    errors = find_mission(name).worlds["inertial"].__self__.errors
    rows = [
        [words, f"{getattr(errors, field) / size:.3g}"]
        for field, (words, size) in _ERRORS.items()
    ]
    return markdown_table(["error of each axis", "standard deviation"], rows)
