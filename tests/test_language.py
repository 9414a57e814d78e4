"""The vocabulary of README, manual, notebooks and docstrings: field terms (docs/glossary.md), no metaphors."""

from __future__ import annotations

import ast
import inspect
import json
import re
from pathlib import Path

import pytest

import compplan as cp

ROOT = Path(__file__).parents[1]
#: Words and constructions that are not used, and what is written instead.
METAPHORS = {
    r"promis\w*": "95 % band", r"judg(?:e|es|ed|ing|ement)": "check, independent check", r"vot(?:e|es|ed|ing)": "check",
    r"ledgers?": "normal equations", r"stances?": "posture", r"lessons?": "model update",
    r"(?:taught|teach(?:es|ing)?)(?! pendant)": "learned, measured", r"doubt\w*": "uncertain, probability",
    r"likeness\w*": "residual similarity", r"imitat\w*": "spurious fit", r"spok\w+|speaks?": "reports, readback",
    r"wish\w*": "preference", r"wakes?": "cut surface", r"seldom": "rarely, with the share", r"lawful\w*": "",
    r"surely": "uncertainty",
    r"told|stood|stands?|tells?": "is, states, reports", r"whatever|wherever": "any",
    r"of those that": "", r"what no": "", r"riddles?": "", r"held-out floor": "noise floor",
    r"grade scaled": "springs are scaled", r"asked once": "", r"own seeds?": "",
}  # fmt: skip
PATTERN = re.compile("|".join(rf"\b(?:{words})\b" for words in METAPHORS), re.I)
PACKAGES = sorted(folder.name for folder in (ROOT / "compplan").iterdir() if (folder / "__init__.py").is_file())
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "notebooks").glob("*.ipynb")])


def find_metaphors(text: str) -> list[str]:
    """Return the words of a text that are not used; code and names of attributes do not count."""
    return [found[0] for found in PATTERN.finditer(re.sub(r"```.*?```|`[^`]*`|^ *\w+: ", "", text, flags=re.S | re.M))]


def read_prose(page: Path) -> str:
    if page.suffix == ".md":
        return page.read_text(encoding="utf-8")
    cells = json.loads(page.read_text(encoding="utf-8"))["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_uses_field_terms(page: Path) -> None:
    assert find_metaphors(read_prose(page)) == []


def test_docstrings_of_public_names_use_field_terms() -> None:
    texts = {name: inspect.getdoc(getattr(cp, name)) or "" for name in cp.__all__}
    for name in cp.__all__:
        if inspect.isclass(value := getattr(cp, name)):
            own = {key: method for key, method in vars(value).items() if not key.startswith("_") and callable(method)}
            texts |= {f"{name}.{key}": inspect.getdoc(method) or "" for key, method in own.items()}
    assert {name: words for name, text in texts.items() if (words := find_metaphors(text))} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_docstrings_of_a_package_use_field_terms(package: str) -> None:
    found = {}
    for file in sorted((ROOT / "compplan" / package).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                words = find_metaphors(ast.get_docstring(node) or "")
                if words:
                    found[f"{file.name}: {getattr(node, 'name', 'module')}"] = words
    assert found == {}


def test_a_metaphor_is_found_and_a_field_term_or_code_is_not() -> None:
    text = "The judge votes on what was taught; in doubt the promise speaks."
    assert find_metaphors(text) == ["judge", "votes", "taught", "doubt", "promise", "speaks"]
    assert find_metaphors("The teach pendant shows the 95 % band; `promise_mm` is a key.") == []
