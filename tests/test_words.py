"""The words of the docstrings, the help, the messages and the pages are the glossary's."""

import ast
import re
from pathlib import Path

import pytest


ROOT = Path(__file__).parents[1]
GLOSSARY = ROOT / "docs" / "glossary.md"
MODULES = sorted(ROOT.joinpath("jentry").rglob("*.py"))
PAGES = [
    *sorted(ROOT.joinpath("docs").rglob("*.md")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
]


def retired():
    """The words in the first column of the last table of the glossary."""
    table = GLOSSARY.read_text().partition("## Retired words")[2]
    cells = re.findall(r"^\| ([^|]+) \| [^|]+ \|$", table, re.M)
    assert cells[0] == "Retired" and len(cells) > 8
    return [word for cell in cells[1:] for word in re.split(r", (?=\S)", cell)]


def pattern():
    words = sorted(map(re.escape, retired()), key=len, reverse=True)
    return re.compile(rf"(?<![\w`])({'|'.join(words)})(?![\w`])", re.I)


def test_the_pattern_finds_words_and_leaves_names():
    found = pattern().findall(
        "It is kept anew; `kept` and forgotten, the same, Readings."
    )
    assert [word.lower() for word in found] == ["kept", "anew", "the same,", "readings"]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_no_text_of_a_module_has_a_retired_word(path):
    """Docstrings, help and messages: all strings with a space in them."""
    words = pattern()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
            if " " in text:
                found = words.search(text)
                assert found is None, f"line {node.lineno}: {found[0]!r} in {text!r}"
            if "\n" in text or text.endswith("."):
                begin = text.lstrip()[:40]
                assert not begin.startswith(("Of ", "The same")), (
                    f"line {node.lineno} begins with {begin!r}: say what the thing is"
                )


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_no_page_has_a_retired_word(path):
    text = path.read_text()
    if path == GLOSSARY:
        text = text.partition("## Retired words")[0]
    text = re.sub(r"```.*?```", "", text, flags=re.S)
    found = pattern().search(text)
    assert found is None, f"{found[0]!r} in {text[found.start() - 40 : found.end()]!r}"
