"""The command `jentry`: its entry point, and how errors are reported."""

import errno
import gc
import sys
import traceback
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from .._warnings import ResultWarning
from . import (
    benchmark as benchmark,
    compare as compare,
    corridor as corridor,
    fly as fly,
    footprint as footprint,
    inspect_runs as inspect_runs,
    linearize as linearize,
    list_missions as list_missions,
    merge as merge,
    monte_carlo as monte_carlo,
    optimize as optimize,
    report as report,
    sensitivity as sensitivity,
    show as show,
    train as train,
    tune as tune,
)
from .ending import fail, forget_output, leaving_at_once, open_streams
from .options import app


def _version(asked: bool) -> bool:
    if asked:
        typer.echo(f"jentry {version('jentry')}")
        raise typer.Exit
    return asked


@app.callback()
def options(
    version_: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Guided atmospheric entry: fly missions, one by one or in Monte Carlo campaigns."""


def main() -> None:
    """Run the command. An error that a user can act on is one line, without a traceback.

    Exit codes: 0 done, 1 the reader of the output has closed it, 2 wrong input, 3 results
    that cannot be used, 4 the machine (no space, no permission, no memory, a cluster that
    is not there or lost), 5 a requirement fails, 6 the runs are too few to judge a
    requirement, 130 interrupted.
    """
    # Tracing makes many objects and little garbage: collect it less often.
    gc.set_threshold(100_000)
    open_streams()
    with leaving_at_once(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ResultWarning)  # its text is printed
        warnings.showwarning = _show
        _run()


def _run() -> None:
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        forget_output()
        sys.exit(1)
    except Exception as error:
        code, message = _explained(error)
        if isinstance(error, OSError):
            forget_output()
        fail(message, code)


def _show(message, category, filename, lineno, file=None, line=None) -> None:
    """Print a warning as errors are printed. One of Python has its place in the code."""
    place = "" if category is UserWarning else f" ({filename}, line {lineno})"
    print(f"jentry: warning: {message}{place}", file=sys.stderr)


def _branch_of_a_law(error: Exception) -> str:
    """Message for a Python `if` on a number of a flight; raises the error if it is ours."""
    frames = traceback.extract_tb(error.__traceback__)
    installed = Path(__file__).parents[1], Path(sys.prefix), Path(sys.base_prefix)
    own = [
        f
        for f in frames
        if f.line and not any(map(Path(f.filename).is_relative_to, installed))
    ]
    if not own:
        raise error
    last = own[-1]
    return (
        f"{last.filename}, line {last.lineno}: {last.line}\nA number of a flight has no "
        "value when the flight is compiled, so that Python cannot branch on it: write "
        "jnp.where(condition, one, other)"
    )


def _explained(error: Exception) -> tuple[int, str]:
    """Exit code and message of an error that a user can act on; raises others again."""
    less = "there is not enough memory: fly fewer runs, or store less of each"
    match error:
        case ValueError():
            return 2, str(error)
        case OSError():
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            advice = "; free some space and run the same command, which resumes"
            return 4, f"{error}{advice if full else ''}"
        case MemoryError():
            return 4, less
        case ImportError() if "pip install 'jentry[" in str(error):
            return 4, str(error)
        case RuntimeError() if "RESOURCE_EXHAUSTED" in str(error):
            return 4, less
    from jax.errors import TracerBoolConversionError

    from ..campaign.errors import CampaignError, ClusterError

    if isinstance(error, TracerBoolConversionError):
        return 2, _branch_of_a_law(error)
    if isinstance(error, CampaignError):
        return 3, str(error)
    if isinstance(error, ClusterError):
        return 4, f"{error}; stored runs are safe, and the same command resumes"
    raise error
