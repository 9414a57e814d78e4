"""ISO 13399: tools of a catalogue in exchange files of ISO 10303-21 (.p21), alone or in a GTC package (.zip).

The values stand in entities NUMERICAL_VALUE(name, digits, unit, value), by the names that makers publish: DC cutting
diameter, APMX greatest depth of cut, LCF length of the chip flutes, LU usable length, ZEFP ZEFF NOF teeth, RE corner
radius, SIG point angle, WT mass. UNIT(name) is the unit. A catalogue has no T numbers, and its lengths do not count
from the spindle: it says the cutter alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from compplan.errors import InputError
from compplan.job.tool_tables.listed import LibraryTool, check_number, check_whole, name_kind, read_scale, round_ball

words = "ISO 13399 (.p21, or a GTC package)"
#: One exchange structure, a statement in it, one that is an instance, and an argument of that.
STRUCTURE = r"(?s)ISO-10303-21;(.*?)END-ISO-10303-21;"
STATEMENT, INSTANCE = r"(?:'[^']*'|[^';])+", r"(?s)\s*#(\d+)\s*=\s*([A-Z0-9_]+)\s*\((.*)\)\s*"
ARGUMENT = r"\s*((?:'[^']*'|\((?:'[^']*'|[^()'])*\)|[^,'()])*)(?:,|$)"
#: Codes of each size, the first that is stated counts; a drill cuts with its flutes, a mill with its edges.
DIAMETER, TEETH = ("DC",), ("ZEFP", "ZEFF", "NOF")
MILL_FLUTE, DRILL_FLUTE = ("APMX", "LCF", "LU"), ("LCF", "LU")

Instances = dict[str, tuple[str, list[str]]]


def recognise(text: str) -> bool:
    """Tell an exchange structure that holds properties of cutting tools."""
    return "ISO-10303-21;" in text[:200] and "NUMERICAL_VALUE" in text


def read(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    """Read one tool of each exchange structure."""
    for structure in re.findall(STRUCTURE, text):
        statements = re.findall(STATEMENT, re.sub(r"(?s)/\*.*?\*/", "", structure))
        instances: Instances = {
            match[1]: (match[2], [found.strip() for found in re.findall(ARGUMENT, match[3])])
            for match in (re.fullmatch(INSTANCE, statement) for statement in statements) if match
        }  # fmt: skip
        yield _read_tool(instances, path, unit)


def _read_tool(instances: Instances, path: Path, unit: str | None) -> LibraryTool:
    items = [arguments for kind, arguments in instances.values() if kind == "ITEM" and len(arguments) > 2]
    if not items:
        raise InputError("holds no ITEM, expected a cutting tool of ISO 13399", file=path)
    name, title = _read_text(items[0][1], instances), " ".join(_read_text(word, instances) for word in items[0])
    call = f"the tool {name!r}"
    values: dict[str, tuple[float, str]] = {}
    for kind, arguments in instances.values():
        if kind == "NUMERICAL_VALUE" and len(arguments) > 3:
            code, stated = _read_text(arguments[0], instances), _read_text(arguments[2], instances)
            found = (check_number(_read_text(arguments[3], instances), path, None, f"{code} of {call}"), stated)
            if values.setdefault(code, found) != found:
                message = f"{call} states {code} as {values[code][0]:g} and as {found[0]:g}, expected one"
                raise InputError(message, file=path)

    def said(codes: Sequence[str], *, length: bool = True) -> float | None:
        code = next((code for code in codes if code in values), None)
        if code is None:
            return None
        value, stated = values[code]
        return value * read_scale(stated or unit or "", path, f"{code} of {call}") if length else value

    angle, teeth = said(("SIG",), length=False), said(TEETH, length=False)
    kind = name_kind(title) or ("drill" if angle else "mill" if said(("APMX",)) else "")
    diameter, mass = said(DIAMETER), said(("WT",), length=False)
    if diameter is None:
        message = f"{call} states no cutting diameter (DC); it states {', '.join(sorted(values)[:12])}"
        raise InputError(message, file=path)
    return LibraryTool(
        None, name, None, kind, diameter, None if teeth is None else check_whole(teeth, path, None, f"teeth of {call}"),
        round_ball(title, diameter, said(("RE",))), said(DRILL_FLUTE if kind == "drill" else MILL_FLUTE),
        angle if kind == "drill" else None, mass if mass and values["WT"][1].lower() in ("kg", "kilogram") else None,
        missing="a catalogue counts no length from the spindle; write [[tool]] with position_mm and cutter_file",
    )  # fmt: skip


def _read_text(word: str, instances: Instances, depth: int = 4) -> str:
    """Return a string, or that of the instance that is referred to; "" where there is none."""
    if word.startswith("'"):
        return word.strip("'").strip()
    kind, arguments = instances.get(word.removeprefix("#"), ("", []))
    if not word.startswith("#") or not depth:
        return word.strip("$*")
    if kind in ("UNIT", "STRING_WITH_LANGUAGE"):
        return _read_text(arguments[0], instances, depth - 1)
    return _read_text(arguments[-1], instances, depth - 1) if kind == "MULTI_LANGUAGE_STRING" else ""
