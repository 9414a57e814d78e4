"""Conversion of every exception of a foreign parser into one InputError."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from json import JSONDecodeError
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import ParseError

from compplan.errors import CompplanError, InputError

#: Greatest number accepted in a table, in the unit of its column or key.
GREATEST = 1e12
#: Least plausible standard deviation of an instrument, in mm and in m or rad.
LEAST_SIGMA_MM = 1e-6
LEAST_SIGMA = 1e-3 * LEAST_SIGMA_MM


@contextmanager
def guard_parser(file: str | Path, fault: str, line: Callable[[], int] | None = None) -> Iterator[None]:
    """Convert every exception of a parser into an InputError with the file and, if known, the line.

    Args:
        file: The file that is parsed.
        fault: Start of the message, such as "is not TOML".
        line: Returns the line that the parser has reached, for errors without a line.

    Raises:
        InputError: If the parser fails. Errors of this package and a lack of memory pass.

    """
    try:
        yield
    except (CompplanError, MemoryError):
        raise
    except Exception as error:  # parsers raise exceptions of any type
        sentence, where = _describe(error)
        where = line() if line is not None and where is None else where
        raise InputError(" ".join(f"{fault}: {sentence}".split()), file=file, where=where) from None


def _describe(error: Exception) -> tuple[str, int | None]:
    """Return the message of a parser and its line, if any."""
    if isinstance(error, RecursionError):
        return "nested too deeply", None
    if isinstance(error, ParseError):
        return error.msg, error.position[0]
    if isinstance(error, JSONDecodeError):
        return error.msg, error.lineno
    if isinstance(error, tomllib.TOMLDecodeError):
        sentence, _, place = str(error).partition(" (at ")
        line = place.removeprefix("line ").partition(",")[0]
        return sentence, int(line) if line.isdigit() else None
    return f"{type(error).__name__}: {error}", None


#: Greatest number of tags of an XML file.
MOST_TAGS = 200_000


def parse_xml(text: str, file: Path) -> ElementTree.Element:
    """Parse an XML text.

    Args:
        text: The text.
        file: Its file, for messages.

    Raises:
        InputError: If it is not XML, declares a document type, which may define entities, or is too large.
    """
    if "<!DOCTYPE" in text:
        raise InputError("holds a DOCTYPE declaration, expected plain XML without entities", file=file)
    if text.count("<") > MOST_TAGS:
        raise InputError(f"holds more than {MOST_TAGS} tags", file=file)
    with guard_parser(file, "not valid XML"):
        return ElementTree.fromstring(text)
