"""The directive `public-names PACKAGE ..`: the public names of some packages of compplan, with their docstrings."""

from __future__ import annotations

import inspect

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

import compplan

TITLES = {
    "job": "Jobs", "toolpath": "Toolpaths", "robot": "Robots", "planning": "Planning", "simulation": "Simulated robot",
    "controllers": "Programs", "studies": "Studies", "measurement": "Measurements", "identification": "Identification",
    "diagnosis": "Diagnosis", "effects": "Effects", "learning": "Learning from parts", "reporting.maps": "Maps",
    "reporting.writers.plan": "Writing results", "errors": "Errors",
}  # fmt: skip


class PublicNames(SphinxDirective):
    """List the public names of some packages, each under a heading where there are several."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Write one autodoc directive a name and let it be parsed."""
        wanted = self.arguments[0].split()
        lines: list[str] = []
        for package in wanted:
            names = [name for name in compplan.__all__ if f"{compplan._HOME[name]}.".startswith(f"{package}.")]
            if not names:
                raise self.error(f"package {package!r} has no public name")
            lines += [f"## {TITLES[package]}", ""] if len(wanted) > 1 and package in TITLES else []
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
