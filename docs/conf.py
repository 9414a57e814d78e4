"""Sphinx configuration of the manual. Build: sphinx-build -W docs site (extra `docs`)."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(Path(__file__).parent / "_ext")]

# Notebooks live in notebooks/; the build reads a copy, because Sphinx reads its own folder alone.
shutil.rmtree(ROOT / "docs" / "notebooks", ignore_errors=True)
shutil.copytree(ROOT / "notebooks", ROOT / "docs" / "notebooks", ignore=shutil.ignore_patterns("__pycache__", ".*"))

project = "compplan"
author = copyright = "The compplan developers"
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "public_names",
    "command_help",
    "reference_tables",
]
exclude_patterns = ["_ext", "notebooks/diagnose_campaign", "**.ipynb_checkpoints"]
html_theme = "furo"
html_title = "compplan"
html_static_path = ["_static"]
html_css_files = ["manual.css"]

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
#: Pages are also read in the repository, where they link to files that are not pages: those links stay as they are.
suppress_warnings = ["myst.xref_missing", "myst.header"]

# The build runs each notebook anew and fails where one does; COMPPLAN_DOCS_EXECUTE=0 shows the outputs that are kept.
nb_execution_mode = "off" if os.environ.get("COMPPLAN_DOCS_EXECUTE") == "0" else "cache"
nb_execution_timeout = 300
nb_execution_raise_on_error = True

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_attr_annotations = False
#: How autodoc spells compplan's Array.
ARRAY = "~numpy.ndarray[tuple[~typing.Any, ...], ~numpy.dtype[~numpy.float64]]"
autodoc_typehints_format = "short"


def escape_docstring(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Let docstrings be read as they are written: bars, stars and trailing underscores are not markup there."""
    lines[:] = [re.sub(r"(?<!`)([|*])(?!`)", r"\\\1", re.sub(r"(\w)_(?=\W|$)", r"\1\\_", line)) for line in lines]


def shorten_signature(
    app: object, what: str, name: str, obj: object, options: object, signature: str | None, returns: str | None
) -> tuple[str, str | None] | None:
    """Leave out the keys of tables (pydantic), which run over a page, and spell arrays shortly."""
    if hasattr(obj, "model_fields"):
        return "(**table)", returns
    if signature is None:
        return None
    return tuple(text and text.replace(ARRAY, "Array") for text in (signature, returns))


def link_notebooks(app: object, docname: str, source: list[str]) -> None:
    """Let links to notebook files, which work in the repository, lead to the pages of their copies."""
    link = r"\[([^\]]+)\]\((?:\.\./)+notebooks/(\w+)\.ipynb\)"
    source[0] = re.sub(link, r"{doc}`\1 </notebooks/\2>`", source[0])


def setup(app) -> None:
    """Register the hooks."""
    app.connect("source-read", link_notebooks)
    app.connect("autodoc-process-docstring", escape_docstring, priority=100)
    app.connect("autodoc-process-signature", shorten_signature)
