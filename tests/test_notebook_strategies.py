from __future__ import annotations

import re
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parent.parent / "notebooks" / "strategies.ipynb"


def test_the_notebook_of_the_strategies_runs_and_says_what_its_text_says(monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    for name, value in (("SAMPLES", "32"), ("WAYPOINTS", "200"), ("BASE", "8")):
        monkeypatch.setenv(f"NOTEBOOK_{name}", value)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    resources = {"metadata": {"path": str(NOTEBOOK.parent)}}
    nbclient.NotebookClient(notebook, timeout=240, kernel_name="python3", resources=resources).execute()
    said = "".join(output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", []))
    assert "as printed 2.29, PI 0.91" in said
    rows = re.findall(r"(vertical|all directions) +(\w+).* (\d+) % left", said)
    left = {(load, name): int(share) for load, name, share in rows}
    assert 40 <= left["all directions", "link"] <= 55
    assert 13 <= left["all directions", "combined"] <= 28 and left["vertical", "combined"] <= 5
