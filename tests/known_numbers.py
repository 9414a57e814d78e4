"""The numbers of the diagnosis: what each is for, and which known campaigns see it at twice and at half its value.

`python tests/known_numbers.py study 900` asks for 900 s of CPU, what nothing saw first (or of numbers that are
named), and notes in tests/known_numbers.json which campaign sees each move first; `table` writes
docs/concepts/diagnosis_numbers.md. Every campaign is asked whose diagnosis runs code that reads the number.
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
from types import CodeType
from typing import Any

import numpy as np
from known_campaigns import CAMPAIGNS, diagnose_known, differences

import compplan.diagnosis

ROOM = Path(compplan.diagnosis.__file__).parent
SEEN = Path(__file__).parent / "known_numbers.json"
TABLE = ROOM.parent.parent / "docs" / "concepts" / "diagnosis_numbers.md"
#: Shares near one are moved by what they lack of it.
SHARES = ("LEVEL", "SURE", "WITHIN", "MOST_SURE", "MOST_OF_IT", "doubt.ambiguity.ALIKE")


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
        return f"{self.module.removeprefix('compplan.diagnosis.')}.{self.name}"

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


def find_holders(number: Number) -> tuple[Any, list[Any], list[Any]]:
    """Return a number, the modules that hold it and all their functions."""
    value = getattr(importlib.import_module(number.module), number.name)
    package = [m for key, m in list(sys.modules.items()) if key.startswith("compplan")]
    holders = [m for m in [*package, sys.modules["known_campaigns"]] if vars(m).get(number.name) is value]
    functions: list[Any] = []
    for holder in holders:
        for thing in vars(holder).values():
            functions += [thing, *vars(thing).values()] if isinstance(thing, type) else [thing]
    return value, holders, [f for f in functions if hasattr(f, "__defaults__") and hasattr(f, "__kwdefaults__")]


@contextmanager
def moved(number: Number, factor: float) -> Iterator[None]:
    """Multiply a number of the diagnosis wherever the package holds it, defaults of arguments included."""
    old, holders, functions = find_holders(number)
    new = 1.0 - factor * (1.0 - old) if number.near_one else scale(old, factor)
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
def diagnose_unmoved(name: str) -> tuple[dict[str, Any], frozenset[CodeType], float]:
    """Diagnose a campaign as it is; also return the code that this runs, and the CPU time that it takes."""
    run: set[CodeType] = set()
    sys.setprofile(lambda frame, event, _: run.add(frame.f_code) if event == "call" else None)
    began = time.process_time()
    try:
        answer = diagnose_known(name)
    finally:
        sys.setprofile(None)
    return answer, frozenset(run), time.process_time() - began


def find_readers(number: Number) -> list[str]:
    """Name the campaigns whose diagnosis runs code that reads a number, the fastest first."""
    value, holders, functions = find_holders(number)
    files = {str(holder.__file__) for holder in holders}
    filled = {f.__code__ for f in functions for default in [*(f.__defaults__ or ()), *(f.__kwdefaults__ or {}).values()]
              if default is value and hasattr(f, "__code__")}  # fmt: skip

    def reads(code: CodeType) -> bool:
        return code in filled or (number.name in code.co_names and code.co_filename in files)

    cost = {name: diagnose_unmoved(name)[2] for name in CAMPAIGNS if any(map(reads, diagnose_unmoved(name)[1]))}
    return sorted(cost, key=lambda name: cost[name])


def find_witness(number: Number, factor: float, order: Sequence[str]) -> str | None:
    """Name the first campaign whose answer is another one; an answer that fails is another one."""
    for name in order:
        with moved(number, factor):
            try:
                if any(differences(diagnose_unmoved(name)[0], diagnose_known(name))):
                    return name
            except Exception as error:
                return f"{name} ({type(error).__name__})"
    return None


def study(numbers: Sequence[Number], budget: float) -> None:
    """Say which of some numbers, at twice and at half their value, the campaigns see, and note it.

    Args:
        numbers: The numbers.
        budget: No further number is asked after so much CPU time. [s]
    """
    seen = json.loads(SEEN.read_text()) if SEEN.exists() else {}
    seen = {number.short: seen[number.short] for number in list_numbers() if number.short in seen}
    began, count, found = time.process_time(), 0, 0
    for number in numbers:
        readers, noted = find_readers(number), seen.setdefault(number.short, {})
        for factor in (2.0, 0.5):
            known = [name for w in noted.values() if w for name in [w.split(" (")[0]] if name in readers]
            witness = noted[f"{factor:g}"] = find_witness(number, factor, list(dict.fromkeys([*known, *readers])))
            count, found = count + 1, found + (witness is not None)
            cpu = time.process_time() - began
            told = f"{number.short} times {factor:g}: {witness or f'not seen by {len(readers)}'}"
            print(f"{told}  ({found} of {count}, {cpu:.0f} s)", flush=True)
        SEEN.write_text(json.dumps(dict(sorted(seen.items())), indent=0) + "\n")
        if cpu > budget:
            break


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

The {count} numbers that the diagnosis holds at the heads of its modules (`compplan/diagnosis`), without those that
follow from another one by a formula. Of {tried} moves to twice or half the value that were tried, the known campaigns
(`tests/known_campaigns.py`) see {seen}: an answer, or what it rests on, changes by more than 1 %. A share near one is
moved by what it lacks of one. The last column names the first campaign that sees a move; a move that is not seen was
asked of every campaign whose diagnosis reads the number.

This page is written by `python tests/known_numbers.py table`; `python tests/known_numbers.py study 900` asks anew for
900 s of CPU. A unit stands in brackets at the end of the reason; numbers without one are shares, counts or log odds.

| number | value | rests on | reason | seen at |
|---|---|---|---|---|
"""

if __name__ == "__main__":
    if sys.argv[1] == "table":
        write_table()
    else:
        names = [n for n in list_numbers() if n.short in sys.argv[2:]]
        asked = json.loads(SEEN.read_text())
        # what nothing saw first, then what was never asked
        rest = sorted(list_numbers(), key=lambda n: all(asked[n.short].values()) if n.short in asked else 0.5)
        study(names or rest, np.inf if names else float(sys.argv[2]))
