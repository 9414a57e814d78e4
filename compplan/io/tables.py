"""CSV files with units in their column names, read to SI arrays and written atomically.

A reader lists the columns it knows as `FileColumn`s (`compplan.io.columns`); `read_table` returns SI arrays by key, or
raises an InputError with file and line.
"""

from __future__ import annotations

import csv
import json
import re
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError, ShapeError
from compplan.io.columns import UNITS, FileColumn, match_columns
from compplan.io.parsing import GREATEST, guard_parser
from compplan.io.provenance import note_input
from compplan.io.transaction import replace_file

Array = NDArray[np.float64]
#: Greatest size of a text file. [bytes]
MOST_BYTES = 512 * 2**20
#: Surrogates of bytes of a path that are not UTF-8.
NO_LETTER = re.compile("[\ud800-\udfff]")


#: A number with a decimal comma.
COMMA = re.compile(r"\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*")


@dataclass(frozen=True)
class Table:
    """The columns of one file in SI."""

    file: Path  #: The file.
    values: Mapping[str, Array]  #: Number columns by key, in SI; NaN is a missing value. Shape (n,) each.
    text: Mapping[str, NDArray[np.str_]]  #: Text columns by key; "" is a missing value. Shape (n,) each.
    headers: Mapping[str, str]  #: Title in the file, by key.
    units: Mapping[str, str]  #: Unit in the file by key, or "".
    lines: NDArray[np.int64]  #: Line of each row in the file, counted from 1. Shape (n,).
    notes: tuple[str, ...] = field(default=())  #: Ignored parts, one sentence each.

    def __post_init__(self) -> None:
        """Refuse implausibly large numbers.

        Raises:
            InputError: With the first such row.

        """
        for key, column in self.values.items():
            size = np.abs(column) / (UNITS[unit][1] if (unit := self.units.get(key, "")) else 1.0)
            if size.max(initial=0.0, where=np.isfinite(size)) > GREATEST:
                row = int(np.flatnonzero(size > GREATEST)[0])
                message = f"column '{self.headers[key]}' is {size[row]:.3g} in size, at most {GREATEST:g} is read"
                raise self.error(message, row)

    def __len__(self) -> int:
        return len(self.lines)

    def __contains__(self, key: str) -> bool:
        return key in self.headers

    def stack(self, keys: Sequence[str]) -> Array:
        """Return several number columns side by side. Shape (n, len(keys)) [SI]."""
        return np.column_stack([self.values[key] for key in keys]) if keys else np.empty((len(self), 0))

    def numbered(self, name: str) -> list[str]:
        """Return the keys of a numbered column in order: `table.numbered("q#")` is ["q1", "q2", ...].

        Raises:
            InputError: If a number between the first and the last is left out.

        """
        pattern = re.compile(re.escape(name).replace(r"\#", "#").replace("#", r"(\d+)") + "$")
        found = {int(match.group(1)): key for key in self.headers if (match := pattern.match(key))}
        for number in range(1, max(found, default=0) + 1):
            if number not in found:
                raise self.error(f"missing column {name.replace('#', str(number))}: the columns {name} count from 1")
        return [found[number] for number in sorted(found)]

    def error(self, message: str, row: int | None = None) -> InputError:
        """Return an InputError at a row (counted from 0) of this file, or at its header."""
        return InputError(message, file=self.file, where=1 if row is None else int(self.lines[row]))


def read_table(
    path: str | Path, columns: Sequence[FileColumn], *, unknown: str = "refuse",
    rename: Callable[[str], str] | None = None,
) -> Table:  # fmt: skip
    """Read a CSV file whose column names carry units.

    Blank lines and lines that begin with # are skipped. An empty field, or nan, is a missing value.

    Args:
        path: The file.
        columns: The columns that the table may have.
        unknown: "refuse" columns that are not in `columns`, or "note" them in `Table.notes`.
        rename: Maps titles of another program's export to ours; fields of such an export may be separated by
            semicolons (also with decimal commas), tabs or spaces.

    Returns:
        The table in SI.

    Raises:
        InputError: With file and line, if the file cannot be read, a required column is missing, a column occurs twice
            or has no or a wrong unit, a row has too few or too many fields, a field is not a finite number, or a field
            is empty where no value may be missing.

    """
    path = Path(path)
    numbers = all(column.dimension != "text" for column in columns)
    line, header, cells, lines = _read_rows(path, rename is not None, numbers)
    return build_table(path, line, header, cells, lines, columns, unknown, rename)


def build_table(
    path: Path, line: int, header: list[str], cells: Sequence[Any], lines: NDArray[np.int64],
    columns: Sequence[FileColumn], unknown: str, rename: Callable[[str], str] | None = None,
) -> Table:  # fmt: skip
    """Build a table from the cells of each column, text or numbers.

    path, line: file and line of the header, for messages; lines: line of each row. Shape (n,). See `read_table`.
    """
    matched, notes = match_columns(
        path, line, [rename(name) for name in header] if rename else header, columns, unknown
    )
    values: dict[str, Array] = {}
    text: dict[str, NDArray[np.str_]] = {}
    for key, (index, column, unit) in matched.items():
        if column.dimension == "text":
            text[key] = np.array([str(cell).strip() for cell in cells[index]], dtype=np.str_)
            continue
        numbers = _parse_numbers(path, header[index], cells[index], lines)
        if not column.missing and np.isnan(numbers).any():
            row = int(np.flatnonzero(np.isnan(numbers))[0])
            message = f"column '{header[index]}' is empty (or NaN) here; every row needs a number"
            raise InputError(message, file=path, where=int(lines[row]))
        values[key] = numbers * UNITS[unit][1] if unit else numbers
    headers = {key: header[index] for key, (index, _, _) in matched.items()}
    units = {key: unit for key, (_, _, unit) in matched.items()}
    return Table(path, values, text, headers, units, lines, tuple(notes))


#: Line of the header, the header, the cells of each column, and the line of each row.
Cells = tuple[int, list[str], Sequence[Any], NDArray[np.int64]]


def _read_rows(path: Path, exported: bool, numbers: bool) -> Cells:
    """Read a table, which may hold only numbers; refuse ragged rows."""
    content = read_text(path)
    text_lines = content.splitlines()
    if numbers and content.isascii() and (plain := _read_numbers(text_lines)) is not None:
        return plain
    head = next((line for line in text_lines if line.strip() and line.lstrip()[0] != "#"), "")
    mark = next((mark for mark in ";\t, " if mark in head), ",") if exported else ","
    reader = csv.reader(text_lines, delimiter=mark)
    header: list[str] = []
    header_line = 0
    rows: list[list[str]] = []
    lines: list[int] = []
    for row in _split_rows(reader, path):
        if not row or row[0].lstrip().startswith("#") or (len(row) == 1 and not row[0].strip()):
            continue
        if not header:
            header, header_line = [name.strip() for name in row], reader.line_num
            if len(header) > 1 and not header[-1] and exported:  # a separator after the last field
                header.pop()
            if len(header) == 1 and ";" in header[0]:
                raise InputError("fields are separated by ';', expected ','", file=path, where=header_line)
            continue
        if len(row) == len(header) + 1 and not row[-1].strip() and exported:
            row.pop()
        if mark == ";":
            row = [field.replace(",", ".") if COMMA.fullmatch(field) else field for field in row]
        if len(row) != len(header):
            message = f"row has {len(row)} fields, the header has {len(header)}"
            raise InputError(message, file=path, where=reader.line_num)
        rows.append(row)
        lines.append(reader.line_num)
    if not header:
        raise InputError("the file is empty, expected a header line with column names", file=path, where=1)
    cells = list(zip(*rows, strict=True)) if rows else [()] * len(header)
    return header_line, header, cells, np.array(lines, dtype=np.int64)


def _read_numbers(text_lines: list[str]) -> Cells | None:
    """Read a table with a number in every field, without remarks and blank lines; None for any other table."""
    if len(text_lines) < 2 or set(text_lines[0]) & set('#";'):
        return None
    header = [name.strip() for name in text_lines[0].split(",")]
    try:
        grid = np.loadtxt(text_lines[1:], delimiter=",", ndmin=2, comments=None)
    except ValueError:  # `_read_rows` states the line
        return None
    whole = grid.shape == (len(text_lines) - 1, len(header)) and bool(np.isfinite(grid).all())
    return (1, header, list(grid.T), np.arange(2, 2 + len(grid))) if whole else None


def _split_rows(reader: Any, path: Path) -> Iterator[list[str]]:
    """Yield the rows of a CSV reader."""
    with guard_parser(path, "is not a table", lambda: int(reader.line_num) + 1):
        yield from reader


def _parse_numbers(path: Path, title: str, cells: Sequence[Any], lines: NDArray[np.int64]) -> Array:
    """Return cells as numbers, NaN for empty ones. Shape (n,)."""
    try:
        if isinstance(cells, np.ndarray):
            numbers = cells.astype(np.float64)
        elif not is_plain("".join(cells)):
            raise ValueError
        else:
            numbers = np.array([float(cell or "nan") for cell in cells])
    except (TypeError, ValueError):
        rows = zip(cells, lines.tolist(), strict=True)
        numbers = np.array([_parse_number(path, title, str(cell), line) for cell, line in rows])
    if np.isinf(numbers).any():
        row = int(np.flatnonzero(np.isinf(numbers))[0])
        message = f"column '{title}' is infinite here; expected a finite number"
        raise InputError(message, file=path, where=int(lines[row]))
    return numbers


def _parse_number(path: Path, title: str, text: str, line: int) -> float:
    try:
        if not is_plain(text):
            raise ValueError
        return float(text) if text.strip() else np.nan
    except ValueError:
        message = f"column '{title}' holds {text.strip()!r}, expected a number with a decimal point"
        raise InputError(message, file=path, where=line) from None


def is_plain(text: str) -> bool:
    """Return whether a text has only ASCII digits and no underscores as in 1_000."""
    return text.isascii() and "_" not in text


def read_text(path: str | Path) -> str:
    """Read a text file as UTF-8, or as Latin-1 if it is not UTF-8.

    Raises:
        InputError: If there is no such file, or it is a folder, a binary file or too large.

    """
    path = Path(path)
    try:
        kind, size = path.stat().st_mode, path.stat().st_size
        if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
            raise InputError("is a device or a pipe, expected a file", file=path)
        if size > MOST_BYTES:
            raise InputError(f"holds {size / 2**20:.0f} MB, at most {MOST_BYTES >> 20} MB are read", file=path)
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", file=path) from None
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or error}", file=path) from None
    note_input(path, content)
    if b"\0" in content[:4096]:
        raise InputError("is a binary file, expected text", file=path, where=1)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def write_text(path: str | Path, text: str, *, encoding: str = "utf-8", newline: str = "\n") -> None:
    """Write a text file atomically with the given line ends.

    Raises:
        InputError: If the folder cannot be written.

    """
    with replace_file(path) as part:
        part.write_bytes(escape_bytes(text).replace("\n", newline).encode(encoding))


def escape_bytes(text: str) -> str:
    r"""Return a text with non-UTF-8 bytes of a path as escapes such as \xe9."""
    return text if text.isascii() else NO_LETTER.sub(lambda found: f"\\x{ord(found[0]) & 0xFF:02x}", text)


def write_json(path: str | Path, content: Any, *, indent: int | None = 1) -> None:
    """Write a JSON file atomically; see `dump_json`.

    Raises:
        InputError: If the folder cannot be written.

    """
    write_text(path, dump_json(content, indent=indent) + "\n")


def dump_json(content: Any, *, indent: int | None = None) -> str:
    """Return strict JSON: arrays as lists, null for non-finite numbers."""
    return json.dumps(_to_plain(content), indent=indent, allow_nan=False, separators=None if indent else (", ", ": "))


def _to_plain(content: Any) -> Any:
    """Convert a value to dictionaries, lists, text and finite numbers."""
    if isinstance(content, Mapping):
        return {escape_bytes(str(key)): _to_plain(value) for key, value in content.items()}
    if isinstance(content, str):
        return escape_bytes(content)
    if isinstance(content, np.ndarray | np.generic):
        return _to_plain(content.tolist())
    if isinstance(content, list | tuple):
        return [_to_plain(value) for value in content]
    if isinstance(content, float) and not np.isfinite(content):
        return None
    return content


def write_table(path: str | Path, columns: Mapping[str, object], *, decimals: int = 9) -> None:
    """Write a CSV file atomically.

    Args:
        path: The file.
        columns: Values by column name, already in the unit that the name carries (see `to_unit`). Shape (n,) each.
        decimals: Digits after the point that numbers are rounded to. NaN is written as an empty field.

    Raises:
        InputError: If the folder cannot be written.
        ShapeError: If the columns differ in length.

    """
    cells = [_format_cells(np.asarray(values), decimals) for values in columns.values()]
    lengths = {name: len(column) for name, column in zip(columns, cells, strict=True)}
    if len(set(lengths.values())) > 1:
        raise ShapeError(f"table columns differ in length: {lengths}")
    body = "\n".join(map(",".join, zip(*cells, strict=True)))
    write_text(path, ",".join(columns) + "\n" + (body + "\n" if body else ""))


def _format_cells(values: NDArray[Any], decimals: int) -> list[str]:
    """Return one column as text."""
    if values.dtype.kind == "f":
        rounded = np.round(values, decimals) + 0.0  # + 0.0 makes -0 a 0
        if len(rounded) and (rounded == rounded[0]).all():
            return [f"{float(rounded[0]):.15g}"] * len(rounded)
        texts = ("%.15g\n" * len(rounded) % tuple(rounded.tolist())).split("\n")[:-1]
        return [text if text != "nan" else "" for text in texts] if np.isnan(rounded).any() else texts
    if values.dtype.kind == "b":
        return [str(int(value)) for value in values.tolist()]
    texts = [str(value) for value in values.tolist()]
    return ['"' + text.replace('"', '""') + '"' if set(text) & set('",\n\r') else text for text in texts]
