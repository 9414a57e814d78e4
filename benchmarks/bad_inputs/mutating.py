"""Mutants of the good workspace: robots, logs, jobs and paths with a few faults each, drawn from a seed.

Nobody says what a mutant deserves: it may be taken or refused. It may not end in an internal fault, a signal or a
silent exit, take more time or memory than a case may, leave files where it is refused, or say more than one line then.
Mutant k of seed s is the same whatever other mutants are drawn.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel

from benchmarks.bad_inputs.making import set_key
from benchmarks.bad_inputs.tables import COMMANDS, GOOD, BadInput
from compplan.job.job import Job
from compplan.robot.folder import robot_folders

#: Forms of scans in the good workspace.
SCANS = ("stl", "ply", "xyz", "csv")
#: What each command reads, how often it is drawn, and the files of it that are worth a fault.
TARGETS: dict[str, tuple[int, tuple[str, ...]]] = {
    "plan": (6, ("job.toml", "job.toml", "path.csv", "robot/robot.urdf", "robot/elasticity.toml", "robot/effects.toml",
                 "robot/uncertainty.toml", "robot/controller.toml")),
    "doctor": (6, ("robot/robot.urdf", "robot/elasticity.toml", "robot/controller.toml", "robot/effects.toml")),
    "doctor log": (3, ("log.csv", "robot/registration.toml")),
    "map": (4, ("robot/robot.urdf", "robot/elasticity.toml")),
    "predict": (6, ("log.csv", "robot/robot.urdf", "robot/effects.toml", "robot/registration.toml")),
    "predict register": (4, ("log.csv", "log.csv", "robot/robot.urdf")),
    "identify": (5, ("log.csv", "log.csv", "robot/robot.urdf", "robot/elasticity.toml")),
    "diagnose": (4, ("log.csv", "log.csv", "robot/robot.urdf", "robot/elasticity.toml", "robot/effects.toml")),
    "forces": (3, ("job.toml", "path.csv", "robot/robot.urdf")),
    "mill": (3, ("mill.toml", "part.gcode", "robot/robot.urdf")),
    "mill log": (1, ("cutting.csv", "mill.toml")),
    "convert": (4, ("part.gcode",)),
    "convert apt": (4, ("part.apt",)),
    "compare": (1, ("job.toml", "path.csv", "robot/elasticity.toml")),
    "place": (1, ("job.toml", "robot/robot.urdf")),
    "montecarlo": (1, ("job.toml", "robot/uncertainty.toml")),
    "campaign": (1, ("job.toml", "robot/uncertainty.toml")),
    "learn": (2, ("measured.csv", "measured.csv", "pushed.toml")),
    "init robot": (3, ("robot/robot.urdf",)),
    "post": (1, ("part.gcode", "robot/controller.toml")),
    "tools csv": (1, ("tools.csv", "tools.csv", "two_csv.toml")),
    "tools toml": (1, ("tools.toml", "tools.toml", "two_toml.toml")),
    "tools fusion": (1, ("tools.json", "tools.json", "two_json.toml")),
    "trace": (1, ("executed.csv", "executed.csv", "program.csv")),
    "trace rtde": (1, ("rtde.csv", "rtde.csv", "program.csv")),
    "execute": (1, ("program.csv",)),
    "scan stl": (1, ("scan.stl",)),
    "scan ply": (1, ("scan.ply",)),
    "scan xyz": (1, ("scan.xyz",)),
    "scan csv": (1, ("scan.csv",)),
    "instrument": (1, ("instrument.toml", "touched.csv")),
    "instrument identify": (1, ("instrument.toml", "instrument.toml", "touched.csv")),
    "calibration": (1, ("calibration.conf",)),
    "learned force": (1, ("robot/process.toml", "robot/process.toml", "pushed.toml")),
    "noise": (1, ("noise.toml", "robot/uncertainty.toml", "robot/registration.toml")),
    "init xacro": (1, ("arm.xacro",)),
}  # fmt: skip
LINES = {
    **COMMANDS,
    "predict register": "predict log.csv --robot robot --register base,tool --out out.csv",
    "tools csv": "plan two_csv.toml --out out", "tools toml": "plan two_toml.toml --out out",
    "tools fusion": "plan two_json.toml --out out",
    "trace": "trace executed.csv --program program.csv --robot ur10 --out out",
    "trace rtde": "trace rtde.csv --program program.csv --robot ur10 --out out",
    "execute": "execute program.csv --robot ur10 --out out.csv",
    **{f"scan {form}": f"learn pushed.toml scan.{form} --robot robot --assume-ok --out out" for form in SCANS},
    "instrument": "diagnose touched.csv --robot robot --instrument instrument.toml --out out",
    "instrument identify": "identify touched.csv --robot robot --instrument instrument.toml --out out",
    "calibration": "calibration read calibration.conf --robot ur10e --out out",
    "learn": "learn pushed.toml measured.csv --robot robot --out out",
    "learned force": "plan pushed.toml --out out",
    "noise": "montecarlo noise.toml --samples 16 --workers 1 --no-sensitivity --out out",
    "init xacro": "init robot arm.xacro --out new",
}  # fmt: skip
#: Commands that take any robot: some of their mutants are of a shipped one.
ANY_ROBOT = ("doctor", "map", "init robot", "plan")
#: Numbers and words that stand where a sound one was.
EXTREMES = ("0", "-1", "1", "1e-30", "1e30", "-1e9", "1e308", "5e-324", "nan", "inf", "-inf", "", "1e-9", "1000000",
            "x", "1,5", "0x10", "1_0", "3.14159", "90", "-0.0", "1e999", "\u0661", "true", "[]", "''",
            "1e-300", "1e13")  # fmt: skip
FACTORS = (1e-3, 1e3, 25.4, -1.0, 57.29577951308232, 1e-12, 1e6)
STRANGE = "\0\t\r\n\ufeff\u00e9\u200b\U0001f600\\'\"<&]{#;%"
VALUES = ("0", "-1", "1", "0.5", "1e-12", "1e12", "nan", "inf", "true", "'x'", "''", "[]", "[0.0, 0.0, 0.0]",
          "[1.0, 2.0]", "{}", "100", "3")  # fmt: skip
ELEMENT = re.compile(r"<(\w+)\b[^>]*/>|<(inertial|collision|visual|limit|link|joint)\b[^>]*>.*?</\2>", re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def draw_mutants(count: int, seed: int, *, first: int = 0, targets: Sequence[str] = ()) -> Iterator[BadInput]:
    """Draw mutants.

    Args:
        count: How many.
        seed: Seed of the draw.
        first: Number of the first.
        targets: Names of the targets that are drawn from; empty: all.

    """
    for number in range(first, first + count):
        yield draw_mutant(seed, number, targets)


def draw_mutant(seed: int, number: int, targets: Sequence[str] = ()) -> BadInput:
    """Draw one mutant: a command, one to three faults in one or two of the files that it reads."""
    rng = np.random.default_rng([seed, number])
    names = list(targets or TARGETS)
    weights = np.array([TARGETS[name][0] for name in names], float)
    run = names[int(rng.choice(len(names), p=weights / weights.sum()))]
    contents: dict[str, str] = {}
    told = []
    if run in ANY_ROBOT and rng.random() < 0.3:
        folder = list(robot_folders().values())[int(rng.integers(len(robot_folders())))]
        files = [file for file in folder.iterdir() if file.suffix in (".urdf", ".toml")]
        contents |= {f"robot/{file.name}": file.read_text(encoding="utf-8") for file in files}
        told.append(folder.name)
    for _ in range(int(rng.integers(1, 4))):
        file = TARGETS[run][1][int(rng.integers(len(TARGETS[run][1])))]
        text = contents.get(file)
        text = (GOOD / file).read_text(encoding="utf-8") if text is None else text
        faults = list_faults(file)
        fault = faults[int(rng.integers(len(faults)))]
        contents[file] = fault(rng, text)
        told.append(f"{fault.__name__} {file}")
    name = f"mutant {seed}:{number} {run}: {', '.join(told)}"
    return BadInput(name, "mutants", LINES[run], {"contents": contents}, (0, 2, 3), "")


def list_faults(file: str) -> list[Callable[[np.random.Generator, str], str]]:
    """List the faults that make sense in a file."""
    anywhere = [change_number, change_number, scale_number, drop_line, repeat_line, swap_words, insert_letter, cut_end]
    if file.endswith(".csv"):
        return [*anywhere, *2 * [change_column, repeat_rows, keep_rows, drop_column, swap_columns]]
    if file.endswith((".urdf", ".xacro")):
        return [*anywhere, *2 * [change_attribute, drop_element, repeat_element, change_attribute]]
    if file in ("job.toml", "mill.toml", "pushed.toml") or file.startswith("two_"):
        return [*anywhere, *4 * [set_job_key]]
    return anywhere


def change_number(rng: np.random.Generator, text: str) -> str:
    """Put an extreme where a number stands."""
    return _replace_match(rng, NUMBER, text, lambda old: _pick(rng, EXTREMES))


def scale_number(rng: np.random.Generator, text: str) -> str:
    """Multiply a number, as a wrong unit does."""
    return _replace_match(rng, NUMBER, text, lambda old: repr(float(old) * float(_pick(rng, FACTORS))))


def swap_words(rng: np.random.Generator, text: str) -> str:
    """Put one word of the file where another stands."""
    words = re.findall(r"[A-Za-z_]\w+", text)
    return _replace_match(rng, re.compile(r"[A-Za-z_]\w+"), text, lambda old: _pick(rng, words)) if words else text


def drop_line(rng: np.random.Generator, text: str) -> str:
    """Take a line out."""
    lines = text.splitlines(keepends=True)
    at = int(rng.integers(len(lines) + 1))
    return "".join(lines[:at] + lines[at + 1 :])


def repeat_line(rng: np.random.Generator, text: str) -> str:
    """Write a line twice, or a few lines again at the end."""
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    at = int(rng.integers(len(lines)))
    return "".join([*lines[:at], lines[at], *lines[at:]] if rng.random() < 0.5 else [*lines, *lines[at : at + 5]])


def insert_letter(rng: np.random.Generator, text: str) -> str:
    """Put a strange letter somewhere."""
    at = int(rng.integers(len(text) + 1))
    return text[:at] + _pick(rng, STRANGE) + text[at:]


def cut_end(rng: np.random.Generator, text: str) -> str:
    """End the file anywhere, as a full disk does."""
    return text[: int(rng.integers(len(text) + 1))]


def change_column(rng: np.random.Generator, text: str) -> str:
    """Scale a column, or let all of it hold one value."""
    head, rows = _split(text)
    at, factor = int(rng.integers(len(head))), float(_pick(rng, FACTORS))
    value = _pick(rng, EXTREMES) if rng.random() < 0.5 else None
    for row in rows:
        if at < len(row):
            row[at] = _scaled(row[at], factor) if value is None else value
    return _join(head, rows)


def repeat_rows(rng: np.random.Generator, text: str) -> str:
    """Paste the rows again, or let every row be the same."""
    head, rows = _split(text)
    return _join(head, rows * int(rng.integers(2, 4)) if rng.random() < 0.6 else rows[:1] * len(rows))


def keep_rows(rng: np.random.Generator, text: str) -> str:
    """Keep a few rows, or shuffle them."""
    head, rows = _split(text)
    kept = rng.permutation(len(rows))[: int(rng.integers(0, len(rows) + 1))] if rows else []
    return _join(head, [rows[k] for k in kept])


def drop_column(rng: np.random.Generator, text: str) -> str:
    """Take a column out."""
    head, rows = _split(text)
    at = int(rng.integers(len(head)))
    return _join(head[:at] + head[at + 1 :], [row[:at] + row[at + 1 :] for row in rows])


def swap_columns(rng: np.random.Generator, text: str) -> str:
    """Let two columns change their names."""
    head, rows = _split(text)
    a, b = (int(rng.integers(len(head))) for _ in range(2))
    head[a], head[b] = head[b], head[a]
    return _join(head, rows)


def change_attribute(rng: np.random.Generator, text: str) -> str:
    """Put an extreme, or a value of another attribute, into an attribute of XML."""
    values = re.findall(r'="([^"]*)"', text) or [""]

    def change(old: str) -> str:
        if rng.random() < 0.3:
            return f'="{_pick(rng, values)}"'
        words = old[2:-1].split() or [""]
        words[int(rng.integers(len(words)))] = _pick(rng, EXTREMES).replace('"', "")
        return f'="{" ".join(words)}"'

    return _replace_match(rng, re.compile(r'="[^"]*"'), text, change)


def drop_element(rng: np.random.Generator, text: str) -> str:
    """Take an element of XML out, with what it holds."""
    return _replace_match(rng, ELEMENT, text, lambda old: "")


def repeat_element(rng: np.random.Generator, text: str) -> str:
    """Write an element of XML twice."""
    return _replace_match(rng, ELEMENT, text, lambda old: old + old)


def set_job_key(rng: np.random.Generator, text: str) -> str:
    """Set a key that a job may have to a value that it may not."""
    keys = list(_list_keys(Job, ""))
    try:
        return set_key(text, _pick(rng, keys), _pick(rng, VALUES))
    except ValueError:
        return text


def _list_keys(model: type[BaseModel], prefix: str) -> Iterator[str]:
    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        tables = [part for part in _parts(field.annotation) if isinstance(part, type) and issubclass(part, BaseModel)]
        yield key
        for table in tables if prefix.count(".") < 2 else ():
            yield from _list_keys(table, f"{key}.")


def _parts(annotation: Any) -> list[Any]:
    return [annotation, *(part for argument in get_args(annotation) for part in _parts(argument))]


def _pick(rng: np.random.Generator, choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


def _replace_match(rng: np.random.Generator, pattern: re.Pattern[str], text: str, change: Callable[[str], str]) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text
    place = found[int(rng.integers(len(found)))]
    return text[: place.start()] + change(place[0]) + text[place.end() :]


def _split(text: str) -> tuple[list[str], list[list[str]]]:
    lines = [line.split(",") for line in text.splitlines() if line.strip()] or [[""]]
    return lines[0], lines[1:]


def _join(head: list[str], rows: list[list[str]]) -> str:
    return "\n".join(",".join(row) for row in [head, *rows]) + "\n"


def _scaled(value: str, factor: float) -> str:
    try:
        return repr(float(value) * factor)
    except ValueError:
        return value
