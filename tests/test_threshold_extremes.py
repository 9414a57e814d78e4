"""Every threshold of the diagnosis decides something: moved to either extreme, it changes an answer.

A row (tests/threshold_rows.py) names the probes (tests/threshold_probes.py) that see it and both extremes, as absolute
numbers: a threshold whose value in the source were one of them would change nothing there, and fail. None stands for an
extreme that changes no answer of these small campaigns, with the reason.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import threshold_decisions
import threshold_last_probes
import threshold_probes
from threshold_bench import Bench, digest
from threshold_rows import ROWS, SLOW, Row

#: What the rows ask, by name.
PROBES: dict[str, Callable[[Bench], Any]] = {
    name.removeprefix("ask_"): function
    for module in (threshold_probes, threshold_last_probes, threshold_decisions)
    for name, function in vars(module).items()
    if name.startswith("ask_")
}
DIAGNOSE = Path(__file__).parent.parent / "compplan" / "diagnose"


def names_of(module: str) -> list[str]:
    """Names at the head of a module that hold numbers."""
    found = []
    for node in ast.parse((DIAGNOSE / f"{module}.py").read_text()).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or isinstance(node.value, ast.Subscript | None):
            continue
        if any(isinstance(n, ast.Constant) and type(n.value) in (int, float) for n in ast.walk(node.value)):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            found += [n.id for n in ast.walk(target) if isinstance(n, ast.Name)]
    return found


def functions_of(module: Any) -> Iterator[Any]:
    """Functions and methods of a module."""
    for entry in vars(module).values():
        if getattr(entry, "__module__", "") == module.__name__:
            yield from (entry, *(vars(entry).values() if isinstance(entry, type) else ()))


@contextmanager
def moved(module: str, name: str, value: Any) -> Iterator[None]:
    """Give a threshold another value wherever the package holds it, defaults of arguments included."""
    home = importlib.import_module(f"compplan.diagnose.{module}")
    old, patch = getattr(home, name), pytest.MonkeyPatch()
    for label, other in list(sys.modules.items()):
        own = label.startswith("compplan.diagnose.") and name in vars(other)
        if own and (other is home or name not in names_of(label.rsplit(".", 1)[-1])):
            patch.setattr(other, name, value)
    for function in functions_of(home):
        given = getattr(function, "__kwdefaults__", None) or {}
        if name.endswith("STEPS") and "steps" in given:
            patch.setitem(given, "steps", value)
        if name == "SHIFT_ROWS" and getattr(function, "__name__", "") == "propose_shifts":
            patch.setattr(function, "__defaults__", (value,))
    try:
        assert old is not value
        yield
    finally:
        patch.undo()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return Bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def answers(bench: Bench) -> dict[str, Any]:
    """What each probe answers with the thresholds as they are, asked when it is first needed."""
    return {}


def ask(probe: str, bench: Bench) -> Any:
    """Ask a probe; a threshold that makes it fail has changed its answer."""
    try:
        return digest(PROBES[probe](bench))
    except (ArithmeticError, LookupError, ValueError, TypeError, np.linalg.LinAlgError) as error:
        return type(error).__name__


def cases(slow: bool) -> list[Any]:
    every = [(module, name, row) for module, rows in ROWS.items() for name, row in rows.items()]
    chosen = [c for c in every if bool(SLOW & set(c[2][0].split())) == slow and c[2][0]]
    return [pytest.param(*c, id=f"{c[0]}.{c[1]}") for c in chosen]


def check(module: str, name: str, row: Row, bench: Bench, answers: dict[str, Any]) -> None:
    for probe in row[0].split():
        if probe not in answers:
            answers[probe] = ask(probe, bench)
            assert not isinstance(answers[probe], str)
    for extreme in (e for e in row[1:3] if e is not None):
        with moved(module, name, extreme):
            changed = any(ask(probe, bench) != answers[probe] for probe in row[0].split())
        assert changed, f"{module}.{name} = {extreme} changes no answer"


@pytest.mark.parametrize(("module", "name", "row"), cases(slow=False))
def test_a_threshold_at_an_extreme_changes_an_answer(
    module: str, name: str, row: Row, bench: Bench, answers: dict[str, Any]
) -> None:
    check(module, name, row, bench, answers)


@pytest.mark.slow
@pytest.mark.parametrize(("module", "name", "row"), cases(slow=True))
def test_a_threshold_of_the_last_stages_at_an_extreme_changes_an_answer(
    module: str, name: str, row: Row, bench: Bench, answers: dict[str, Any]
) -> None:
    check(module, name, row, bench, answers)


def test_every_threshold_has_a_row_and_every_gap_a_reason() -> None:
    found = {(path.stem, name) for path in DIAGNOSE.glob("*.py") for name in names_of(path.stem)}
    assert found == {(m, n) for m, rows in ROWS.items() for n in rows}
    for rows in ROWS.values():
        for name, row in rows.items():
            assert len(row) == 3 + (None in row[1:3] if not any(isinstance(e, np.ndarray) for e in row) else 0), name
