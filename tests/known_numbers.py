"""The numbers of the diagnosis: what each is for, and which known campaigns see it at twice and at half its value.

`python tests/known_numbers.py study N` moves N of them, drawn at random, (all without N; or those named) and notes in
tests/known_numbers.json which campaign sees each move first; `table` writes docs/concepts/diagnosis_numbers.md.
"""

from __future__ import annotations

import ast
import importlib
import json
import re
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from known_campaigns import CAMPAIGNS, diagnose_known, differences

import compplan.diagnose

ROOM = Path(compplan.diagnose.__file__).parent
SEEN = Path(__file__).parent / "known_numbers.json"
TABLE = ROOM.parent.parent / "docs" / "concepts" / "diagnosis_numbers.md"
#: Shares near one are moved by what they lack of it.
SHARES = ("LEVEL", "SURE", "WITHIN", "MOST_SURE", "MOST_OF_IT", "doubt.ambiguity.ALIKE")
#: Campaigns that are asked of one move at most, and those that are asked first, by the beginning of a module's name.
ASKED = 4
FIRST = {
    "data.conventions": ["a coupled wrist", "counted backwards", "pushed the wrong way"],
    "data.noise": ["met again, nothing stated", "errors of no effect", "play seen by encoders", "late on a path"],
    "data.outliers": ["two causes and a typing error"],
    "data.questions": [name for name, known in CAMPAIGNS.items() if known.mistake],
    "data.signs": ["pushed the wrong way"],
    "answer.measurement_moves": ["another clock", "pushed the wrong way", "warming up"],
    "ledger.unmodelled": ["late on a path", "errors of no effect"],
    "ledger.proposals": ["a gear", "a jump", "errors of no effect"],
    "doubt.gears": ["a gear"],
    "answer.calibration": ["base and tool unknown"],
    "answer.verdict": ["nothing", "a zero near the noise", "errors of no effect"],
    "": ["met again, nothing stated", "errors of no effect", "a zero near the noise", "base and tool unknown",
         "a cause beside errors of no effect"],
}  # fmt: skip


@dataclass(frozen=True)
class Number:
    """A number at the head of a module of the diagnosis.

    Attributes:
        module: Its module.
        name: Its name.
        value: Its value, as written.
        reason: The comment over it.
    """

    module: str
    name: str
    value: str
    reason: str

    @property
    def short(self) -> str:
        """Return module and name without the package."""
        return f"{self.module.removeprefix('compplan.diagnose.')}.{self.name}"

    @property
    def near_one(self) -> bool:
        """Tell whether it is a share near one."""
        return self.name in SHARES or self.short in SHARES


def list_numbers() -> list[Number]:
    """List the numbers, without those that follow from others."""
    found = []
    for path in sorted(ROOM.rglob("*.py")):
        module, text = ".".join(path.relative_to(ROOM.parent.parent).with_suffix("").parts), path.read_text()
        for node in ast.parse(text).body:
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            names = [n.id for n in ast.walk(target) if isinstance(n, ast.Name)]
            together = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            values = node.value.elts if together else [node.value]
            reason = _comment_over(text.splitlines(), node.lineno)
            pairs = [(n, v) for n, v in zip(names, values, strict=True) if _is_number(v)]
            found += [Number(module, name, ast.unparse(value), reason) for name, value in pairs]
    return found


def _is_number(value: ast.expr) -> bool:
    numbers = [n for n in ast.walk(value) if isinstance(n, ast.Constant) and type(n.value) in (int, float)]
    follows = [n for n in ast.walk(value) if isinstance(n, ast.Name) and n.id.isupper()]
    return bool(numbers) and not follows


def _comment_over(lines: Sequence[str], number: int) -> str:
    start = number - 1
    while lines[start - 1].startswith("#:"):
        start -= 1
    return " ".join(line.removeprefix("#:").strip() for line in lines[start : number - 1])


def scale(value: Any, factor: float) -> Any:
    """Multiply every number of a value; counts stay whole and above zero."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return max(round(value * factor), 1) if value else value
    if isinstance(value, float | np.ndarray):
        return value * factor
    if isinstance(value, tuple):
        return tuple(scale(entry, factor) for entry in value)
    if isinstance(value, dict):
        return {key if isinstance(key, str) else key * factor: scale(entry, factor) for key, entry in value.items()}
    return value


@contextmanager
def moved(number: Number, factor: float) -> Iterator[None]:
    """Multiply a number of the diagnosis wherever the package holds it, defaults of arguments included."""
    home = importlib.import_module(number.module)
    old = getattr(home, number.name)
    new = 1.0 - factor * (1.0 - old) if number.near_one else scale(old, factor)
    package = [m for key, m in list(sys.modules.items()) if key.startswith("compplan")]
    holders = [m for m in [*package, sys.modules["known_campaigns"]] if vars(m).get(number.name) is old]
    functions: list[Any] = []
    for holder in holders:
        for thing in vars(holder).values():
            functions += [thing, *vars(thing).values()] if isinstance(thing, type) else [thing]
    functions = [f for f in functions if hasattr(f, "__defaults__") and hasattr(f, "__kwdefaults__")]
    defaults = [(f, f.__defaults__, f.__kwdefaults__) for f in functions]
    for holder in holders:
        setattr(holder, number.name, new)
    for function, plain, named in defaults:
        function.__defaults__ = plain and tuple(new if value is old else value for value in plain)
        function.__kwdefaults__ = named and {key: new if value is old else value for key, value in named.items()}
    try:
        yield
    finally:
        for holder in holders:
            setattr(holder, number.name, old)
        for function, plain, named in defaults:
            function.__defaults__, function.__kwdefaults__ = plain, named


@cache
def diagnose_unmoved(name: str) -> dict[str, Any]:
    return diagnose_known(name)


def find_witness(number: Number, factor: float, order: Sequence[str]) -> str | None:
    """Name the first campaign whose answer is another one; an answer that fails is another one."""
    for name in order:
        before = diagnose_unmoved(name)
        with moved(number, factor):
            try:
                if any(differences(before, diagnose_known(name))):
                    return name
            except Exception as error:
                return f"{name} ({type(error).__name__})"
    return None


def study(numbers: Sequence[Number]) -> None:
    """Say which of some numbers, at twice and at half their value, the campaigns see, and note it."""
    seen = json.loads(SEEN.read_text()) if SEEN.exists() else {}
    began, count, found = time.process_time(), 0, 0
    for number in numbers:
        noted = seen.setdefault(number.short, {})
        for factor in (2.0, 0.5):
            known = [w.split(" (")[0] for w in noted.values() if w]
            near = [name for key, names in FIRST.items() if number.short.startswith(key) for name in names]
            order = list(dict.fromkeys([*known, *near, *CAMPAIGNS]))[:ASKED]
            witness = noted[f"{factor:g}"] = find_witness(number, factor, order)
            count, found = count + 1, found + (witness is not None)
            cpu = time.process_time() - began
            told = f"{number.short} times {factor:g}: {witness or 'not seen'}"
            print(f"{told}  ({found} of {count}, {cpu:.0f} s)", flush=True)
        SEEN.write_text(json.dumps(dict(sorted(seen.items())), indent=0) + "\n")


def write_table() -> None:
    """Write the page of all numbers."""
    seen = json.loads(SEEN.read_text())
    rows = []
    for number in list_numbers():
        kind = next((k for k in ("theory", "data", "study") if re.search(rf"\b{k}\b", number.reason)), "assumed")
        noted = seen.get(number.short, {})
        words = {"2": "twice", "0.5": "half"}
        by = [f"{words[factor]}: {witness or 'not seen'}" for factor, witness in noted.items()]
        value = number.value if len(number.value) < 60 else "see code"
        cells = [f"`{number.short}`", f"`{value}`", kind, number.reason, "; ".join(by) or "not tried"]
        rows.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    tried = [w for name in (n.short for n in list_numbers()) for w in seen.get(name, {}).values()]
    head = HEAD.format(count=len(rows), tried=len(tried), seen=sum(w is not None for w in tried))
    TABLE.write_text(head + "\n".join(rows) + "\n")


HEAD = """# Numbers of the diagnosis

The {count} numbers that the diagnosis holds at the heads of its modules (`compplan/diagnose`), without those that
follow from another one by a formula. Of {tried} moves to twice or half the value that were tried, the known campaigns
(`tests/known_campaigns.py`) see {seen}: an answer, or what it rests on, changes by more than 1 %. A share near one is
moved by what it lacks of one. The last column names the first campaign of four that sees a move.

This page is written by `python tests/known_numbers.py table`; `python tests/known_numbers.py study 20` tries 20 numbers
anew. A unit stands in brackets at the end of the reason; numbers without one are shares, counts or log odds.

| number | value | rests on | reason | seen at |
|---|---|---|---|---|
"""

if __name__ == "__main__":
    if sys.argv[1] == "table":
        write_table()
    else:
        every = list_numbers()
        names = [n for n in every if n.short in sys.argv[2:]]
        draw = np.random.default_rng(0).permutation(len(every))
        study(names or [every[k] for k in draw[: int(sys.argv[2]) if sys.argv[2:] else None]])
