"""Run the notebooks of examples/notebooks; as a program, keep what they show in their files.

python tests/support/run_notebooks.py examples/notebooks/apollo15.ipynb
"""

import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient


def run(path: Path, folder: Path) -> nbformat.NotebookNode:
    """The notebook with what its cells show in a fresh kernel that works in a folder; a cell that fails is an error."""
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
