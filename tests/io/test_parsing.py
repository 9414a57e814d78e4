"""The one guard of parsers."""

from __future__ import annotations

from pathlib import Path

import pytest

from compplan.errors import InputError
from compplan.io.meshes import open_mesh

SCAN = Path(__file__).parents[1] / "bad_inputs" / "good" / "scan.stl"


def test_a_mesh_that_is_read_in_part_is_refused(tmp_path: Path) -> None:
    text = SCAN.read_text(encoding="utf-8")
    (tmp_path / "scan.stl").write_text(text.replace("vertex 2.500", "vertex 2q.500", 1), encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read as STL"):
        open_mesh(tmp_path / "scan.stl")
