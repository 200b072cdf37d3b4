"""Build the documentation site into a folder that opens from disk, without network.

    python -m pip install '.[docs]' && python docs/build.py site

The pages are the Markdown files of this folder. Four things are made from the program and
from what it has written: tables of results (`tables.py`), the options of the commands and
the choices of the missions (`described.py`), the reference (`reference.py`), and the
gallery (`gallery.py`). Every warning is an error: a link that leads nowhere, a name that
does not exist, a table without its numbers.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import tomli_w
from filling import filled
from gallery import write_gallery
from reference import write_reference

import jentry
from jentry.cli.overrides import read_toml


HERE = Path(__file__).parent
ROOT = HERE.parent

_SHIM = "https://unpkg.com/iframe-worker/shim"
"""What Zensical would load from the network for the search from disk"""


def prepare(folder: Path, notebooks: Path) -> None:
    """Write all pages and the configuration into a folder.

    **Arguments:**

    - `folder`: an empty folder.
    - `notebooks`: folder of the executed notebooks.
    """
    pages = folder / "pages"
    for path in sorted(HERE.rglob("*.md")):
        page = pages / path.relative_to(HERE)
        page.parent.mkdir(parents=True, exist_ok=True)
        try:
            page.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")
        except (KeyError, ValueError) as error:
            raise ValueError(f"{path.relative_to(ROOT)}: {error}") from error
    shutil.copytree(HERE / "assets", pages / "assets")
    shutil.copytree(ROOT / "notebooks" / "figures", pages / "figures")
    shutil.copy(ROOT / "CHANGELOG.md", pages / "changelog.md")
    site = read_toml(HERE / "zensical.toml")
    sections = {
        name: list_ for entry in site["project"]["nav"] for name, list_ in entry.items()
    }
    sections["Reference"] += write_reference(pages / "reference")
    sections["Gallery"] += write_gallery(pages / "gallery", notebooks)
    sections["Start"].append({"Changelog": "changelog.md"})
    handler = site["project"]["plugins"]["mkdocstrings"]["handlers"]["python"]
    handler["paths"] = [str(ROOT)]
    (folder / "zensical.toml").write_text(tomli_w.dumps(site), encoding="utf-8")


def build(folder: Path, notebooks: Path) -> None:
    """Build the site into a folder, of which the former contents are removed.

    Raises `SystemExit` for what Zensical warns of, and for a page that would ask for
    something from the network.
    """
    with tempfile.TemporaryDirectory() as made:
        prepare(Path(made), notebooks)
        run = subprocess.run(
            [sys.executable, "-m", "zensical", "build", "--strict"],
            cwd=made,
            capture_output=True,
            text=True,
        )
        if run.returncode:
            sys.exit(run.stdout + run.stderr)
        site = Path(made) / "site"
        for page in site.rglob("*.html"):
            local = "../" * len(page.relative_to(site).parents[:-1])
            text = page.read_text(encoding="utf-8")
            text = text.replace(_SHIM, f"{local}assets/local_worker.js")
            if found := re.search(
                r'<(?:script|img|link)[^>]*(?:src|href)="https?:[^>]*>', text
            ):
                sys.exit(f"{page.relative_to(site)} needs the network: {found[0]}")
            page.write_text(text, encoding="utf-8")
        if folder.exists():
            shutil.rmtree(folder)
        shutil.copytree(site, folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="what is in it is replaced")
    parser.add_argument(
        "--notebooks",
        type=Path,
        default=ROOT / "notebooks",
        help="folder of the executed notebooks",
    )
    options = parser.parse_args()
    if options.folder.exists() and not (options.folder / "index.html").exists():
        if not options.folder.is_dir() or any(options.folder.iterdir()):
            parser.error(f"{options.folder} is not empty and has no site in it")
    jentry.setup()
    build(options.folder, options.notebooks)
    print(f"written: {options.folder / 'index.html'}")


if __name__ == "__main__":
    main()
