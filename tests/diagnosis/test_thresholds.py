"""Every number that decides in the diagnosis has a name, a reason and a source.

The rule: a number inside a function is arithmetic where it counts (integers up to 6: components, axes, powers), halves,
changes a unit, or guards a division or a factorization against rounding (up to 1e-6). Every other one decides, and so
does any fraction, or count above 3, that something is compared with or limited to; those stand at the head of the
module with a comment that says why and, as one of the words assumed, theory or study (with its command), where from.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

DIAGNOSE = Path(__file__).parents[2] / "compplan" / "diagnosis"
MODULES = sorted(str(path.relative_to(DIAGNOSE).with_suffix("")) for path in DIAGNOSE.rglob("*.py"))
SOURCES = ("assumed", "theory", "study: python -m ")
COUNTS, GUARD = 6, 1e-6
FRACTIONS = {0.5, 1e3, 180.0, 100.0}
LIMITERS = {"min", "max", "minimum", "maximum", "clip"}


def numbers_of(node: ast.AST) -> Iterator[ast.Constant]:
    for found in ast.walk(node):
        if isinstance(found, ast.Constant) and type(found.value) in (int, float):
            yield found


def without_slices(node: ast.expr) -> ast.expr:
    """What is cut out of a list of names is not a number that decides."""
    return node.value if isinstance(node, ast.Subscript) else node


def is_arithmetic(value: float) -> bool:
    return abs(value) <= GUARD or value in FRACTIONS or (value == int(value) and value <= COUNTS)


def limits_of(tree: ast.AST) -> Iterator[ast.Constant]:
    """Numbers that something is compared with or limited to, directly."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in LIMITERS:
            sides = list(node.args)
        else:
            continue
        for side in sides:
            inner = side.operand if isinstance(side, ast.UnaryOp) else side
            if isinstance(inner, ast.Constant):
                yield from numbers_of(inner)


def bare_decisions(source: str) -> list[int]:
    """Lines of the functions of a module where a number decides that has no name."""
    found = set()
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef):
            found |= {n.lineno for n in numbers_of(function) if not is_arithmetic(n.value)}
            found |= {n.lineno for n in limits_of(function) if n.value not in (0, 1, 2, 3) and abs(n.value) > GUARD}
    return sorted(found)


def unsourced_constants(source: str) -> list[str]:
    """Names of a module or of its settings that hold numbers, without a comment that says where those come from."""
    lines, found = [line.strip() for line in source.split("\n")], []
    body = ast.parse(source).body
    settings = [n for n in body if isinstance(n, ast.ClassDef) and n.name.endswith(("Settings", "Limits"))]
    for nodes in (body, *(one.body for one in settings)):
        comment, end = "", 0
        for node in nodes:
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            # numbers of one comment stand line by line under it
            first = line = node.lineno - 1
            while lines[line - 1].startswith("#:"):
                line -= 1
            if line < first or first != end:
                comment = " ".join(lines[line:first])
            end = node.end_lineno
            if any(numbers_of(without_slices(node.value))) and not any(word in comment for word in SOURCES):
                found.append(ast.unparse(node).split("=")[0].strip())
    return found


@pytest.mark.parametrize("module", MODULES)
def test_a_number_that_decides_has_a_name(module: str) -> None:
    lines = bare_decisions((DIAGNOSE / f"{module}.py").read_text())
    assert not lines, f"compplan/diagnosis/{module}.py: numbers without a name in lines {lines}"


@pytest.mark.parametrize("module", MODULES)
def test_a_named_number_says_where_it_comes_from(module: str) -> None:
    names = unsourced_constants((DIAGNOSE / f"{module}.py").read_text())
    assert not names, f"compplan/diagnosis/{module}.py: {names} do not say one of {SOURCES}"
