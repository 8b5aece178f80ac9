"""Every notebook opens with what it is, stores no output, and runs."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from optional import MISSING

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_opens_with_what_goes_in_and_what_comes_out_and_stores_nothing(path):
    notebook = nbformat.read(path, as_version=4)
    opening = notebook.cells[0].source
    assert all(word in opening for word in ("**In:**", "**Out:**", "**Shows:**"))
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path, monkeypatch):
    if MISSING is not None and "from scenarios import" in path.read_text(encoding="utf-8"):
        pytest.skip(f"needs Open3D: {MISSING}")
    monkeypatch.setenv("MPLBACKEND", "agg")
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=240, resources={"metadata": {"path": FOLDER.parent}}).execute()
    assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
