"""Rows of a log that were pasted again: they measure nothing anew, and would narrow every interval."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Table


def find_pasted(table: Table) -> NDArray[np.bool_]:
    """Find the rows that say what an earlier row says, in every column.

    Where the log has a clock, two rows that agree in time and in all that was read are one. Without a clock a repeated
    measurement may agree by chance, as rounded readings do; then only a log that repeats itself whole counts as pasted.

    Args:
        table: The log as it was read.

    Returns:
        Shape (n,).
    """
    n = len(table)
    columns = [table.values[key] for key in table.values] + [_number(table.text[key]) for key in table.text]
    if n < 2 or not columns:
        return np.zeros(n, bool)
    rows = np.nan_to_num(np.column_stack(columns).astype(float), nan=np.inf)
    pasted = np.ones(n, bool)
    if "time" in table and np.ptp(table.values["time"]) > 0.0:
        pasted[np.unique(rows, axis=0, return_index=True)[1]] = False
        return pasted
    periods = [n // times for times in range(n // 2, 1, -1) if n % times == 0 and n // times > 1]
    whole = next((period for period in periods if (rows == np.tile(rows[:period], (n // period, 1))).all()), n)
    pasted[:whole] = False
    return pasted


def _number(labels: NDArray[np.str_]) -> NDArray[np.int_]:
    return np.unique(labels, return_inverse=True)[1]
