"""Run the notebooks of examples/notebooks; as a program, store their outputs.

python tests/support/run_notebooks.py examples/notebooks/apollo15.ipynb
"""

import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient


def run(path: Path, folder: Path) -> nbformat.NotebookNode:
    """Return a notebook with the outputs of a fresh kernel in a folder; a failing cell is an error."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=600,
        record_timing=False,
        coalesce_streams=True,
        resources={"metadata": {"path": str(folder)}},
    )
    # Without the choice of a backend for tests figures are those that a reader sees.
    client.execute(env={name: value for name, value in os.environ.items() if name != "MPLBACKEND"})
    notebook.metadata.language_info = {"name": "python"}  # not the version that happened to run it
    return notebook


if __name__ == "__main__":
    for name in sys.argv[1:]:
        nbformat.write(run(Path(name), Path(name).parent), name)
