"""Every build runs all notebooks, as many at a time as there are cores: they are kept without outputs."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import jupytext
import loky
import nbclient
from nbformat import NotebookNode

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
# They begin first, so that none of them is left alone with one core.
LONGEST = ("ten_scans", "whole_flower", "real_petals", "noise_and_clutter", "petal_from_mask")

# By the code of their cells: what Sphinx reads may have other links in its text.
_running: dict[tuple[str, ...], Future[NotebookNode]] = {}


def begin(app: object) -> None:
    """Starts all notebooks, each in a kernel, while Sphinx reads the other pages."""
    paths = sorted(path for path in NOTEBOOKS.glob("*.py") if path.name != "pictures.py")
    paths.sort(key=lambda path: path.stem not in LONGEST)
    pool = ThreadPoolExecutor(loky.cpu_count())
    for path in paths:
        notebook = _read(path.read_text(encoding="utf-8"))
        _running[_code(notebook)] = pool.submit(_run, notebook)
    pool.shutdown(wait=False)


def executed(text: str) -> NotebookNode:
    """A notebook with the outputs of its run; what a cell raises is raised."""
    notebook = _read(text)
    ran = _running[_code(notebook)].result()
    notebook.metadata.update(ran.metadata)  # which language it is in
    outputs = iter(_cells(ran))
    for cell in _cells(notebook):
        cell.update(next(outputs), id=cell.id)
    return notebook


def _read(text: str) -> NotebookNode:
    return jupytext.reads(text, fmt="py:percent")


def _cells(notebook: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def _code(notebook: NotebookNode) -> tuple[str, ...]:
    return tuple(cell.source for cell in _cells(notebook))


def _run(notebook: NotebookNode) -> NotebookNode:
    # No limit of time: a kernel that dies is noticed, and how long a cell takes is the machine's affair.
    return nbclient.execute(notebook, cwd=str(NOTEBOOKS), timeout=None)


def setup(app) -> dict[str, bool]:
    app.connect("builder-inited", begin)
    return {"parallel_read_safe": False}
