from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from cam_files import read_cam_text

from compplan.toolpath.readers import CamFile


@pytest.fixture
def read(tmp_path: Path, request: pytest.FixtureRequest) -> Callable[..., CamFile]:
    """Read a text as a file whose ending is given, or the module's SUFFIX."""

    def read_text(text: str, suffix: str = getattr(request.module, "SUFFIX", ".nc"), **options: object) -> CamFile:
        return read_cam_text(tmp_path, text, suffix, **options)

    return read_text
