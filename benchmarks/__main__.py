"""List the studies: `python -m benchmarks`."""

from __future__ import annotations

import ast
from pathlib import Path

from benchmarks import QUESTIONS

if __name__ == "__main__":
    for question, names in QUESTIONS.items():
        print(question)
        for name in names:
            place = Path(__file__).parent / name.replace(".", "/")
            file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
            told = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").partition("\n")[0]
            print(f"    python -m benchmarks.{name:<23} {told.partition(': `python')[0]}")
