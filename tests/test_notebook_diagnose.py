"""The notebook of a diagnosis runs and tells what it should: cause named, gap closed, path closer when planned anew."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


@pytest.fixture(scope="module")
def told() -> str:
    """Run the notebook and return what its cells print."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOKS / "diagnose.ipynb", as_version=4)
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(NOTEBOOKS.parent), *([before] if before else [])])
    try:
        place = {"metadata": {"path": NOTEBOOKS}}
        NotebookClient(notebook, timeout=300, kernel_name="python3", resources=place).execute()
    finally:
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    return "\n".join(output["text"] for output in outputs if output.get("name") == "stdout")


def number_after(told: str, pattern: str) -> float:
    found = re.search(pattern + r"\s+(-?[\d.]+)", told)
    assert found, pattern
    return float(found.group(1))


@pytest.mark.slow
def test_both_causes_are_named(told: str) -> None:
    named = re.findall(r"^  (.+): probability (0\.\d+), moves", told, re.M)
    assert {name for name, _ in named} == {"joint_offset joint_2", "joint_stiffness joint_3"}


@pytest.mark.slow
def test_the_later_campaign_is_predicted_down_to_the_noise(told: str) -> None:
    nominal, updated = re.findall(r"later campaign +([\d.]+) +([\d.]+)", told)[0]
    assert float(updated) < 1.1 * number_after(told, "noise floor")
    assert float(nominal) > 10 * float(updated)


@pytest.mark.slow
def test_the_proposed_measurement_leaves_fewer_rivals(told: str) -> None:
    pairs = re.findall(r"before: (.+)\n.*after:  (.+)", told)
    before, after = (["nothing" if text == "nothing" else text for text in side] for side in zip(*pairs, strict=True))

    def count(lists: list[str]) -> int:
        return sum(0 if text == "nothing" else len(text.split(",")) for text in lists)

    assert count(after) < count(before)


@pytest.mark.slow
def test_planning_with_the_updated_robot_shrinks_the_deviation_in_the_cell(told: str) -> None:
    raw = number_after(told, "not corrected")
    nominal = number_after(told, "planned with the nominal robot")
    updated = number_after(told, "planned with the updated robot")
    assert updated < 0.1 * nominal < 0.1 * raw
