"""The directive `public-names ROOM ..`: the names of `compplan.__all__` that live in some rooms, with docstrings."""

from __future__ import annotations

import inspect

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

import compplan

TITLES = {
    "commands": "Verbs",
    "job": "Jobs", "path": "Toolpaths", "robot": "Robots", "statics": "Statics", "plan": "Planning",
    "cell": "Virtual cell", "posture": "Posture and place", "program": "Programs", "study": "Studies",
    "measure": "Measurements", "identify": "Identification", "diagnose": "Diagnosis", "effects": "Effects",
    "loop": "The loop", "maps": "Maps", "outputs": "Writing results", "errors": "Errors",
}  # fmt: skip


class PublicNames(SphinxDirective):
    """List the public names of some rooms; with one room without a heading for it."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Write one autodoc directive a name and let it be parsed."""
        wanted = self.arguments[0].split()
        lines: list[str] = []
        for room in wanted:
            names = [name for name in compplan.__all__ if compplan._HOME[name].split(".")[0] == room]
            lines += [f"## {TITLES[room]}", ""] if len(wanted) > 1 and names else []
            for name in sorted(names, key=str.lower):
                lines += ["```{eval-rst}", *self.describe(name), "```", ""]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)

    @staticmethod
    def describe(name: str) -> list[str]:
        """Return the autodoc lines of a name."""
        value = getattr(compplan, name)
        if inspect.isclass(value):
            return [f".. autoclass:: compplan.{name}"]
        if callable(value):
            return [f".. autofunction:: compplan.{name}"]
        return [f".. py:data:: compplan.{name}", "", f"   {', '.join(map(str, value))}"]


def setup(app) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("public-names", PublicNames)
    return {"parallel_read_safe": True}
