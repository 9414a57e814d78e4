"""The directive `robot-table`: every robot that ships with compplan, from its own folder."""

from __future__ import annotations

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from compplan.program.counting import load_controller
from compplan.robot import load_robot, robot_folders


class RobotTable(SphinxDirective):
    """List the robots with grade, springs and controller."""

    def run(self) -> list[nodes.Node]:
        """Load every folder."""
        lines = ["| folder | joints | reach of the links | springs | grade | controller |", "|---|---|---|---|---|---|"]
        for name in robot_folders():
            robot = load_robot(name)
            controller = load_controller(robot).name
            facts = (robot.nq, f"{robot.longest_reach:.2f} m", len(robot.springs), robot.grade, controller)
            lines.append(f"| {name} | " + " | ".join(map(str, facts)) + " |")
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("robot-table", RobotTable)
    return {"parallel_read_safe": True}
