"""Safe XML parsing: no document types, no entities, bounded depth and size."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from compplan.errors import InputError
from compplan.io.parsing import guard_parser

#: Greatest depth and number of elements of an XML file.
DEEPEST, MOST_ELEMENTS = 64, 100_000


class _Builder(ElementTree.TreeBuilder):
    """Build the tree with bounded depth and size."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.file = file
        self.depth = self.count = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse a document type, which may define entities."""
        raise InputError("holds a DOCTYPE declaration, expected plain XML without entities", file=self.file)

    def start(self, tag: str, attrs: dict[str, str]) -> ElementTree.Element:  # type: ignore[override]
        """Count elements and depth."""
        self.depth += 1
        self.count += 1
        if self.depth > DEEPEST:
            raise InputError(f"is nested deeper than {DEEPEST} elements", file=self.file)
        if self.count > MOST_ELEMENTS:
            raise InputError(f"holds more than {MOST_ELEMENTS} elements", file=self.file)
        return super().start(tag, attrs)

    def end(self, tag: str) -> ElementTree.Element:
        """Leave an element."""
        self.depth -= 1
        return super().end(tag)


def parse_xml(text: str, file: Path) -> ElementTree.Element:
    """Parse an XML text.

    Args:
        text: The text.
        file: Its file, for messages.

    Raises:
        InputError: If it is no XML, declares a document type, or is nested too deeply.
    """
    parser = ElementTree.XMLParser(target=_Builder(file))
    with guard_parser(file, "not valid XML"):
        parser.feed(text)
        root: ElementTree.Element = parser.close()
    return root
