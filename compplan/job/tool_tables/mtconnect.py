"""MTConnect's cutting tool asset (.xml): measurements by the codes of ISO 13399, lengths in mm.

The functional length LF counts from the gauge plane to the tip.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from compplan.io.xmlfile import parse_xml
from compplan.job.tool_tables.listed import LibraryTool, check_number, check_whole, name_kind, round_ball

words = "MTConnect's cutting tools (.xml)"
#: Codes by the names of elements, for those that state none.
CODES = {"FunctionalLength": "LF", "CuttingDiameterMax": "DC", "DepthOfCutMax": "APMX", "CornerRadius": "RE",
         "PointAngle": "SIG", "Weight": "WT"}  # fmt: skip


def recognise(text: str) -> bool:
    """Tell XML that holds a CuttingTool."""
    return "<" in text[:200] and "CuttingToolLifeCycle" in text


def read(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    """Read the tools."""
    root = parse_xml(text, path)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    for tool in root.iter("CuttingTool"):
        called = (tool.findtext(".//ProgramToolNumber") or "").strip()
        number = check_whole(called, path, None, "ProgramToolNumber") \
            if called else None  # fmt: skip
        values: dict[str, float] = {}
        for measurements in tool.iter("Measurements"):
            for element in measurements:
                code = element.get("code") or CODES.get(element.tag, element.tag)
                value = (element.text or "").strip() or element.get("nominal")
                if value:
                    values.setdefault(code, check_number(value, path, None, code))
        title = f"{tool.get('toolId', '')} {tool.findtext('Description') or ''}"
        angle, diameter = values.get("SIG"), values.get("DC")
        kind = name_kind(title) or ("drill" if angle else "mill" if "APMX" in values else "")
        yield LibraryTool(
            number, tool.get("toolId", ""), values.get("LF"), kind, diameter, None,
            round_ball(title, diameter, values.get("RE")), values.get("APMX"), angle if kind == "drill" else None,
            1e-3 * values["WT"] if "WT" in values else None, missing="FunctionalLength (LF)",
        )  # fmt: skip
