"""The command: its options, and how it ends."""

import importlib.metadata
import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from commands import assert_refused
from typer.testing import CliRunner

from jentry.cli.options import app


SETTLING = ("monte-carlo", "tune", "sensitivity", "train")
"""Commands that take a number of workers"""


@pytest.mark.parametrize(
    ("name", "words", "expected"),
    [
        *((name, (), (None, False)) for name in SETTLING),
        *((name, ("--workers", 3), (3, False)) for name in SETTLING),
        *((name, ("--fast",), (None, True)) for name in ("monte-carlo", "tune")),
        *((name, (), (1, False)) for name in ("fly", "show")),
    ],
)
def test_workers_and_fast_arrive(command, monkeypatch, name, words, expected):
    settled = []

    def setup(workers=None, *, fast=False, device=None):
        settled.append((workers, fast))
        raise ValueError("enough")

    monkeypatch.setattr("jentry._setup.setup", setup)
    assert_refused(command(name, "cheap", *words), "enough")
    assert settled == [expected]


REFUSED = {
    "mission": (("fly", "chaep"), "no mission 'chaep'; nearest: cheap"),
    "law": (
        ("fly", "cheap", "--law", "left"),
        "mission cheap has no law 'left': choose from right, steep",
    ),
    "reading": (
        ("monte-carlo", "cheap", "--dispersions", "none"),
        "no dispersions 'none': choose from all, mass-only",
    ),
    "address": (
        ("fly", "cheap", "--set", "vehicle.mas=900"),
        "no leaf 'vehicle.mas' in this scenario; nearest: vehicle.mass",
    ),
    "value": (
        ("show", "cheap", "--set", "vehicle.mass=much"),
        "'much' is not a number",
    ),
    "no value": (("show", "cheap", "--set", "vehicle.mass"), "write ADDRESS=VALUE"),
    "mass": (
        ("fly", "cheap", "--set", "vehicle.mass=-1"),
        "vehicle.mass is -1 kg: it must be greater than zero",
    ),
    "not finite": (
        ("monte-carlo", "cheap", "--set", "vehicle.mass=nan"),
        "vehicle.mass is nan: it must be a finite number",
    ),
    "runs": (("monte-carlo", "cheap", "--runs", "0"), "no runs to fly: runs is 0"),
    "fewer runs": (("monte-carlo", "cheap", "--runs", "-2"), "runs is -2"),
    "step": (("fly", "cheap", "--step", "0"), "step is 0.0 s: it must be positive"),
    "history": (
        ("monte-carlo", "cheap", "--runs", "2", "--history", "-1"),
        "history is -1.0 s: the interval must be positive",
    ),
}


@pytest.mark.parametrize(("words", "message"), REFUSED.values(), ids=REFUSED)
def test_wrong_input_is_refused_in_one_line(command, tmp_path, words, message):
    assert_refused(command(*words), message)
    assert not list(tmp_path.glob("**/*.nc"))


@pytest.mark.parametrize(
    "words",
    [
        ["monte-carlo", "cheap", "--runs", "many"],
        ["monte-carlo", "cheap", "--inputs", "nowhere.csv"],
        ["fly", "cheap", "--config", "nowhere.toml"],
        ["fly"],
        ["flie", "cheap"],
        [],
    ],
    ids=" ".join,
)
def test_options_that_do_not_exist(words):
    assert CliRunner().invoke(app, words).exit_code == 2


@pytest.mark.parametrize("name", [None, "list", "show", "fly", "monte-carlo"])
def test_help(name):
    words = ["--help"] if name is None else [name, "--help"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0 and "Usage" in result.output


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["list"], 0, ""),
        (["fly", "mars"], 2, "jentry: no mission 'mars'; nearest: "),
        (["monte-carlo", "mars", "--workers", "0"], 2, "jentry: workers is 0"),
    ],
)
def test_exit_codes_of_the_process(words, code, said, tmp_path):
    run = subprocess.run(
        [sys.executable, "-W", "error", "-m", "jentry", *words],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "JENTRY_CACHE": str(tmp_path)},
    )
    assert run.returncode == code
    assert run.stderr.startswith(said) and run.stderr.count("\n") == (code != 0)
    assert bool(run.stdout) == (code == 0)


ENDINGS = {
    "pass": (0, ""),
    "sys.exit(5)": (5, ""),
    "sys.exit()": (0, ""),
    "raise ValueError('what no one expects')": (1, "ValueError: what no one expects"),
    "sys.stdout.close()": (0, ""),
    "threading.Thread(target=threading.Event().wait).start()": (0, ""),
}


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_process_ends_at_once(ending):
    """With its exit code, all that was printed, and nothing taken apart before."""
    program = f"""
import atexit, sys, threading
from jentry.cli.ending import as_process
atexit.register(print, "taken apart", file=sys.stderr)
def run():
    print("done")
    {ending}
as_process(run)
"""
    call = [sys.executable, "-c", program]
    buffered = {k: x for k, x in os.environ.items() if k != "PYTHONUNBUFFERED"}
    run = subprocess.run(
        call, capture_output=True, text=True, timeout=60.0, env=buffered
    )
    code, said = ENDINGS[ending]
    assert run.returncode == code
    assert run.stdout == "done\n"
    assert run.stderr.strip().endswith(said) and "taken apart" not in run.stderr
    assert bool(run.stderr) == bool(said)


RUN = {"law", "case", "world", "set", "config", "step"}
FREE = {"problem", "end", "limits", "no-limits", "bank", "angle-of-attack", "nodes"} | {
    "over",
    "every",
    "out",
}
"""What is free, and what is kept"""


REPORT = {"percentiles", "require", "requirements", "format", "json", "quiet"}
"""What is asked of a campaign's summary"""


ARRIVE = {
    "list": set(),
    "show": {"law", "case", "world", "set", "config", "dispersions", "file"},
    "fly": RUN | {"history", "out", "figure", "trajectory"},
    "monte-carlo": RUN
    | {"runs", "seed", "out", "workers", "dispersions", "inputs", "history", "fast"}
    | {
        "no-fast",
        "figures",
        "no-figures",
        "until-decided",
        "most-runs",
        "slice",
        "sampler",
        "cluster",
        "device",
    }
    | REPORT,
    "report": {"runs", "mission", "figures", "no-figures", "figures-only", "full"}
    | REPORT,
    "merge": set(),
    "inspect": {"by", "smallest", "worst", "run", "history", "mission", "workers"}
    | {"gradient", "no-gradient"},
    "compare": {
        "law",
        "case",
        "world",
        "config",
        "runs",
        "seed",
        "dispersions",
        "set",
        "step",
    }
    | {"out", "quiet", "workers", "device", "fast", "no-fast", "cluster"}
    | {"outputs", "percentiles", "all-pairs", "json"},
    "benchmark": {"law", "case", "laws", "cases", "short", "sets", "runs", "seed"}
    | {"step", "beside", "out", "json", "quiet", "workers"},
    "tune": RUN
    | {"gains", "runs", "steps", "loss", "of", "out", "optimizer", "learning-rate"}
    | {"bounds", "smooth", "no-smooth", "fresh-draws", "no-fresh-draws", "patience"}
    | {"held-out", "seed", "workers", "dispersions", "fast", "no-fast"}
    | {"scale", "differences", "smooth-reversals", "no-smooth-reversals"}
    | {"least-damping", "faster-than", "cluster", "device"},
    "linearize": RUN | {"over", "points", "out", "faster-than"},
    "optimize": RUN | FREE | {"maximize", "minimize"},
    "footprint": RUN | FREE | {"directions"},
    "corridor": (RUN - {"law"}) | {"steepest", "shallowest", "out", "json"},
    "train": {
        "law",
        "imitate",
        "out",
        "seed",
        "flights",
        "again",
        "iterations",
        "workers",
    },
    "sensitivity": RUN
    | {"wrt", "scale", "runs", "seed", "workers", "dispersions", "differences"}
    | {"no-differences", "device"},
}


def test_every_option_is_in_a_test_of_what_arrives():
    """Those above, each with all options of its command; add yours there, and here."""
    commands = typer.main.get_command(app).commands
    options = {
        name: {
            word.removeprefix("--")
            for parameter in command.params
            for word in (*parameter.opts, *parameter.secondary_opts)
            if word.startswith("--") and word != "--help"
        }
        for name, command in commands.items()
    }
    assert options == ARRIVE


def test_a_campaign_imports_no_optimizer():
    """They take a fifth of a second, which is more than a thousand flights take."""
    program = """
import sys
import jentry.cli.entry, jentry.cli.campaign_files, jentry.cli.figures, jentry.missions
import jentry.campaign.store, jentry.statistics.summary
print(*{"optax", "pandas", "matplotlib", "scipy", "pint"} & set(sys.modules))
"""
    call = [sys.executable, "-c", program]
    run = subprocess.run(call, capture_output=True, text=True, check=True)
    assert run.stdout == "\n"


TORN = """
import signal
from jentry.cli.ending import rounding_off

class Torn:
    def __del__(self):
        raise ValueError("half of it is missing")

def write():
    torn = Torn()
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt as interruption:
        raise {raised}
    return torn

with rounding_off("the same command resumes"):
    write()
"""


@pytest.mark.parametrize("raised", ["interruption", "OSError"])
def test_what_an_interruption_has_torn_says_nothing(raised):
    """As a file that was being written, which cannot be closed any more."""
    program = TORN.format(raised=raised)
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 130
    assert ended.stderr == "jentry: interrupted; the same command resumes\n"


def test_the_version_is_that_of_the_package(command):
    """The same in what one cites."""
    code, printed, _ = command("--version")
    version = importlib.metadata.version("jentry")
    assert (code, printed) == (0, f"jentry {version}\n")
    citation = Path(__file__).parent.parent / "CITATION.cff"
    assert f"\nversion: {version}\n" in citation.read_text()
