"""Fusion tool libraries (.json, .tools): `data`, with geometry by the codes of ISO 13399 and a holder of segments."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.parsing import guard_parser
from compplan.job.tool_tables.listed import (
    LibraryTool,
    as_mapping,
    check_number,
    check_whole,
    name_kind,
    read_scale,
    round_ball,
)

words = "a Fusion tool library (.json, .tools)"
#: Greatest number of tools.
MOST_TOOLS = 10_000


def recognise(text: str) -> bool:
    """Return whether a text is a JSON object with `data` and `post-process`."""
    return text.lstrip("\ufeff \r\n\t").startswith("{") and '"data"' in text and "post-process" in text


def read(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    """Read the tools."""
    with guard_parser(path, "is no tool library"):
        data = json.loads(text.lstrip("\ufeff"))
    entries = as_mapping(data).get("data")
    if not isinstance(entries, list) or len(entries) > MOST_TOOLS:
        raise InputError(f"is no tool library: expected a list data of at most {MOST_TOOLS} tools in JSON", file=path)
    for entry in entries:
        if not isinstance(entry, Mapping) or entry.get("type") in ("holder", "probe"):
            continue
        post, geometry, holder = (as_mapping(entry.get(key)) for key in ("post-process", "geometry", "holder"))
        if "number" not in post:
            continue
        number = check_whole(post["number"], path, None, "number")
        scale = read_scale(str(entry.get("unit", unit or "")), path, number)

        def size(key: str, table: Mapping[str, Any] = geometry, factor: float = scale) -> float | None:
            return None if table.get(key) is None else factor * check_number(table[key], path, None, key)

        gauge, body = size("assemblyGaugeLength"), size("LB")
        if gauge is None:
            held = as_mapping(holder).get("gaugeLength")
            factor = read_scale(str(holder.get("unit", entry.get("unit", unit or ""))), path, number)
            if held is not None and body is not None:
                gauge = body + factor * check_number(held, path, None, "gaugeLength")
        profile = () if body is None else _read_segments(holder, body, str(entry.get("unit", unit or "")), path, number)
        teeth, angle = size("NOF", factor=1.0), size("SIG", factor=1.0)
        kind, diameter = str(entry.get("type", "")), size("DC")
        yield LibraryTool(
            number, str(entry.get("description", "")), gauge, name_kind(kind), diameter,
            None if teeth is None else int(teeth), round_ball(kind, diameter, size("RE")), size("LCF"), angle or None,
            missing="give it a holder in the library (assemblyGaugeLength, or gaugeLength of the holder and LB)",
            holder_mm=profile,
        )  # fmt: skip


def _read_segments(
    holder: Mapping[str, Any], nose: float, unit: str, path: Path, number: int
) -> tuple[tuple[float, float], ...]:
    """Return the profile of a holder from its segments, nose first; empty without any."""
    scale, profile, height = read_scale(str(holder.get("unit", unit)), path, number), [], nose
    for segment in map(as_mapping, holder.get("segments") or ()):
        rise, low, high = (scale * check_number(segment.get(key), path, None, key)
                           for key in ("height", "lower-diameter", "upper-diameter"))  # fmt: skip
        profile += [(height, low), (height + rise, high)]
        height += rise
    return tuple(profile)
