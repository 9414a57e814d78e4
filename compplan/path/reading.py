"""Read a toolpath from a file: a CSV table, or a CAM file through its reader."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from compplan.files.tables import read_table
from compplan.path.cam import read_cam, refuse_idle
from compplan.path.cam.options import CamTable
from compplan.path.toolpath import COLUMNS, Toolpath, check_toolpath, toolpath_from_table


def read_toolpath(path: str | Path, *, cam: CamTable | None = None, feed: float | None = None) -> Toolpath:
    """Read a toolpath: a CSV table, or a CAM file (`compplan.path.cam.READERS`).

    Args:
        path: The file; its suffix says what it is.
        cam: What a CAM file does not say by itself.
        feed: Feed of cutting moves in place of the file's own. [m/s]

    Returns:
        The toolpath in the part frame; its notes say what was assumed or read past.

    Raises:
        InputError: With file and line, if the file is not what it has to be.

    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        return toolpath_from_table(read_table(path, COLUMNS), feed=feed)
    return check_toolpath(_set_feed(refuse_idle(read_cam(path, cam)), feed))


def _set_feed(toolpath: Toolpath, feed: float | None) -> Toolpath:
    return toolpath if feed is None else replace(toolpath, feed=np.where(toolpath.rapid, toolpath.feed, feed))
