"""Read the tables of bad inputs: each entry is one edit of the good workspace, and the answer that it deserves.

An entry of `tests/bad_inputs/*.toml`:

    [[bad]]
    run    = "plan"                 # a line of COMMANDS; a list gives one case each
    args   = "--json"               # further words of the command line
    file   = "job.toml"             # the file that is edited; default: the file of the table
    status = 2                      # or a list of them
    says   = "tolerance_mm"         # regular expression that the one line must match, case aside; KEY: the key edited

and one edit (every list of these gives one case an item; `to` combines with all of them):

    set     = "plan.tolerance_mm", to = "-1"       key of a TOML file, raw TOML
    drop    = "plan.tolerance_mm"                  key of a TOML file
    attr    = "joint[2]/limit@lower", to = "3"     attribute of a URDF (ElementTree path)
    remove  = "joint[2]/limit"                     element of a URDF
    insert  = "joint[2]", to = "<axis/>"           element appended there
    column  = "q1_deg", to = "x", row = 3          field of a CSV file (rows from 0; none: every row)
    scale   = 25.4, column = "x_mm y_mm z_mm"      columns multiplied
    rename  = "q1_deg", to = "q1"                  column of a CSV file
    cut     = "q1_deg"                             column taken out
    rows    = 1                                    first rows kept
    replace = "old", to = "new"                    text
    text    = "..."                                the whole file
    bytes   = "00ff"                               the whole file, in hexadecimal digits
    repeat  = ["piece", 100000], head = "", tail = ""     the whole file: head, the piece many times, tail
    delete  = true                                 no such file
    folder  = true                                 a folder of that name
    encode  = "utf-16"                             the good file in another encoding
    link    = "/dev/zero"                          a symbolic link in its place, to whatever is named
    pipe    = true                                 a named pipe in its place, which nobody writes
    sparse  = 3e9                                  a file of so many bytes, all zero, that takes no room
    mode    = "000"                                permissions taken away; the command runs as nobody
    disk    = 600                                  no file may grow beyond so many bytes, as on a full disk
    none                                           the command line alone is at fault
"""

from __future__ import annotations

import itertools
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[2] / "tests" / "bad_inputs"
GOOD = FOLDER / "good"
COMMANDS = {
    "plan": "plan job.toml --out out",
    "compare": "compare job.toml --out out",
    "place": "place job.toml --out out",
    "forces": "forces job.toml --out out",
    "montecarlo": "montecarlo job.toml --samples 16 --workers 1 --no-sensitivity --out out",
    "map": "map robot --points 5 --out out",
    "predict": "predict log.csv --robot robot --out out.csv",
    "identify": "identify log.csv --robot robot --out out",
    "diagnose": "diagnose log.csv --robot robot --out out",
    "convert": "convert part.gcode --out out.csv",
    "convert apt": "convert part.apt --out out.csv",
    "post": "post part.gcode --robot robot --part 1700,0,900 --program krl --out out",
    "post apt": "post part.apt --robot robot --part 1700,0,900 --program krl --out out",
    "reproduce": "reproduce dumas2011 --out out",
    "doctor": "doctor robot",
    "doctor log": "doctor log.csv --robot robot",
    "campaign": "campaign job.toml --poses 3 --out out",
    "learn": "learn job.toml measured.csv --robot robot --out out",
    "mill": "forces mill.toml --out out",
    "mill log": "forces mill.toml --log cutting.csv --out out",
    "mill plan": "plan mill.toml --out out",
    "init": "init new.toml",
    "init log": "init log --robot robot --out new.csv",
    "init robot": "init robot robot/robot.urdf --out new",
    "": "",
}
EDITS = (
    "set", "drop", "attr", "remove", "insert", "column", "rename", "cut", "rows", "replace", "text", "bytes", "repeat",
    "delete", "folder", "encode", "link", "pipe", "sparse", "mode", "disk",
)  # fmt: skip
ALTERNATIVES = ("run", "args", "file", "to", "row", "scale", *(edit for edit in EDITS if edit != "repeat"))
KNOWN = {*ALTERNATIVES, "repeat", "head", "tail", "status", "says", "robot"}


@dataclass(frozen=True)
class BadInput:
    """One bad input: the command, the edit, and the answer it deserves."""

    name: str
    table: str
    command: str
    edit: Mapping[str, Any]
    status: tuple[int, ...]
    says: str


def read_tables() -> list[BadInput]:
    """Read every table, in the order of their names."""
    return [case for file in sorted(FOLDER.glob("*.toml")) for case in read_table(file)]


def read_table(file: Path) -> Iterator[BadInput]:
    """Read one table; refuse a key that means nothing, so that no entry is silently empty."""
    content = tomllib.loads(file.read_text(encoding="utf-8"))
    defaults = content.get("defaults", {})
    for number, given in enumerate(content["bad"]):
        entry = {**defaults, **given}
        if wrong := set(entry) - KNOWN:
            raise ValueError(f"{file.name}, entry {number}: unknown keys {sorted(wrong)}")
        if not set(given) & {"args", *EDITS}:
            raise ValueError(f"{file.name}, entry {number}: nothing is bad about it")
        varied = [key for key in ALTERNATIVES if isinstance(entry.get(key), list)]
        for chosen in itertools.product(*(entry[key] for key in varied)):
            yield _make_case(file.stem, number, {**entry, **dict(zip(varied, chosen, strict=True))})


def _make_case(table: str, number: int, entry: Mapping[str, Any]) -> BadInput:
    edit = {key: value for key, value in entry.items() if key not in ("run", "args", "status", "says")}
    command = f"{COMMANDS[entry.get('run', '')]} {entry.get('args', '')}".strip()
    status = entry.get("status", 2)
    said = [f"{key}={edit[key]}" for key in (*EDITS, "row", "to") if key in edit]
    words = [f"{table}[{number}]", entry.get("run", ""), *said]
    name = " ".join(" ".join(str(word)[:60] for word in [*words, entry.get("args", "")]).split())
    key = str(next((edit[name] for name in ("set", "drop", "column", "cut", "rename") if name in edit), ""))
    says = str(entry.get("says", "")).replace("KEY", re.escape(re.split(r"[. ]", key)[-1]))
    return BadInput(name, table, command, edit, tuple(status if isinstance(status, list) else [status]), says)
