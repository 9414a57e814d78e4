"""The directive `command-help`: every command with the text that it prints for --help, which cannot go stale."""

from __future__ import annotations

import click
from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from compplan.cli import COMMANDS, load_command


class CommandHelp(SphinxDirective):
    """Write a section a command."""

    def run(self) -> list[nodes.Node]:
        """Ask every command for its help."""
        lines: list[str] = []
        for name, what in COMMANDS.items():
            command = load_command(name)
            context = click.Context(command, info_name=f"compplan {name}", max_content_width=96, terminal_width=96)
            lines += [f"## compplan {name}", "", f"{what[:1].upper()}{what[1:]}.", "", "```text"]
            lines += [*command.get_help(context).splitlines(), "```", ""]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


def setup(app) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
