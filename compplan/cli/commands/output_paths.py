"""What a command writes to: refused before anything is computed, where it cannot be written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from compplan.errors import InputError
from compplan.io.transaction import check_file, check_results

#: Results whose names are known before anything is computed, by command; programs are named after the job.
RESULTS = {
    "plan": ("plan.json", "joints.csv", "report.html", "cell.json", "deviation.csv"),
    "compare": ("compare.json", "report.html"),
    "montecarlo": ("montecarlo.json", "report.html"),
    "map": ("map.json", "map_horizontal.png", "map_vertical.png"),
    "identify": ("identify.json", "report.html", "robot/robot.urdf", "robot/elasticity.toml"),
    "diagnose": ("diagnosis.json", "report.html", "gap.csv", "robot/robot.urdf", "robot_causes/robot.urdf"),
    "campaign": ("campaign.json", "campaign.csv", "report.html"),
    "learn": ("learn.json", "plan.json", "joints.csv", "plan.html", "report.html", "robot/robot.urdf"),
    "reproduce": ("reproduction.json", "report.html"),
    "place": ("place.json", "report.html"),
    "convert": ("report.html",),
    "forces": ("forces.json", "forces.csv", "report.html"),
    "trace": ("trace.json", "report.html", "robot/robot.urdf", "robot/elasticity.toml"),
    "post": ("plan.json", "joints.csv", "report.html"),
}


class Place(click.Path):
    """Path of a result; an option of this type is looked at when the command line is read."""

    def __init__(self, check: Callable[[Path, str], None], suffix: str = "") -> None:
        super().__init__(path_type=Path)
        self.check, self.suffix = check, suffix

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path.

        Raises:
            InputError: If nothing can be written there.

        """
        path = Path(str(super().convert(value, param, ctx)))  # type: ignore[arg-type]
        self.check(path, "" if ctx is None else str(ctx.info_name))
        if self.suffix and path.exists() and path.suffix != self.suffix:
            raise InputError(f"is there and no {self.suffix} file, name another one to write", file=path)
        return path


def _check_folder(path: Path, command: str) -> None:
    check_results(path, RESULTS.get(command, ()))


def _check_file(path: Path, command: str) -> None:
    check_file(path)


OUT_FOLDER, OUT_FILE, OUT_TABLE = Place(_check_folder), Place(_check_file), Place(_check_file, ".csv")
