"""Pages that run as they are printed: what their blocks are, and how output is compared.

A fenced block is, by its info string,

- `python title="my_law.py"` (or any other language with a title): a file. Files of earlier
  pages are there when a page begins;
- `python`: executed, all blocks of a page in one namespace. A block `text` that follows it
  is what it prints;
- `console`: commands, in lines that begin with `$ `, a backslash continues a line. The
  lines below a command are what it prints. A comment `<!-- exit 5 -->` before the block
  gives the exit code of its last command, and of the others is 0;
  Behind `<!-- numbers vary -->`, as those of a long search, words alone are compared;
- all else, and what follows a comment `<!-- not run -->`: text.

A line `...` stands for any number of lines. Words are compared exactly, spaces and lines
of tables aside, and numbers to their last printed digit or to a thousandth.
"""

import difflib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path


DOCS = Path(__file__).parents[1] / "docs"

TUTORIALS = [
    f"tutorials/{name}.md"
    for name in (
        "1-vehicle",
        "2-law",
        "3-dispersions",
        "4-requirements",
        "5-tune",
        "6-best-flight",
        "7-machines",
    )
]

_BLOCK = re.compile(
    r"(?:<!-- (?P<mark>[^>]*?) -->\n+)?^```(?P<language>\w+)(?P<info>[^\n]*)\n"
    r"(?P<body>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_RULES = re.compile(r"[\u2500-\u257f]+")


@dataclass
class Block:
    """A fenced block of a page, and where its body is in the text."""

    language: str
    title: str | None
    mark: str
    body: str
    at: int


def blocks(text: str) -> Iterator[Block]:
    for found in _BLOCK.finditer(text):
        title = re.search(r'title="([^"]*)"', found["info"])
        mark = found["mark"] or ""
        name = title and title[1]
        yield Block(found["language"], name, mark, found["body"], found.start("body"))


def files(text: str) -> dict[str, str]:
    """Files that a page has its reader write, as it leaves them."""
    return {block.title: block.body for block in blocks(text) if block.title}


@dataclass
class Command:
    """A line of a console, and what is printed below it."""

    words: str
    code: int = 0
    printed: list[str] = field(default_factory=list)


def commands(block: Block) -> list[Command]:
    found: list[Command] = []
    for line in re.sub(r"\\\n\s*", "", block.body).splitlines():
        if line.startswith("$ "):
            found.append(Command(line[2:]))
        else:
            found[-1].printed.append(line)
    code = re.fullmatch(r"exit (\d+)", block.mark)
    if code:
        found[-1].code = int(code[1])
    return found


def _words(line: str) -> tuple[str, list[str]]:
    """A line without its numbers, and the numbers."""
    line = _RULES.sub(" ", line)
    return " ".join(_NUMBER.sub("#", line).split()), _NUMBER.findall(line)


def _near(one: str, other: str) -> bool:
    digits = len(one.partition("e")[0].partition(".")[2])
    exponent = int(one.partition("e")[2] or 0)
    last = 10.0 ** (exponent - digits) if "." in one or "e" in one else 0.0
    expected, actual = float(one), float(other)
    return abs(expected - actual) <= max(1.01 * last, 1e-3 * abs(expected), 1e-9)


def alike(expected: str, actual: str) -> bool:
    """Whether two lines have the same words, and numbers as near as is printed."""
    (words, numbers), (others, found) = _words(expected), _words(actual)
    return words == others and all(
        _near(one, other) for one, other in zip(numbers, found, strict=True)
    )


def same_words(expected: str, actual: str) -> bool:
    """Whether two lines have the same words, whatever their numbers."""
    return _words(expected)[0] == _words(actual)[0]


Alike = Callable[[str, str], bool]


def _telling(lines: list[str]) -> list[str]:
    """Lines that say anything: not the empty ones, nor lines of tables."""
    return [line for line in lines if _words(line)[0]]


def difference(expected: list[str], printed: str, alike: Alike = alike) -> str:
    """The first line that is not printed where it should be; empty if there is none."""
    actual = _telling(printed.splitlines())
    place, skipping = 0, False
    for line in expected:
        if line.strip() == "...":
            skipping = True
            continue
        if not _words(line)[0]:
            continue
        places = range(place, len(actual)) if skipping else range(place, place + 1)
        here = [i for i in places if i < len(actual) and alike(line, actual[i])]
        if not here:
            return f"expected {line!r} in line {place + 1} or after of\n{printed}"
        place, skipping = here[0] + 1, False
    if not skipping and place < len(actual) and _telling(expected):
        return f"not expected: {actual[place]!r} of\n{printed}"
    return ""


def updated(expected: list[str], printed: str) -> list[str]:
    """The expected lines as they are printed now; `@@` stands for all of them."""
    actual = [line.rstrip() for line in printed.splitlines()]
    if expected == ["@@"]:
        return actual
    found, place = [], 0
    for line in expected:
        words = _words(line)[0]
        if line.strip() == "..." or not words:
            found.append(line)
            continue
        rest = range(place, len(actual))
        like = [
            difflib.SequenceMatcher(None, words, _words(actual[i])[0]) for i in rest
        ]
        ratios = [each.ratio() for each in like]
        best = rest[ratios.index(max(ratios))] if ratios else None
        found.append(line if best is None else actual[best])
        place = place if best is None else best + 1
    return found
