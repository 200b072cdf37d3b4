#!/usr/bin/env python3
"""Execute the notebooks, two at a time, and write them with their outputs if asked to.

    .ci/notebooks.py [--out FOLDER] [NOTEBOOK...]

Their kernels talk over sockets in the file system: two that start at once can be given
one and the same TCP port.
"""

import argparse
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from traitlets.config import Config


FOLDER = Path(__file__).parent.parent / "notebooks"

BATCHES = "from jentry.campaign import batch; batch._CHUNKS = 1"
"""Before the first cell: campaigns fly batch by batch, as in the tests, to the same bits.
Without a loop over batches they are compiled in two thirds of the time."""

LONGEST = "bezier_cav_h"
"""It takes twice as long as any other one, and begins first"""

SHORT = "first_flight", "four_laws_mars", "your_own_mission"
"""Those that take no more than a minute of a core"""


def execute(path: Path, out: Path | None) -> None:
    """Execute one notebook, in its own folder, and write it to another one.

    Raises:
        CellExecutionError: A cell raised.

    """
    notebook = nbformat.read(path, as_version=4)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(BATCHES))
    with tempfile.TemporaryDirectory() as sockets:
        # A client ends the kernel that it has started itself.
        NotebookClient(
            notebook,
            config=Config(
                KernelManager={"transport": "ipc", "ip": f"{sockets}/kernel"}
            ),
            resources={"metadata": {"path": str(FOLDER)}},
        ).execute()
    if out is not None:
        del notebook.cells[0]
        nbformat.write(notebook, out / path.name)
    print(path.name, flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("notebooks", nargs="*", type=Path)
    parser.add_argument("--out", type=Path, help="folder of the executed notebooks")
    options = parser.parse_args()
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    paths = [each.resolve() for each in options.notebooks or FOLDER.glob("*.ipynb")]
    # The short ones last, so that none runs alone at the end.
    paths.sort(key=lambda path: (path.stem in SHORT, path.stem != LONGEST))
    with ThreadPoolExecutor(2) as pool:
        runs = {path: pool.submit(execute, path, options.out) for path in paths}
    failures = {path.name: run.exception() for path, run in runs.items()}
    for name, failure in failures.items():
        if failure is not None:
            print(f"{name}: {failure}", file=sys.stderr)
    if any(failures.values()):
        sys.exit(1)
