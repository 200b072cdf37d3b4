#!/usr/bin/env python3
"""Execute the notebooks, two at a time.

Their kernels talk over sockets in the file system: two that start at once can be given
one and the same TCP port.
"""

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

SHORT = "first_flight", "four_laws_mars", "your_own_mission"
"""Those that take no more than a minute of a core"""


def execute(path: Path) -> None:
    """Execute one notebook, in its own folder.

    Raises:
        CellExecutionError: A cell raised.

    """
    notebook = nbformat.read(path, as_version=4)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(BATCHES))
    with tempfile.TemporaryDirectory() as sockets:
        # Of a kernel that it has started itself a client is rid when it ends.
        NotebookClient(
            notebook,
            config=Config(
                KernelManager={"transport": "ipc", "ip": f"{sockets}/kernel"}
            ),
            resources={"metadata": {"path": str(FOLDER)}},
        ).execute()
    print(path.name, flush=True)


if __name__ == "__main__":
    paths = [Path(each).resolve() for each in sys.argv[1:]] or list(
        FOLDER.glob("*.ipynb")
    )
    # What takes long first, and what nobody knows: at the end none waits for another.
    paths.sort(key=lambda path: path.stem in SHORT)
    with ThreadPoolExecutor(2) as pool:
        runs = {path: pool.submit(execute, path) for path in paths}
    failures = {path.name: run.exception() for path, run in runs.items()}
    for name, failure in failures.items():
        if failure is not None:
            print(f"{name}: {failure}", file=sys.stderr)
    if any(failures.values()):
        sys.exit(1)
