"""Run every notebook and keep its last picture for the gallery: `python docs/draw_gallery.py [NAME ...]`."""

from __future__ import annotations

import base64
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[1]


def draw_notebook(name: str) -> Path:
    """Run a notebook and write its last picture to docs/gallery."""
    notebook = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)
    place = {"metadata": {"path": str(ROOT / "notebooks")}}
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources=place).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    pictures = [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    file = ROOT / "docs" / "gallery" / f"{name}.png"
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(base64.b64decode(pictures[-1]))
    return file


if __name__ == "__main__":
    for chosen in sys.argv[1:] or sorted(file.stem for file in (ROOT / "notebooks").glob("*.ipynb")):
        print(draw_notebook(chosen))
