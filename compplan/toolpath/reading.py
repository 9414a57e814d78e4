"""Read a toolpath from a CSV table, a CAM file or columns in memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.in_memory import take_table
from compplan.io.tables import read_table
from compplan.toolpath.operations import select_operation
from compplan.toolpath.readers import read_cam, refuse_idle
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.toolpath import COLUMNS, Toolpath, check_toolpath, toolpath_from_table


def read_toolpath(source: Any, *, cam: CamTable | None = None, feed: float | None = None) -> Toolpath:
    """Read a toolpath in the part frame; its notes list assumptions and skipped statements.

    Args:
        source: A CSV table or a CAM file (`compplan.toolpath.readers.READERS`); or the columns of such a table, with
            units in their names: `{"position_mm": array of shape (n, 3), "feed_mm_s": 20.0}`; or a toolpath.
        cam: Options that a CAM file does not state.
        feed: Feed of cutting moves that replaces the feed of the file. [m/s]

    Raises:
        InputError: With file and line, if the file is invalid.

    """
    if isinstance(source, Toolpath):
        return _set_feed(source, feed)
    if not isinstance(source, str | Path):
        return toolpath_from_table(take_table(source, COLUMNS, what="toolpath"), feed=feed)
    path = Path(source)
    if path.suffix.lower() == ".csv":
        return toolpath_from_table(read_table(path, COLUMNS), feed=feed)
    toolpath = _set_feed(refuse_idle(read_cam(path, cam)), feed)
    number = None if cam is None else cam.operation
    return check_toolpath(toolpath if number is None else select_operation(toolpath, number))


def _set_feed(toolpath: Toolpath, feed: float | None) -> Toolpath:
    return toolpath if feed is None else replace(toolpath, feed=np.where(toolpath.rapid, toolpath.feed, feed))
