"""The tutorials, the first page and the recipes run as they are printed.

`JENTRY_WRITE_PAGES=1 pytest -o addopts="" tests/test_tutorials.py` writes into the pages
what is printed now, where a page shows it.
"""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from tutorials import (
    DOCS,
    TUTORIALS,
    alike,
    blocks,
    commands,
    difference,
    files,
    same_words,
    updated,
)


PAGES = ["start.md", *TUTORIALS, "recipes.md"]
ROOT = Path(__file__).parents[1]
WRITE = bool(os.environ.get("JENTRY_WRITE_PAGES"))
COLUMNS = "100"
"""Width of what is printed"""
_PROGRESS = re.compile(r"^.* (?:left|done)\n", re.MULTILINE)
"""Lines that a slow machine prints"""


@pytest.fixture
def folder(command, tmp_path, monkeypatch):
    """Where a page is followed; what is imported from there is forgotten afterwards."""
    monkeypatch.setenv("COLUMNS", COLUMNS)
    monkeypatch.setattr("jentry.setup", lambda **options: None)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    yield tmp_path
    for name, module in sys.modules.copy().items():
        if str(getattr(module, "__file__", None)).startswith(str(tmp_path)):
            del sys.modules[name]


def write(path, contents):
    path.parent.mkdir(exist_ok=True)
    path.write_text(contents)


def run(command, words, folder):
    """Exit code and output of a command; those that start processes of their own apart."""
    name, *rest = shlex.split(words)
    assert name in ("jentry", "python"), words
    if name == "jentry" and "--cluster" not in rest:
        code, printed, said = command(*rest)
        return code or 0, printed + _PROGRESS.sub("", said)
    module = ["-m", "jentry"] if name == "jentry" else []
    ended = subprocess.run(
        [sys.executable, *module, *rest],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.environ.get("PYTHONPATH", str(ROOT))},
    )
    return ended.returncode, _PROGRESS.sub("", ended.stdout)


def executed(block, page, namespace):
    """What a block of Python prints."""
    lines = f"{page.name}, block at {block.at}"
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(block.body, lines, "exec"), namespace)
    return printed.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_a_page_runs_as_it_is_printed(command, folder, name):
    before = TUTORIALS[: TUTORIALS.index(name)] if name in TUTORIALS else []
    if name == "recipes.md":
        before = TUTORIALS
    for earlier in before:
        for title, contents in files((DOCS / earlier).read_text()).items():
            write(folder / title, contents)
    page, new = DOCS / name, {}
    try:
        follow(page, command, folder, new)
    finally:
        text = page.read_text()
        for at in sorted(new, reverse=True):
            block, body = new[at]
            text = text[:at] + body + text[at + len(block.body) :]
        if WRITE:
            page.write_text(text)


def follow(page, command, folder, new):
    """Do what a page says. `new` gets the blocks of output, as they are printed now."""
    namespace, printed = {"__name__": "__main__"}, None
    for block in blocks(page.read_text()):
        before, printed = printed, None
        if block.mark == "not run":
            continue
        if block.title:
            write(folder / block.title, block.body)
        elif block.language == "python":
            printed = executed(block, page, namespace)
        elif block.language == "text" and before is not None:
            lines = block.body.splitlines()
            new[block.at] = block, "\n".join(updated(lines, before)) + "\n"
            off = difference(lines, before, measure(block))
            assert WRITE or not off, off
        elif block.language == "console":
            body = ""
            for each in commands(block):
                code, said = run(command, each.words, folder)
                said = said.replace(f"{folder}/", "")
                assert code == each.code, f"{each.words}\n{said}"
                lines = updated(each.printed, said)
                body += "".join(f"{line}\n" for line in (f"$ {each.words}", *lines))
                off = difference(each.printed, said, measure(block))
                assert WRITE or not each.printed or not off, off
            new[block.at] = block, with_continuations(block.body, body)


def measure(block):
    """How its lines are compared."""
    return same_words if block.mark == "numbers vary" else alike


def with_continuations(before, after):
    """Commands over several lines as they were."""
    for long in re.findall(r"^\$ .*(?:\\\n.*)+", before, re.MULTILINE):
        after = after.replace(re.sub(r"\\\n\s*", "", long), long)
    return after


def test_output_that_differs_is_seen():
    printed = "one 1.00 km\n\u2500\u2500\u2500\ntwo 2 s\nthree\n"
    for expected in (["one 1.00 km", "two 2 s", "three"], ["...", "two 2 s", "..."]):
        assert not difference(expected, printed)
    assert not difference(["one  1.01 km", "..."], printed)
    assert "expected 'one 1.03" in difference(["one 1.03 km", "..."], printed)
    assert "expected 'two 2 m" in difference(["...", "two 2 m"], printed)
    assert "not expected: 'three'" in difference(["...", "two 2 s"], printed)
