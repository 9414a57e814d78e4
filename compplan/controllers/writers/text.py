"""Where words become part of a robot program: comments, names of programs, labels. Every writer goes through here."""

from __future__ import annotations

import re
import textwrap
import tomllib
import unicodedata
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

#: The table of each language.
LANGUAGES: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("languages.toml").read_text("utf-8"))

#: Letters of a comment; controllers cut longer lines or refuse them.
LONGEST_COMMENT = 100
#: What a comment may hold: nothing that ends a line, a comment, a string or a block in any of the languages.
FOREIGN = re.compile(r"[^A-Za-z0-9 .,:+\-_/()=%#*]+")
#: File names that Windows, which most controllers and their tools run on, keeps for itself.
DEVICES = frozenset({"con", "prn", "aux", "nul"} | {f"{name}{n}" for name in ("com", "lpt") for n in range(10)})


#: What tells the programs of one job apart: the tool of each, at the end of its name.
LABEL = re.compile(r"_(?:T|op)\d{1,5}(?:_run\d+)?$")


def clean_text(text: str, longest: int = LONGEST_COMMENT) -> str:
    """Return text as one line of plain letters that no controller takes for code.

    Accents go, whatever is no letter, digit or plain sign becomes a space; what is too long ends in dots.
    """
    head = unicodedata.normalize("NFKD", text[: 10 * longest])
    plain = "".join(letter for letter in head if not unicodedata.combining(letter))
    line = " ".join(FOREIGN.sub(" ", plain).split())
    return line if len(line) <= longest else f"{line[: longest - 3].rstrip()}..."


def wrap_text(text: str, longest: int) -> list[str]:
    """Return text that is already clean in lines of at most so many letters."""
    return textwrap.wrap(text, longest) or [""]


def list_numbers(values: Iterable[float], digits: int, between: str = ",") -> str:
    """Return numbers with so many decimals, zero without a sign."""
    return between.join(f"{value + 0.0:.{digits}f}" for value in values)


def legal_name(text: str, longest: int, *, reserved: Collection[str] = ()) -> str:
    """Return a name that a controller takes: letters, digits and _, a letter first, none of its own words."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", clean_text(text, 10 * longest)).strip("_") or "program"
    name = name if name[0].isalpha() else f"p_{name}"
    label = LABEL.search(name)
    tail = label.group() if label and len(name) > longest else ""
    name = name[: longest - len(tail)].rstrip("_") + tail
    if name.lower() in DEVICES or name.lower() in reserved:
        name = f"{name[: longest - 2]}_p"
    return name
