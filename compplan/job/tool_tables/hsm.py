"""HSM tool libraries (.xml, .hsmlib)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from compplan.io.xmlfile import parse_xml
from compplan.job.tool_tables.listed import LibraryTool, check_number, check_whole, name_kind, read_scale

words = "an HSM library (.xml, .hsmlib)"


def recognise(text: str) -> bool:
    """Tell XML whose root is tool-library."""
    return "<tool-library" in text[:2000]


def read(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    """Read the tools."""
    root = parse_xml(text, path)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    for tool in root.findall(".//tool"):
        nc, body, holder = (tool.find(name) for name in ("nc", "body", "holder"))
        if nc is None or nc.get("number") is None:
            continue
        number = check_whole(nc.get("number"), path, None, "number")
        scale = read_scale(tool.get("unit", unit or ""), path, number)
        length = _attribute(body, "body-length", scale, path)
        gauge = _attribute(holder, "gauge-length", scale, path)
        whole = None if length is None or gauge is None else length + gauge
        teeth = _attribute(body, "number-of-flutes", 1.0, path)
        angle = _attribute(body, "taper-angle", 1.0, path)
        kind = name_kind(tool.get("type", ""))
        yield LibraryTool(
            number, tool.get("description", tool.findtext("description", "")), whole, kind,
            _attribute(body, "diameter", scale, path), None if teeth is None else int(teeth),
            _attribute(body, "corner-radius", scale, path), _attribute(body, "flute-length", scale, path),
            angle if kind == "drill" else None,
            missing="body-length and gauge-length of its holder; export the library as JSON, or write a CSV",
        )  # fmt: skip


def _attribute(element: ElementTree.Element | None, name: str, scale: float, path: Path) -> float | None:
    value = None if element is None else element.get(name)
    return None if value is None else scale * check_number(value, path, None, name)
