"""Records of an APT file and their fields, with strict syntax of numbers; drilling cycles."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from compplan.errors import InputError
from compplan.toolpath.readers.lines import DECIMAL, LONGEST_LINE, split_lines

NUMBER = re.compile(rf"{DECIMAL}(?:[EeDd][-+]?\d+)?")
WORD = re.compile(r"[A-Z][A-Z0-9._+\-/ ]*")
#: Words that begin with digits: 1STPECK, 3DCUT, 5AXIS; not a number with a letter O for zero, or with an exponent.
ORDINAL = re.compile(r"\d{1,2}(?!O+\b)[A-Z]{3,}[A-Z0-9_\-]*")
#: Words of a cycle: depth, level of the start of the feed, retract level, feed.
DEPTH, CLEAR, RETRACT = ("DEPTH", "DEEP", "FEDTO"), ("RAPTO", "CLEAR", "CLEARANCE"), ("RTRCTO", "RETURN")
FEED_WORDS = {"MMPM", "MMPMIN", "IPM", "MMPR", "IPR", "PERMIN", "PERREV", "FEDRAT", "UPM", "UPR", "FPM", "MPM"}
#: Words followed by a number that does not affect the path.
OTHER = {"1STPECK", "BACKFEED", "BOTTOM", "BRKCHP", "CAM", "CHIP", "CSINK", "DECR", "DWELL", "DWELLR", "INCR", "LEAD",
         "MINPECK", "MMPP", "NUMBER", "OPTION", "ORIENT", "PECK", "PECKMIN", "PITCH", "REV", "RPM", "SEC", "SPINDL",
         "STEP", "STEP1", "STEP2", "SUBPECK", "TIMES", "TPI"}  # fmt: skip


def split_records(text: str) -> Iterator[tuple[int, str]]:
    """Yield each record with its first line; $ continues a record, lines with $$ are comments."""
    pending, first = "", 0
    for number, raw in enumerate(split_lines(text), start=1):
        if not pending and raw.lstrip().startswith("$$"):
            yield number, raw.strip()
            continue
        line = raw.partition("$$")[0].rstrip()
        first = first if pending else number
        if line.endswith("$"):
            pending += line[:-1]
            if len(pending) > LONGEST_LINE:
                raise InputError(f"record of more than {LONGEST_LINE} characters in line {first}; no more are read")
            continue
        record, pending = (pending + line).strip(), ""
        if record:
            yield first, record
    if pending.strip():
        yield first, pending.strip()


def split_fields(minor: str) -> list[float | str]:
    """Return the fields of a record, numbers as float."""
    texts = [text.strip() for text in (minor.upper().split(",") if "," in minor else minor.upper().split())]
    if len(texts) > 3 and not texts[-1]:
        texts.pop()
    fields: list[float | str] = []
    for text in texts:
        if NUMBER.fullmatch(text):
            fields.append(float(text.replace("D", "E")))
        elif WORD.fullmatch(text) or ORDINAL.fullmatch(text):
            fields.append(text)
        else:
            raise InputError(f"field {text[:20]!r} is neither a number nor a word")
    return fields


def find_numbers(minor: str) -> list[float]:
    """Return the numbers of a record that may also contain words."""
    return [field for field in split_fields(minor) if not isinstance(field, str)] if minor else []


def read_numbers(minor: str) -> list[float]:
    """Return the fields of a record of numbers only."""
    for field in split_fields(minor) if minor else ():
        if isinstance(field, str):
            raise InputError(f"field {field[:20]!r} is not a number")
    return find_numbers(minor)


@dataclass(frozen=True)
class AptCycle:
    """Drilling cycle in the unit of the file: its kind (DRILL, TAP ..) and feed words as in FEDRAT.

    Levels are relative to the programmed point along the tool axis: `depth` below it (None: not stated), `clear` above
    it for the start of the feed, `retract` above it for approach and retract.
    """

    kind: str
    depth: float | None
    clear: float
    retract: float
    feed: str


def read_cycle(minor: str) -> AptCycle:
    """Read CYCLE/kind with DEPTH, d or FEDTO, d, CLEAR or RAPTO, c and MMPM, f; or positional values without words.

    A depth has either sign. A positional feed follows or precedes its unit: CYCLE/kind, d, MMPM, f, c (ISO) or
    CYCLE/kind, d, f, IPM, c.
    """
    fields = split_fields(minor)
    if not fields:
        raise InputError("a cycle has no kind, expected CYCLE/DRILL, ..")
    kind = word = str(fields[0])
    depth: float | None = None
    levels: dict[str, float] = {}
    feed, bare = "", list[float]()
    for field in fields[1:]:
        if isinstance(field, str):
            word = field
            if word in FEED_WORDS and len(bare) == 2 and depth is None and not feed:
                feed, word = f"{bare.pop()!r},{word}", kind
            continue
        if word in DEPTH:
            depth = abs(field)
        elif word in CLEAR or word in RETRACT:
            levels[word] = field
        elif word in FEED_WORDS:
            feed = f"{field!r},{word}" if word != "FEDRAT" else f"{field!r}"
        elif word in ("", kind):
            bare.append(field)
        elif word not in OTHER:
            raise InputError(f"number {field:g} after {word} in a cycle is not known")
        word = kind
    if bare and depth is None:
        depth = abs(bare.pop(0))
    if bare:
        levels.setdefault("CLEAR", bare.pop(0))
    if bare:
        raise InputError(f"number {bare[0]:g} in a cycle is not known")
    clear = next((levels[word] for word in (*CLEAR, *RETRACT) if word in levels), 0.0)
    return AptCycle(kind, depth, clear, max([clear, *levels.values()]), feed)
