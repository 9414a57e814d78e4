"""The notebooks use public names in the order of the manual; slowly, they run and their closing assertions hold."""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path

import nbformat
import pytest

import compplan as cp

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
NAMES = [file.stem for file in NOTEBOOKS]
#: Studies use public names alone.
STUDIES = ("strategies", "gap_study")


def code_of(name: str) -> list[str]:
    notebook = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)
    nbformat.validate(notebook)
    return [cell.source for cell in notebook.cells if cell.cell_type == "code"]


def test_the_manual_lists_every_notebook_in_the_order_of_the_data() -> None:
    listed = re.findall(r"^notebooks/(\w+)$", (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8"), re.M)
    assert sorted(listed) == NAMES
    order = ["first_plan", "own_robot", "identification", "strategies", "diagnose", "the_loop", "cam_to_controller"]
    assert [name for name in listed if name in order] == order


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_kept_small_with_outputs_that_name_no_machine(name: str) -> None:
    file = ROOT / "notebooks" / f"{name}.ipynb"
    notebook = nbformat.read(file, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    outputs = [output for cell in code for output in cell.outputs]
    assert outputs and all(cell.execution_count is not None for cell in code) and file.stat().st_size < 300_000
    assert not re.search(r"/(home|root|tmp|work|Users)/", str(outputs))
    assert notebook.cells[0].cell_type == "markdown" and notebook.cells[0].source.startswith("# ")


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_takes_from_cp_its_public_names_alone_and_ends_in_what_it_claims(name: str) -> None:
    cells = code_of(name)
    tree = ast.parse("\n".join(cells))
    imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom | ast.Import)]
    ours = [ast.unparse(node) for node in imported if "compplan" in ast.unparse(node)]
    assert ours[0] == "import compplan as cp"
    assert len(ours) == 1 or name not in STUDIES
    for line in ours[1:]:  # what is not among the public names comes from its module
        assert re.fullmatch(r"from compplan\.[\w.]+ import .+", line)
        assert not set(re.findall(r"\w+", line.partition(" import ")[2])) & set(cp.__all__)
    used = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "cp"
    }
    assert used and used <= set(cp.__all__)
    assert any(isinstance(node, ast.Assert) for node in ast.walk(ast.parse(cells[-1])))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_and_holds_what_it_claims(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from nbclient import NotebookClient

    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    notebook = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)
    place = {"metadata": {"path": str(ROOT / "notebooks")}}
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources=place).execute()
