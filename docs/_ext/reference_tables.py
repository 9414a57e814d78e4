"""Directives of the reference that are written from the package itself: commented-job, robot-table, effect-table."""

from __future__ import annotations

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from compplan.controllers.writers.joint_convention import load_controller
from compplan.effects import EFFECTS
from compplan.job.commented_job import write_job_text
from compplan.robot import load_robot, robot_folders
from compplan.robot.mounting import name_axis, outward_axis
from compplan.robot.rating import read_rating

ROBOT_TITLES = ("folder", "payload", "reach", "joints", "tool leaves along", "springs", "grade", "controller")


def list_robots() -> list[tuple[str, ...]]:
    """Return a row of facts for each shipped robot."""
    rows = []
    for name in robot_folders():
        robot = load_robot(name)
        rating = read_rating(robot)
        payload, reach = ("-", "-") if rating is None else (f"{rating.payload:g} kg", f"{rating.reach:.2f} m")
        axis = f"{name_axis(outward_axis(robot))} of flange"
        rows.append((name, payload, reach, str(robot.nq), axis, str(len(robot.springs)), robot.grade,
                     load_controller(robot).name))  # fmt: skip
    return rows


def list_effects() -> list[tuple[str, ...]]:
    """Return name, description and cause of variation of each effect."""
    return [
        (f"`{name}`", effect.words.format(at="a joint"), getattr(effect, "follows", "posture"))
        for name, effect in EFFECTS.items()
    ]


def write_table(titles: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a table in markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in [titles, ("---",) * len(titles), *rows])


class CommentedJob(SphinxDirective):
    """Show the job that `compplan init` writes."""

    def run(self) -> list[nodes.Node]:
        """Return the nodes of the directive."""
        text = write_job_text()
        return [nodes.literal_block(text, text, language="toml")]


class RobotTable(SphinxDirective):
    """List the shipped robots."""

    def run(self) -> list[nodes.Node]:
        """Return the nodes of the directive."""
        return self.parse_text_to_nodes(write_table(ROBOT_TITLES, list_robots()))


class EffectTable(SphinxDirective):
    """List the effects."""

    def run(self) -> list[nodes.Node]:
        """Return the nodes of the directive."""
        return self.parse_text_to_nodes(write_table(("effect", "meaning", "varies with"), list_effects()))


def setup(app) -> dict[str, bool]:
    """Register the directives."""
    for name, directive in (
        ("commented-job", CommentedJob), ("robot-table", RobotTable), ("effect-table", EffectTable)
    ):  # fmt: skip
        app.add_directive(name, directive)
    return {"parallel_read_safe": True}
