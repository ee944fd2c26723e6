"""Run the notebooks from top to bottom in empty directories, and store their outputs.

usage: python experiments/notebooks.py [NAME ...]    (by default all)
"""

import sys
import tempfile
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


def store_outputs(path: Path) -> None:
    """Run the notebook ``path``, and write it with its outputs and without what else changes.

    The package ipywidgets should not be installed: a stored slider shows nothing.
    """
    notebook = nbformat.read(path, as_version=4)
    metadata = dict(notebook.metadata)
    with tempfile.TemporaryDirectory() as directory:
        resources = {"metadata": {"path": directory}}
        client = NotebookClient(notebook, timeout=None, coalesce_streams=True, resources=resources)
        client.execute()
    notebook.metadata = metadata
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # times
    nbformat.write(notebook, path)


if __name__ == "__main__":
    for name in sys.argv[1:] or sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb")):
        start = time.perf_counter()
        store_outputs(NOTEBOOKS / f"{name}.ipynb")
        print(f"{name}: {time.perf_counter() - start:.0f} s")
