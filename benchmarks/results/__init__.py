"""Evidence pages: one page a question, docs/results/NAME.md, each written by the command that measures it.

    python -m benchmarks results [NAME ...] [--out docs/results] [--real DIR]

A page is one file here and one line in `PAGES`: `TITLE`, `QUESTION`, `METHOD`, `LIMITS`,
`measure(settings) -> Findings`, and `CHART`, drawn from the page's first table. README and manual quote figures from
"In short" alone.
"""

from __future__ import annotations

from types import ModuleType

from benchmarks.results import comparison, coverage, diagnosis_drawn, diagnosis_real, forces, loop, planning, redundant

#: Every page by the name of its file.
PAGES: dict[str, ModuleType] = {
    module.__name__.rpartition(".")[2]: module
    for module in (planning, comparison, coverage, redundant, forces, diagnosis_drawn, diagnosis_real, loop)
}
