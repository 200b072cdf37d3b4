"""The gallery: a page for each executed notebook, and an overview with their pictures."""

import re
from pathlib import Path

import nbformat
from nbconvert import MarkdownExporter


ORDER = (
    "first_flight",
    "your_own_mission",
    "four_laws_mars",
    "tuning_mars",
    "neural_law_mars",
    "bezier_cav_h",
    "feedback_linearization_sx2",
    "alpha_modulation_rlv",
    "pseudospectral_x33",
    "optimize_flight",
)


def write_gallery(folder: Path, notebooks: Path) -> list[dict[str, str]]:
    """Write the pages and their pictures; return their entries of the navigation.

    Raises `ValueError` for a notebook that is not in the order, or has no picture.
    """
    found = {path.stem for path in notebooks.glob("*.ipynb")}
    if found != set(ORDER):
        raise ValueError(f"notebooks in one place only: {sorted(found ^ set(ORDER))}")
    folder.mkdir(parents=True)
    overview = ["# Gallery", "", "Notebooks, as they were executed.", ""]
    entries = []
    for name in ORDER:
        notebook = nbformat.read(notebooks / f"{name}.ipynb", as_version=4)
        text, resources = MarkdownExporter().from_notebook_node(notebook)
        pictures = sorted(resources["outputs"])
        if not pictures:
            raise ValueError(f"{name}.ipynb has no picture: execute it, and save it")
        for picture, contents in resources["outputs"].items():
            (folder / f"{name}_{picture}").write_bytes(contents)
            text = text.replace(f"({picture})", f"({name}_{picture})")
        title = re.search(r"^# (.+)$", text, re.M)
        if title is None:
            raise ValueError(f"{name}.ipynb has no title")
        sentence = _first_paragraph(text[title.end() :])
        (folder / f"{name}.md").write_text(text, encoding="utf-8")
        overview += [
            f"## [{title[1]}]({name}.md)",
            "",
            sentence,
            "",
            f"[![{title[1]}]({name}_{pictures[0]}){{ width=480 }}]({name}.md)",
            "",
        ]
        entries.append({title[1]: f"gallery/{name}.md"})
    (folder / "index.md").write_text("\n".join(overview), encoding="utf-8")
    return [{"Gallery": "gallery/index.md"}, *entries]


def _first_paragraph(text: str) -> str:
    for paragraph in text.split("\n\n"):
        if paragraph.strip() and not paragraph.lstrip().startswith(
            ("```", "|", "!", "#")
        ):
            return " ".join(paragraph.split())
    return ""
