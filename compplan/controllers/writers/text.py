"""Text in robot programs: comments, names of programs, labels. All writers use these functions."""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

#: The table of each language.
LANGUAGES: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("languages.toml").read_text("utf-8"))

#: Letters of a comment; controllers truncate or refuse longer lines.
LONGEST_COMMENT = 100
#: Characters not allowed in comments; the allowed ones do not end a line, comment, string or block in any language.
FOREIGN = re.compile(r"[^A-Za-z0-9 .,:+\-_/()=%#*]+")
#: File names reserved by Windows, the system of most controllers and their software.
DEVICES = frozenset({"con", "prn", "aux", "nul"} | {f"{name}{n}" for name in ("com", "lpt") for n in range(10)})


#: End of a program's name with its tool, which distinguishes the programs of one job.
LABEL = re.compile(r"_(?:T|op)\d{1,5}(?:_run\d+)?$")


def clean_text(text: str, longest: int = LONGEST_COMMENT) -> str:
    """Return text as one line of plain characters that no controller interprets as code.

    Accents are removed; other special characters become spaces; text that is too long ends in dots.
    """
    head = unicodedata.normalize("NFKD", text[: 10 * longest])
    plain = "".join(letter for letter in head if not unicodedata.combining(letter))
    line = " ".join(FOREIGN.sub(" ", plain).split())
    return line if len(line) <= longest else f"{line[: longest - 3].rstrip()}..."


def list_numbers(values: Iterable[float], digits: int, between: str = ",") -> str:
    """Format numbers with a fixed number of decimals, zero without a sign."""
    return between.join(f"{value + 0.0:.{digits}f}" for value in values)


def legal_name(text: str, longest: int, *, reserved: Collection[str] = ()) -> str:
    """Return a valid name: letters, digits and _, a letter first, not a reserved word."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", clean_text(text, 10 * longest)).strip("_") or "program"
    name = name if name[0].isalpha() else f"p_{name}"
    label = LABEL.search(name)
    tail = label.group() if label and len(name) > longest else ""
    name = name[: longest - len(tail)].rstrip("_") + tail
    if name.lower() in DEVICES or name.lower() in reserved:
        name = f"{name[: longest - 2]}_p"
    return name
