"""Force model with the wrench columns of the toolpath file."""

from __future__ import annotations

from typing import Literal

from compplan.toolpath.contact import ForceTable

words = "wrench columns of the toolpath file"


class ColumnsProcess(ForceTable):
    """The wrench columns of the toolpath file, part axes; zero if the file has none and `required` is false."""

    model: Literal["columns"] = "columns"
    required: bool = True


table = ColumnsProcess
