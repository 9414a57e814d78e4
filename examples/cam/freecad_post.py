"""A FreeCAD CAM (Path) post-processor that corrects the program with compplan.

Copy the file as compplan_post.py into FreeCAD's macro folder, install compplan in FreeCAD's Python, choose the
processor `compplan` in the job's output, and give the arguments there:

    --robot kuka_kr240 --part 1800,0,700 --program krl --tool tool.toml --process process.toml

FreeCAD calls `export` with the objects of the job; their moves, tool calls and feeds go to `compplan.post` as G-code in
mm and mm/min. The corrected programs stand in FILE_corrected, from where the controller takes them; their text, one
file after the other, is written to FILE and returned. Tried in FreeCAD 0.20.2 on the outline of a box
(tests/controllers/test_cam_posts.py).
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import compplan as cp

TOOLTIP = "Correct the path for the bending of the robot with compplan"
UNITS = "G21"
#: Words that are lengths, angles or counts and stay as they are; FreeCAD gives feeds in mm/s.
LETTERS = "XYZABCIJKRQPLTSDH"
#: Results that are not programs, by name and by ending.
NO_PROGRAM, NO_PROGRAM_ENDINGS = ("joints.csv", "deviation.csv"), (".json", ".html", ".npz")


def list_commands(objects: list[Any]) -> Iterator[Any]:
    """List the commands of the objects in order; groups and compounds hold further objects."""
    for item in objects:
        if hasattr(item, "Group"):
            yield from list_commands(item.Group)
        elif hasattr(item, "Path") and getattr(item, "Active", True):
            yield from item.Path.Commands


def write_line(command: Any) -> str:
    """Return a command as a line of G-code; comments are kept as they are."""
    if command.Name.startswith("("):
        return str(command.Name)
    words = [command.Name]
    for letter, value in command.Parameters.items():
        if letter == "F":
            if value > 0.0:
                words.append(f"F{60.0 * value:.4f}")
        elif letter in LETTERS:
            words.append(f"{letter}{int(value)}" if letter in "TSDH" else f"{letter}{value:.6f}")
    return " ".join(words)


def read_arguments(text: str) -> argparse.Namespace:
    """Read the arguments of the job's output.

    Raises:
        ValueError: If one is missing or unknown.
    """
    parser = argparse.ArgumentParser(prog="compplan_post", exit_on_error=False)
    for name in ("robot", "part", "program"):
        parser.add_argument(f"--{name}", required=True)
    for name in ("tool", "tools", "process", "plan", "output", "cam"):
        parser.add_argument(f"--{name}")
    try:
        known, unknown = parser.parse_known_args(shlex.split(text))
    except (argparse.ArgumentError, SystemExit) as error:
        raise ValueError(f"arguments of the post-processor: {error}") from None
    if unknown:
        raise ValueError(f"arguments of the post-processor: {' '.join(unknown)} is not known")
    return known


def export(objectslist: list[Any], filename: str, argstring: str) -> str:
    """Write the corrected programs and return their text; G-code, plan and report stand beside them.

    Raises:
        ValueError: If an argument is missing.
        compplan.CompplanError: If the path cannot be planned as it is asked for.
    """
    options = vars(read_arguments(argstring))
    target = Path(filename)
    folder = target.with_name(f"{target.stem}_corrected")
    lines = ["G21 G17 G90 G94", *map(write_line, list_commands(objectslist)), "M30", ""]
    path = target.with_name(f"{target.stem}.nc")
    path.write_text("\n".join(lines), encoding="utf-8")
    part = options.pop("part")
    numbers = part if part.endswith(".toml") else [float(word) for word in part.split(",")]
    posted = cp.post(path, part=numbers, out=folder, **options)
    if posted.status != "solved":
        raise cp.InfeasibleError(f"{posted.status}: see {folder / 'report.html'}")
    programs = [file for file in posted.files if file.name not in NO_PROGRAM and file.suffix not in NO_PROGRAM_ENDINGS]
    text = "\n".join(f"; {file.name}\n{file.read_text(encoding='utf-8')}" for file in programs)
    if filename not in ("", "-"):
        target.write_text(text, encoding="utf-8")
    return text
