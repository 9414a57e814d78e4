"""Tables in memory: a DataFrame, a mapping of columns, or an array with named fields, units in the names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.io.columns import FileColumn
from compplan.io.tables import Table, build_table, read_table


def open_table(
    source: Any, columns: Sequence[FileColumn], *, what: str, rename: Callable[[str], str] | None = None
) -> Table:
    """Read a table from a file or from memory, noting unknown columns; see `read_table` and `take_table`."""
    if isinstance(source, str | Path):
        return read_table(source, columns, unknown="note", rename=rename)
    return take_table(source, columns, what=what, unknown="note")


def take_table(data: Any, columns: Sequence[FileColumn], *, what: str, unknown: str = "refuse") -> Table:
    """Convert a DataFrame, a mapping of columns, or an array with named fields to a table.

    Column names carry units as in a file. A name may also denote an array of several columns, `position_mm` for
    x_mm y_mm z_mm, `axis` for i j k, `q_deg` for q1_deg .., `force_N`, `moment_Nm` and `orientation_deg`; a single
    number applies to every row.

    Args:
        data: The table.
        columns: The columns that it may have.
        what: Name of the table in messages.
        unknown: "refuse" columns that are not in `columns`, or "note" them in `Table.notes`.

    Returns:
        The table in SI; its lines count rows from 1.

    Raises:
        InputError: As `read_table`.

    """
    given = spread_columns(data, what)
    longest = max((len(column) for column in given.values() if column.ndim), default=0)
    path = Path(f"<{what}>")
    for name, held in given.items():
        if held.ndim > 1 or (held.ndim and len(held) != longest):
            message = f"column '{name}' has shape {held.shape}, expected ({longest},)"
            raise InputError(message, file=path)
    cells = [np.broadcast_to(column, (longest,)) for column in given.values()]
    return build_table(path, 1, list(given), cells, np.arange(1, longest + 1), columns, unknown)


#: Names of array columns, and the names of their parts; {} is the unit.
SIDE_BY_SIDE = {
    "position": ("x{}", "y{}", "z{}"), "axis": ("i", "j", "k"), "force": ("fx{}", "fy{}", "fz{}"),
    "moment": ("mx{}", "my{}", "mz{}"), "orientation": ("rx{}", "ry{}", "rz{}"), "q": (),
}  # fmt: skip


def spread_columns(data: Any, what: str) -> dict[str, NDArray[Any]]:
    """Return the columns of a DataFrame, a mapping or an array with named fields; array columns are split.

    Raises:
        InputError: If the columns have no names, or an array has the wrong number of columns.

    """
    names = getattr(getattr(data, "dtype", None), "names", None) or getattr(data, "columns", None)
    names = list(data) if names is None and isinstance(data, Mapping) else names
    if names is None:
        raise InputError(
            f"{what} is {type(data).__name__} without column names, so without units; give a DataFrame or "
            "{'x_mm': .., 'y_mm': .., 'z_mm': ..}, or {'position_mm': array of shape (n, 3)}"
        )
    given: dict[str, NDArray[Any]] = {}
    for name in map(str, names):
        column = np.asarray(data[name])
        stem = next((s for s in SIDE_BY_SIDE if name == s or name.startswith(f"{s}_")), "")
        unit = name.removeprefix(stem)
        if not stem or column.ndim < 2:
            given[name] = column
            continue
        wide = [form.format(unit) for form in SIDE_BY_SIDE[stem]]
        wide = [f"q{k}{unit}" for k in range(1, column.shape[1] + 1)] if stem == "q" else wide
        if column.ndim != 2 or column.shape[1] != len(wide):
            raise InputError(f"{what}: {name} has shape {column.shape}, expected (n, {len(wide)})")
        given |= {title: column[:, k] for k, title in enumerate(wide)}
    return given
