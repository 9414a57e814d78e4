"""Run a study, or list them: `python -m benchmarks [NAME ...]`."""

from __future__ import annotations

import ast
import runpy
import sys
from pathlib import Path

from benchmarks import QUESTIONS


def list_studies() -> None:
    """Print every study under its question, with the first line of its description."""
    for question, names in QUESTIONS.items():
        print(question)
        for name in names:
            place = Path(__file__).parent / name.replace(".", "/")
            file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
            told = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").partition("\n")[0]
            print(f"    python -m benchmarks {name:<23} {told.partition(': `python')[0]}")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        list_studies()
    elif sys.argv[1] not in {name for names in QUESTIONS.values() for name in names}:
        sys.exit(f"no study is called {sys.argv[1]}; python -m benchmarks lists them")
    else:
        name = f"benchmarks.{sys.argv[1]}"
        del sys.argv[1]
        runpy.run_module(name, run_name="__main__", alter_sys=True)
