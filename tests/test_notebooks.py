"""What the notebooks import from the package exists: they are flown only before a change
lands, and the last of them breaks after many minutes.
"""

import ast
import importlib
import inspect
import json
from pathlib import Path

import pytest


NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))


def syntax_tree(notebook: Path) -> ast.Module:
    """All cells of code, without IPython's own commands."""
    cells = json.loads(notebook.read_text())["cells"]
    lines = [
        line
        for cell in cells
        if cell["cell_type"] == "code"
        for line in "".join(cell["source"]).splitlines()
        if not line.startswith("%")
    ]
    return ast.parse("\n".join(lines))


def imported(tree: ast.Module):
    """The package's own, by the name that the notebook gives it; fails on what is not."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for each in node.names:
                if each.name.split(".")[0] == "jentry":
                    yield each.asname or each.name, importlib.import_module(each.name)
        elif isinstance(node, ast.ImportFrom) and node.module.startswith("jentry"):
            for each in node.names:
                found = importlib.import_module(node.module)
                try:
                    found = getattr(found, each.name)
                except AttributeError:
                    found = importlib.import_module(f"{node.module}.{each.name}")
                yield each.asname or each.name, found


def missing(tree: ast.Module) -> list[str]:
    """What is read from imported modules, and is not there."""
    names = dict(imported(tree))
    return [
        f"{node.value.id}.{node.attr}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and inspect.ismodule(names.get(node.value.id))
        and not hasattr(names[node.value.id], node.attr)
    ]


def test_there_are_notebooks():
    assert len(NOTEBOOKS) > 5


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_names_what_exists(notebook):
    assert missing(syntax_tree(notebook)) == []


def test_a_name_that_moved_is_found():
    tree = ast.parse(
        "from jentry.missions.cav_h import training\ntraining.network_predictor('x')"
    )
    assert missing(tree) == ["training.network_predictor"]
