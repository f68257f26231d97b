"""Every notebook runs from top to bottom, and none carries outputs in git."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))
SECONDS_A_CELL = 300
"""Far beyond what a cell takes on a busy machine: a hang, not slowness."""


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_are_stripped(path: Path) -> None:
    cells = nbformat.read(path, as_version=4).cells
    assert [i for i, cell in enumerate(cells) if cell.get("outputs") or cell.get("execution_count")] == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path: Path, tmp_path: Path) -> None:
    """Without an error; a picture or words from every cell that ends in a call to draw or print."""
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(
        notebook, timeout=SECONDS_A_CELL, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    for cell in notebook.cells:
        if cell.cell_type == "code" and cell.source.splitlines()[-1].lstrip().startswith("plot_"):
            assert any("image/png" in output.get("data", {}) for output in cell.outputs), cell.source
        if cell.cell_type == "code":
            assert not any(output.get("name") == "stderr" for output in cell.outputs), cell.source
