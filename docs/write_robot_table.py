"""Write the list of robots in robots.md from the folders themselves: python docs/write_robot_table.py."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.controllers.writers.joint_convention import load_controller
from compplan.robot import load_robot, robot_folders
from compplan.robot.mounting import name_axis, outward_axis
from compplan.robot.rating import read_rating

PAGE = Path(__file__).with_name("robots.md")
TITLES = ("folder", "payload", "reach", "joints", "tool leaves along", "springs", "grade", "controller")


def write_table() -> str:
    """Return the table, one row a folder."""
    lines = [f"| {' | '.join(TITLES)} |", "|---" * len(TITLES) + "|"]
    for name in robot_folders():
        robot = load_robot(name)
        rating = read_rating(robot)
        facts = (
            name, "-" if rating is None else f"{rating.payload:g} kg",
            "-" if rating is None else f"{rating.reach:.2f} m", robot.nq,
            f"{name_axis(outward_axis(robot))} of `flange`", len(robot.springs), robot.grade,
            load_controller(robot).name,
        )  # fmt: skip
        lines.append(f"| {' | '.join(map(str, facts))} |")
    return "\n".join(lines) + "\n"


def fill_page(text: str, table: str) -> str:
    """Put the table into the page, in place of the one that stands there."""
    return re.sub(r"\| folder \| payload .*?\n(?!\|)", lambda _: table, text, count=1, flags=re.DOTALL)


if __name__ == "__main__":
    PAGE.write_text(fill_page(PAGE.read_text(encoding="utf-8"), write_table()), encoding="utf-8")
