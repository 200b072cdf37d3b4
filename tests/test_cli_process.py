"""The command in its own process: output that cannot be printed, and Ctrl-C."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import jentry


ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONUTF8"}


def process(*words, shell="", **environment):
    command = f'"{sys.executable}" -W error -m jentry {" ".join(words)} {shell}'
    return subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command}"],
        capture_output=True,
        text=True,
        env=ENVIRONMENT | environment,
    )


def test_help_names_its_tables_and_imports_no_array():
    run = process("show", "--help", COLUMNS="200")
    assert run.returncode == 0 and run.stderr == ""
    assert "[set]" in run.stdout and "[dispersions]" in run.stdout


@pytest.mark.parametrize("shell", ["| true", ">&-", "2>&- >&-"])
def test_an_output_that_nobody_reads(shell):
    run = process("show", "--help", shell=shell)
    assert run.returncode in (0, 1)
    assert run.stderr == ""


def test_an_output_that_cannot_be_written():
    run = process("show", "--help", shell="> /dev/full")
    assert run.returncode == 4
    assert run.stderr.startswith("jentry: ") and run.stderr.count("\n") == 1


def test_a_terminal_without_accents():
    run = process("list", LC_ALL="POSIX", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")
    assert (run.returncode, run.stderr) == (0, "")
    assert "cav-h" in run.stdout and "\\xe9" in run.stdout


_INTERRUPTED = """
import os, signal, sys
class OnImport:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, OnImport())
sys.argv = ["jentry", "fly", "mars"]
from jentry.cli import main
main()
"""


@pytest.mark.parametrize("module", ["typer", "numpy", "jax._src.api", "diffrax"])
def test_ctrl_c_while_importing(module):
    run = subprocess.run(
        [sys.executable, "-c", _INTERRUPTED.format(module=module)],
        capture_output=True,
        text=True,
        cwd=Path(jentry.__file__).parent.parent,
    )
    assert (run.returncode, run.stderr) == (130, "jentry: interrupted\n")


def test_an_interruption_that_was_lost_ends_the_campaign_after_its_block(
    command, tmp_path, monkeypatch
):
    """As when Ctrl-C meets a callback of JAX, from which Python passes nothing on."""
    stored = []

    def losing(out, scenario, dispersions, seed, runs, *, report, **options):
        for done in range(1, 4):
            try:
                if done == 2:
                    signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                pass
            stored.append(done)
            report(done)

    monkeypatch.setattr("jentry.campaign.store.run_campaign", losing)
    code, _, said = command("monte-carlo", "cheap", "--runs", 3)
    assert (code, said) == (130, "jentry: interrupted; the same command resumes\n")
    assert stored == [1, 2]


def test_an_interruption_that_became_another_error(command, monkeypatch):
    def converting(*given, **options):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            raise RuntimeError("INTERNAL: CpuCallback error") from error

    monkeypatch.setattr("jentry.campaign.store.run_campaign", converting)
    code, _, said = command("monte-carlo", "cheap", "--runs", 3)
    assert (code, said) == (130, "jentry: interrupted; the same command resumes\n")


def test_the_handler_of_ctrl_c_is_given_back(command):
    before = signal.getsignal(signal.SIGINT), sys.unraisablehook
    command("monte-carlo", "cheap", "--runs", 0)
    assert (signal.getsignal(signal.SIGINT), sys.unraisablehook) == before
